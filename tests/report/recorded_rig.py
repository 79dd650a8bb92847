"""A recording as the live nodes leave it, made from the virtual rig without ROS: samples, friction, stability."""

import numpy as np

from squeal_rig.estimation.friction_follower import FrictionFollower
from squeal_rig.estimation.settings import FrictionSettings
from squeal_rig.estimation.stability_follower import Estimate, InForce, StabilityFollower
from squeal_rig.instruments.acquisition import Acquisition
from squeal_rig.instruments.description import RigDescription
from squeal_rig.instruments.settings import RigSettings
from squeal_rig.instruments.virtual import VirtualRig
from squeal_rig.model import RigParameters
from squeal_rig.recording import BagWriter, QosProfile, cdr_from_samples, samples_from_cdr
from tests.messages import TYPES, schema_of, string_cdr

LATCHED = QosProfile(depth=1, durability="transient_local")
PARAMETERS = RigParameters().replace(damping_x=20.0, damping_y=20.0)
START = 10**18
CLOUD = "sensor_msgs/msg/PointCloud2"
TOPICS = {
    "rig/description": "std_msgs/msg/String",
    "daq/samples": CLOUD,
    "truth/samples": CLOUD,
    "friction/samples": CLOUD,
    "friction/windows": CLOUD,
    "friction/mu": "std_msgs/msg/Float64",
    "friction/model": "std_msgs/msg/Float64MultiArray",
    "stability/summary": "diagnostic_msgs/msg/DiagnosticArray",
    "stability/eigenvalues": "std_msgs/msg/Float64MultiArray",
}


class Recording:
    """Writes what the nodes publish, serialised by `rosbags` and not by the code under test."""

    def __init__(self, directory, prefix="/", live=True, late=0):
        self.writer = BagWriter(directory)
        names = [name for name in TOPICS if live or not name.startswith(("friction", "stability"))]
        self.handles = {
            name: self.writer.add_topic(prefix + name, TOPICS[name], [LATCHED], schema_of(TOPICS[name]))
            for name in names
        }
        self.live, self.late = live, late
        self.friction = FrictionFollower(FrictionSettings())
        self.friction.take_rig(RigDescription(PARAMETERS))
        self.stability = StabilityFollower()
        self.daq, self.truth = [], []
        self.time = START

    def put(self, name, data):
        self.time += 1000
        if self.live or name in self.handles:
            self.writer.write(self.handles[name], data, self.time, self.time)

    def describe(self, parameters):
        rig = RigDescription(parameters)
        self.put("rig/description", string_cdr(rig.to_yaml()))
        self.stability.take_rig(rig)
        self.summarise()

    def take(self, block):
        self.time = max(self.time, block.stamp)
        self.put("daq/samples", cdr_from_samples(block.daq, block.stamp))
        self.put("truth/samples", cdr_from_samples(block.truth, block.stamp))
        self.daq.append(np.array(block.daq))
        self.truth.append(np.array(block.truth))
        if self.live:
            self.estimate(block)

    def estimate(self, block):
        messages = self.friction.take_block(block.stamp, block.daq) + self.friction.take_truth(block.truth)
        self.put_again(messages)
        for name, data in messages:
            if name == "friction/windows":
                self.stability.take_estimate(Estimate.of(samples_from_cdr(data).samples[0]))
        self.stability.take_block(InForce.after(block.daq))
        self.summarise()

    def put_again(self, messages):
        """Read by `rosbags` and serialised by it: bytes that are no such message do not get through."""
        for name, data in messages:
            self.put(name, bytes(TYPES.serialize_cdr(TYPES.deserialize_cdr(data, TOPICS[name]), TOPICS[name])))

    def summarise(self):
        if self.live and self.stability.is_due(self.time * 1e-9):
            self.put_again(self.stability.summary(self.time * 1e-9, self.time))


def record(directory, blocks=150, prefix="/", live=True):
    """Quiet at 50 N, a change of the set point after a third, and all that the nodes make of it."""
    rig = Acquisition(VirtualRig(), PARAMETERS, RigSettings())
    rig.start(START)
    recording = Recording(directory, prefix, live)
    recording.describe(PARAMETERS)
    for number in range(blocks):
        if number == blocks // 3:
            rig.set_point = PARAMETERS.replace(preload=120.0)
            recording.describe(rig.set_point)
        recording.take(rig.next_block())
    recording.writer.close("complete")
    return recording
