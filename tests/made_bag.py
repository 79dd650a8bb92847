"""A bag made without ROS: a hundred blocks of a rig in squeal."""

from squeal_rig.instruments.acquisition import Acquisition
from squeal_rig.instruments.description import RigDescription
from squeal_rig.instruments.settings import RigSettings
from squeal_rig.instruments.virtual import VirtualRig
from squeal_rig.model.parameters import RigParameters
from squeal_rig.recording import BagWriter, QosProfile, cdr_from_samples
from tests.messages import schema_of, string_cdr

_START = 1_700_000_000 * 10**9
BLOCKS = 100


def write_squeal(folder):
    """Write the bag: a second at 300 N, from an impact on."""
    p = RigParameters.preset("yavuz_sen_2023").replace(preload=300.0, damping_x=20.0, damping_y=20.0)
    acquisition = Acquisition(VirtualRig(), p, RigSettings())
    acquisition.start(_START)
    acquisition.impact()
    string, cloud = schema_of("std_msgs/msg/String"), schema_of("sensor_msgs/msg/PointCloud2")
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
