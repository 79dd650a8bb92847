"""Node `recorder`: writes chosen topics as raw CDR to a rosbag2-compatible MCAP bag."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from rclpy.node import Node

from squeal_rig.errors import RecordingError
from squeal_rig.nodes.conversions import ERROR, OK, WARN
from squeal_rig.nodes.health import Health, HealthPublisher
from squeal_rig.nodes.interfaces import message_class, offered_qos, requested_qos
from squeal_rig.nodes.lifetime import STEADY, Lifetime, run_node
from squeal_rig.nodes.parameters import NODE_OPTIONS, DeclaredParameters
from squeal_rig.recording import BagWriter, ChannelHandle, provenance
from squeal_rig.recording.settings import RecorderSettings

_DISCOVERY_PERIOD = 0.1
_FLUSH_PERIOD = 0.25


class RecorderNode(Node):
    """Records topics as they appear in the graph, with the QoS and the type their publishers have."""

    def __init__(self, lifetime: Lifetime) -> None:
        super().__init__("recorder", **NODE_OPTIONS)
        self._lifetime = lifetime
        settings: RecorderSettings = DeclaredParameters(self, (RecorderSettings(),)).group(RecorderSettings)
        directory = Path(settings.directory or f"bags/{datetime.now(timezone.utc):%Y%m%dT%H%M%SZ}")
        self._every = "*" in settings.topics
        self._wanted = {self.resolve_topic_name(topic) for topic in settings.topics if topic != "*"}
        self._writer = BagWriter(directory, compression=settings.compression, custom_data=provenance())
        self._directory = directory
        self._recorded: set[str] = set()
        self._unknown: set[str] = set()
        self._fault = ""
        self.create_timer(_DISCOVERY_PERIOD, self._discover, clock=STEADY)
        self.create_timer(_FLUSH_PERIOD, self._flush, clock=STEADY)
        HealthPublisher(self, self._health)
        self._discover()
        self.get_logger().info(f"recording to {directory}")

    def _discover(self) -> None:
        """Subscribe to wanted topics that have a publisher by now."""
        for topic, types in self.get_topic_names_and_types():
            if topic in self._recorded or not (self._every or topic in self._wanted):
                continue
            offered = [offered_qos(endpoint) for endpoint in self.get_publishers_info_by_topic(topic)]
            if not offered:
                continue
            self._recorded.add(topic)
            try:
                handle = self._writer.add_topic(topic, types[0], offered)
                self.create_subscription(
                    message_class(types[0]), topic, self._writes(handle), requested_qos(offered), raw=True
                )
            except RecordingError as error:
                self._unknown.add(topic)
                self.get_logger().warning(f"{topic} is not recorded: {error}")

    def _writes(self, handle: ChannelHandle) -> Callable[[bytes, Any], None]:
        def write(data: bytes, info: dict[str, int]) -> None:
            received = info["received_timestamp"] or self.get_clock().now().nanoseconds
            self._guarded(lambda: self._writer.write(handle, data, received, info["source_timestamp"] or received))

        return write

    def _flush(self) -> None:
        self._guarded(self._writer.flush)

    def _guarded(self, action: Callable[[], None]) -> None:
        """A full disk ends the recording with a sentence; the rig goes on, and so does this node's health."""
        if self._fault:
            return
        try:
            action()
        except RecordingError as error:
            self._fault = str(error)
            self.get_logger().error(f"recording stopped: {error}")
            self._close(f"stopped: {error}")

    def _health(self) -> Health:
        values = {
            "directory": str(self._directory),
            "bytes": self._writer.bytes_written,
            "messages": self._writer.message_count,
            "topics": len(self._recorded - self._unknown),
        }
        if self._fault:
            return ERROR, self._fault, values
        if self._unknown:
            return WARN, f"not recorded: {', '.join(sorted(self._unknown))}", values
        return OK, "recording", values

    def _close(self, ending: str) -> None:
        try:
            self._writer.close(ending)
        except RecordingError as error:
            self.get_logger().error(str(error))
            self._lifetime.exit_code = 1

    def close(self) -> None:
        """Close the bag."""
        if not self._fault:
            self._close("complete")


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; returns the exit code."""
    return run_node(RecorderNode, args)


if __name__ == "__main__":
    sys.exit(main())
