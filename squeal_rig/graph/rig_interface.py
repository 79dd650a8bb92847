"""What the rig offers to the graph: blocks, their means, its description, the clock; services that operate it."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import String
from std_srvs.srv import SetBool

from squeal_rig.graph import qos
from squeal_rig.graph.conversions import cloud, joint_state, time_message, wrench
from squeal_rig.graph.health import LAST_PUBLISHED, listeners
from squeal_rig.graph.triggers import answer, offer_trigger
from squeal_rig.instruments.acquisition import Block
from squeal_rig.instruments.description import RigDescription
from squeal_rig.instruments.means import block_means
from squeal_rig.instruments.settings import BLOCKS_PER_SECOND
from squeal_rig.model.parameters import RigParameters

_BLOCK_NS = 10**9 // BLOCKS_PER_SECOND


class RigOutputs:
    """The rig's publishers.

    Args:
        node: the rig.
        publishes_truth: whether the driver knows the truth.
        publishes_clock: whether sampled time is not wall time.
    """

    def __init__(self, node: Node, publishes_truth: bool, publishes_clock: bool) -> None:
        make = node.create_publisher
        names = ("daq/samples", "truth/samples") if publishes_truth else ("daq/samples",)
        self._samples = {name: make(PointCloud2, name, qos.BLOCKS) for name in names}
        self._published = dict.fromkeys(names, 0)  # blocks of each publisher
        self._state = make(JointState, "pad/state", qos.BLOCKS)
        self._wrench = make(WrenchStamped, "contact/wrench", qos.BLOCKS)
        self._description = make(String, "rig/description", qos.LATCHED)
        self._clock = make(Clock, "/clock", qos.BLOCKS) if publishes_clock else None
        self._end: int | None = None

    def restart_stamp(self, now: int) -> int:
        """The t0 to start from anew [ns]: now, but simulated time goes on where it stopped."""
        return now if self._clock is None or self._end is None else self._end

    def publish(self, block: Block, p: RigParameters, drum_radius: float) -> None:
        """Publish a block and what follows from it."""
        for name, samples in (("daq/samples", block.daq), ("truth/samples", block.truth)):
            if samples is not None and name in self._samples:
                self._samples[name].publish(cloud(samples, block.stamp))
                self._published[name] += 1
        means = block_means(block, p, drum_radius)
        self._state.publish(joint_state(block.stamp, means.position, means.velocity))
        self._wrench.publish(wrench(block.stamp, means.tangential, means.normal))
        self._end = block.stamp + _BLOCK_NS
        if self._clock is not None:
            self._clock.publish(Clock(clock=time_message(self._end)))

    def listeners(self) -> dict[str, int]:
        """Health values: subscribers to the samples."""
        return listeners(self._samples)

    def published(self) -> dict[str, int]:
        """Health values: number of the last block, as its publisher counts."""
        return {LAST_PUBLISHED + name: number for name, number in self._published.items()}

    def describe(self, description: RigDescription) -> None:
        """Publish the description, latched."""
        self._description.publish(String(data=description.to_yaml()))


def offer_services(node: Node, triggers: Mapping[str, Callable[[], str]], pause: Callable[[bool], str]) -> None:
    """Offer operations as services under the node's name; each returns a sentence and may raise a `SquealRigError`."""

    for name, action in triggers.items():
        offer_trigger(node, name, action)
    node.create_service(SetBool, "~/pause", lambda request, response: answer(response, lambda: pause(request.data)))
