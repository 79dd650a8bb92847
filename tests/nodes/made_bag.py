"""A bag made without ROS: a hundred blocks of a rig in squeal."""

from rosbags.typesys import Stores, get_typestore

from squeal_rig.instruments.acquisition import Acquisition
from squeal_rig.instruments.description import RigDescription
from squeal_rig.instruments.settings import RigSettings
from squeal_rig.instruments.virtual import VirtualRig
from squeal_rig.model.parameters import RigParameters
from squeal_rig.recording import BagWriter, MessageSchema, QosProfile, cdr_from_samples

_TYPES = get_typestore(Stores.ROS2_JAZZY)
_START = 1_700_000_000 * 10**9
BLOCKS = 100


def schema(name):
    """Definition of a message type, by `rosbags`."""
    text, _ = _TYPES.generate_msgdef(name, ros_version=2)
    return MessageSchema(name, text, _TYPES.hash_rihs01(name))


def string_cdr(text):
    """A serialised std_msgs/String."""
    data = text.encode() + b"\0"
    return b"\x00\x01\x00\x00" + len(data).to_bytes(4, "little") + data


def write_squeal(folder):
    """Write the bag: a second at 300 N, from an impact on."""
    p = RigParameters.preset("yavuz_sen_2023").replace(preload=300.0, damping_x=20.0, damping_y=20.0)
    acquisition = Acquisition(VirtualRig(), p, RigSettings())
    acquisition.start(_START)
    acquisition.impact()
    string, cloud = schema("std_msgs/msg/String"), schema("sensor_msgs/msg/PointCloud2")
    latched = QosProfile(reliability="reliable", durability="transient_local", depth=1)
    reliable = QosProfile(reliability="reliable", depth=100)
    with BagWriter(folder) as writer:
        description = writer.add_topic("/rig/description", string.type_name, [latched], string)
        daq = writer.add_topic("/daq/samples", cloud.type_name, [reliable], cloud)
        truth = writer.add_topic("/truth/samples", cloud.type_name, [reliable], cloud)
        text = RigDescription(p, preset="yavuz_sen_2023").to_yaml()
        writer.write(description, string_cdr(text), _START, _START)
        for _ in range(BLOCKS):
            block = acquisition.next_block()
            for topic, samples in ((daq, block.daq), (truth, block.truth)):
                writer.write(topic, cdr_from_samples(samples, block.stamp), block.stamp, block.stamp)
    acquisition.close()
