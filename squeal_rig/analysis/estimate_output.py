"""The bag that offline estimation writes: the live nodes' topics, with the definitions the source bag carries."""

from __future__ import annotations

from squeal_rig.errors import RecordingError
from squeal_rig.recording import Bag, BagWriter, ChannelHandle, MessageSchema, QosProfile, decoder_of, installed_schema
from squeal_rig.recording.messages import Decode

SUMMARY, EIGENVALUES = "stability/summary", "stability/eigenvalues"
#: Topic -> (type, whether its last value is kept for those who come late).
ESTIMATED = {
    "friction/samples": ("sensor_msgs/msg/PointCloud2", False),
    "friction/windows": ("sensor_msgs/msg/PointCloud2", False),
    "friction/mu": ("std_msgs/msg/Float64", False),
    "friction/model": ("std_msgs/msg/Float64MultiArray", True),
    EIGENVALUES: ("std_msgs/msg/Float64MultiArray", True),
    SUMMARY: ("diagnostic_msgs/msg/DiagnosticArray", True),
}


class EstimateOutput:
    """Writes estimated messages under the names they have live, in the rig's namespace."""

    def __init__(self, writer: BagWriter, bag: Bag, prefix: str) -> None:
        self._writer = writer
        self._bag = bag
        self._prefix = prefix
        self._handles: dict[str, ChannelHandle] = {
            name: writer.add_topic(
                prefix + name, type_name, _qos(bag, prefix + name, latched), schema_of(bag, type_name)
            )
            for name, (type_name, latched) in ESTIMATED.items()
        }
        self.counts = dict.fromkeys(ESTIMATED, 0)

    def write(self, name: str, data: bytes, log_time: int) -> None:
        """Write one message under the log time [ns] of what it was computed from."""
        self._writer.write(self._handles[name], data, log_time, log_time)
        self.counts[name] += 1

    def live_summaries(self) -> list[str]:
        """The source's topic of stability summaries, if it has any."""
        topic = self._bag.topics.get(self._prefix + SUMMARY)
        return [topic.name] if topic is not None and topic.message_count else []

    def summary_decoder(self) -> Decode:
        """Decodes the source's summaries."""
        return decoder_of(self._bag.topics[self._prefix + SUMMARY].schema)


def schema_of(bag: Bag, type_name: str) -> MessageSchema:
    """The definition of a type: any topic's of the bag, else the one installed.

    Raises:
        RecordingError: neither is there.
    """
    for topic in bag.topics.values():
        if topic.type_name == type_name and topic.schema.text:
            return topic.schema
    try:
        return installed_schema(type_name)
    except RecordingError:
        raise RecordingError(
            f"{bag.path} carries no definition of {type_name}, and none is installed: record /diagnostics,"
            " friction/* and stability/* too, or install ROS 2's common_interfaces."
        ) from None


def _qos(bag: Bag, topic: str, latched: bool) -> tuple[QosProfile, ...]:
    known = bag.topics.get(topic)
    if known is not None and known.qos:
        return known.qos
    return (QosProfile(depth=1, durability="transient_local") if latched else QosProfile(),)
