"""Following the rig: its description, its parameters as they change, its samples; and whether all of them are well."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from rcl_interfaces.msg import ParameterEvent
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import QoSProfile, qos_profile_parameter_events
from rclpy.subscription import Subscription
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String

from squeal_rig.configuration.declared import declarations
from squeal_rig.errors import SquealRigError
from squeal_rig.graph import qos
from squeal_rig.graph.conversions import ERROR, OK, STALE, WARN
from squeal_rig.graph.health import Health
from squeal_rig.graph.lifetime import STEADY, Lifetime
from squeal_rig.instruments.channels import DAQ_CHANNELS, block_from_cdr
from squeal_rig.instruments.description import RigDescription
from squeal_rig.instruments.driver import Samples
from squeal_rig.instruments.numbering import Numbering
from squeal_rig.model.parameters import RigParameters

_RIG_NODE = "rig"
_DAQ, _DESCRIPTION = "daq/samples", "rig/description"
_NUMBERS = [channel.name for channel in DAQ_CHANNELS if channel.code == "<f8"]
# Time without samples [s] after which a node that needs them is stale.
_LIMIT = 1.0
# Where no samples come although somebody publishes them, waits between tries to wake them [s].
_FIRST_WAIT, _LONGEST_WAIT = 3.0, 60.0
# Tries in a row that bring nothing of the rig, not even what it keeps for those who come late, until a node is deaf to
# it: 45 s. A rig that is stopped or killed is out of the graph after 20 s, and not tried.
_DEAF = 4
_LOOK_EVERY = 0.5
# A rig is started again now and then; one that is every second is two.
_MIXED = 2


class RigFollower:
    """Calls back with the rig's description whenever it changes, and with every block of its samples.

    Args:
        node: the node that follows; the rig is the node `rig` of its namespace.
        described: called with every new description.
        sampled: called with stamp [ns] and samples (n,) of every block of `daq/samples`; may raise a SquealRigError.
        depth: QoS of the blocks.
        events: follow `/parameter_events` too, which tell a change before the description does.
        lifetime: of a node that joins the graph anew where it has become deaf to the rig; None for one that must not.
    """

    def __init__(
        self,
        node: Node,
        described: Callable[[RigDescription], None],
        sampled: Callable[[int, Samples], None],
        depth: QoSProfile = qos.BLOCKS_IN,
        events: bool = False,
        lifetime: Lifetime | None = None,
    ) -> None:
        self._node = node
        self._described = described
        self._sampled = sampled
        self._refusal = self._last_rejection = ""
        self._last_block: float | None = None
        self._started = time.monotonic()
        self._numbering = Numbering()
        self._blocks = self._rejected = self._refused = self._not_finite = 0
        self._told: dict[str, int] = {}
        self._lifetime = lifetime
        self._rejoins = lifetime.rejoins if lifetime is not None else 0
        self._waking: tuple[Subscription, ...] = ()
        self._answered = False
        self._tries = self._unanswered = self._wakings = 0
        self._next_try = 0.0
        self.description: RigDescription | None = None
        self._descriptions = node.create_subscription(String, _DESCRIPTION, self._on_description, qos.LATCHED)
        self._samples = node.create_subscription(PointCloud2, _DAQ, self._on_block, depth, raw=True)
        node.create_timer(_LOOK_EVERY, self._wake, clock=STEADY)
        if events:
            namespace = node.get_namespace().rstrip("/")
            self._rig = f"{namespace}/{_RIG_NODE}"
            node.create_subscription(ParameterEvent, "/parameter_events", self._on_event, qos_profile_parameter_events)

    def reject(self, error: SquealRigError) -> None:
        """Count a message that was refused, and say so."""
        self._rejected += 1
        self._last_rejection = str(error)
        self._node.get_logger().warning(f"message refused: {error}", throttle_duration_sec=1.0)

    # --- the description

    def _on_description(self, message: String) -> None:
        self._change(lambda: RigDescription.from_yaml(message.data))

    def _on_event(self, event: ParameterEvent) -> None:
        if event.node != self._rig or self.description is None:
            return
        known, before = declarations(RigParameters), self.description
        changes = {
            parameter.name: parameter_value_to_python(parameter.value)
            for parameter in event.changed_parameters
            if parameter.name in known
        }
        if changes:
            self._change(lambda: before.with_parameters(changes))

    def _change(self, make: Callable[[], RigDescription]) -> None:
        try:
            description = make()
        except SquealRigError as error:
            self._refused += 1
            self._refusal = str(error)
            self._node.get_logger().error(f"the rig's description was refused: {error}", throttle_duration_sec=1.0)
            return
        self._refusal = ""
        if description != self.description:
            self.description = description
            self._described(description)

    # --- samples

    def _on_block(self, data: bytes) -> None:
        self._last_block = time.monotonic()
        try:
            stamp, _, daq = block_from_cdr(data, DAQ_CHANNELS)
            if self.description is not None:
                self._numbering.take(stamp, daq, self.description.sample_rate)
            finite = np.logical_and.reduce([np.isfinite(daq[name]) for name in _NUMBERS])
            self._not_finite += len(daq) - int(np.count_nonzero(finite))
            self._sampled(stamp, daq)
            self._blocks += 1
        except SquealRigError as error:
            self.reject(error)

    def _wake(self) -> None:
        """Have samples delivered again that are held back.

        Where readers were stopped for some seconds while the rig went on, Fast DDS replaces the shared memory between
        them, and may leave the rig with one that nobody reads, until another reader joins; rarely the reader with one
        that nobody writes, for as long as it is in the graph. So this node subscribes once more, to what the rig keeps
        for those who come late, too: that comes from a rig that is paused as well, and says that all is well.
        """
        now = time.monotonic()
        # Who has not been served yet is left alone: others count who listens before they begin.
        unserved = self._last_block is None and not self._rejoins
        if self._silence(now) <= _LIMIT or unserved or not self._offered(self._samples):
            self._tries, self._unanswered, self._next_try = 0, 0, now
        elif now >= self._next_try:
            silent = self._tries > 0 and not self._answered and self._offered(self._descriptions)
            self._unanswered = self._unanswered + 1 if silent else 0
            if self._is_deaf() and self._lifetime is not None:
                self._node.get_logger().warning(
                    "nothing of the rig arrives although it is there: joining the graph anew"
                )
                self._lifetime.rejoin()
                return
            self._next_try = now + min(_FIRST_WAIT * 2.0 ** min(self._tries, 10), _LONGEST_WAIT)
            self._tries += 1
            self._wakings += 1
            self._answered = False
            self._end_waking()
            self._waking = (
                self._node.create_subscription(PointCloud2, _DAQ, _ignored, qos.BLOCKS, raw=True),
                self._node.create_subscription(String, _DESCRIPTION, self._on_answer, qos.LATCHED),
            )
            return
        if self._tries == 0 or now > self._next_try - 0.5 * _FIRST_WAIT:
            self._end_waking()

    def _silence(self, now: float) -> float:
        return now - (self._started if self._last_block is None else self._last_block)

    def _offered(self, subscription: Subscription) -> bool:
        return self._node.count_publishers(subscription.topic_name) > 0

    def _is_deaf(self) -> bool:
        """Whether nothing comes of the rig; where joining anew did not help, it takes longer the next time."""
        return self._unanswered >= _DEAF + (self._rejoins if self._last_block is None else 0)

    def _on_answer(self, message: String) -> None:
        self._answered = True
        if self.description is None:
            self._on_description(message)

    def _end_waking(self) -> None:
        for subscription in self._waking:
            self._node.destroy_subscription(subscription)
        self._waking = ()

    # --- health

    def health(self, values: Mapping[str, Any]) -> Health:
        """Health of a node that needs the rig; counts stay, the sentence is about what is new since the last call."""
        counts = {
            "blocks": self._blocks,
            "lost samples": self._numbering.lost_samples,
            "restarts": self._numbering.restarts,
            "samples not finite": self._not_finite,
            "rejected messages": self._rejected,
            "refused descriptions": self._refused,
            "wakings": self._wakings,
            "rejoins": self._rejoins,
        }
        new = {name: count - self._told.get(name, 0) for name, count in counts.items()}
        self._told = counts
        level, sentence = self._judged(new)
        return level, sentence, {**values, **counts}

    def _judged(self, new: Mapping[str, int]) -> tuple[bytes, str]:
        if self._refusal:
            kept = "the one before is in use" if self.description is not None else "there is none"
            return ERROR, f"the rig's description was refused, {kept}: {self._refusal}"
        since = self._silence(time.monotonic())
        if self._last_block is None:
            return WARN if since < _LIMIT else STALE, f"no {_DAQ} yet"
        if since > _LIMIT:
            return STALE, f"stale: no {_DAQ} for {since:.1f} s"
        if new["restarts"] >= _MIXED:
            return ERROR, f"samples of more than one rig: their numbers began anew {new['restarts']} times"
        if self.description is None:
            return WARN, "no rig/description yet: the rig's constants are not known"
        if new["rejected messages"]:
            told = f"{new['rejected messages']} messages were refused, the last one: {self._last_rejection}"
            return WARN if new["blocks"] else ERROR, told
        if new["samples not finite"]:
            return WARN, f"{new['samples not finite']} samples hold a value that is not finite"
        if new["lost samples"]:
            return WARN, f"{new['lost samples']} samples were lost on the way here"
        return OK, "running"


def _ignored(_data: bytes) -> None:
    """What is taken only to be asked for."""
