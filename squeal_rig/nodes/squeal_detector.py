"""Node `squeal_detector`: `daq/samples` in; whether the rig squeals, how loud and at what frequency out."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from squeal_rig.errors import ParameterError
from squeal_rig.estimation.settings import SquealSettings, ToneSettings
from squeal_rig.estimation.squeal import SquealDetector, SquealState
from squeal_rig.estimation.squeal_events import SquealEvent, SquealEvents, event_values
from squeal_rig.graph import qos
from squeal_rig.graph.conversions import ERROR, OK, WARN, diagnostics, status
from squeal_rig.graph.health import Health, HealthPublisher
from squeal_rig.graph.lifetime import Lifetime, run_node
from squeal_rig.graph.parameters import NODE_OPTIONS, DeclaredParameters
from squeal_rig.graph.rig_follower import RigFollower
from squeal_rig.instruments.description import RigDescription
from squeal_rig.instruments.driver import Samples


class SquealDetectorNode(Node):
    """Watches the pad's displacement along the belt for squeal."""

    def __init__(self, lifetime: Lifetime) -> None:
        super().__init__("squeal_detector", parameter_overrides=lifetime.kept, **NODE_OPTIONS)
        declared = DeclaredParameters(self, (SquealSettings(), ToneSettings()))
        self._settings, self._tones = declared.group(SquealSettings), declared.group(ToneSettings)
        self._detector: SquealDetector | None = None
        self._events: SquealEvents | None = None
        self._ended: list[SquealEvent] = []  # the last one of the message before, and all since
        self._told = 0  # how many of them have been told
        self._sample_rate = 0
        self._fault = ""
        self._publisher = self.create_publisher(DiagnosticArray, "squeal/state", qos.EVENTS)
        self._rig = RigFollower(self, self._on_rig, self._on_block, lifetime=lifetime)
        HealthPublisher(self, self._health)

    def _on_rig(self, rig: RigDescription) -> None:
        if rig.sample_rate == self._sample_rate:
            if self._detector is not None:
                self._detector.take_rig(rig)
            return
        self._sample_rate, self._detector, self._fault = rig.sample_rate, None, ""
        try:
            self._events = SquealEvents(rig.sample_rate, self._settings, self._tones)
            self._detector = SquealDetector(rig.sample_rate, self._settings)
            self._detector.take_rig(rig)
        except ParameterError as error:
            self._fault = str(error)
            self.get_logger().error(self._fault)

    def _on_block(self, stamp: int, daq: Samples) -> None:
        if self._detector is None or self._events is None:
            return
        self._ended += self._events.add_samples(daq)
        for state in self._detector.add_samples(stamp, daq):
            self._publisher.publish(_message(state, all_event_values(self._events, self._ended, self._told)))
            self._ended = self._ended[-1:]
            self._told = len(self._ended)

    def _health(self) -> Health:
        counts = {}
        if self._detector is not None and self._detector.on_level > self._settings.on_level:
            counts = {"noise raises the level of squeal to [dB re 1 um]": round(self._detector.on_level, 2)}
        level, sentence, values = self._rig.health(counts)
        return (ERROR, self._fault, values) if self._fault else (level, sentence, values)


def all_event_values(events: SquealEvents, ended: Sequence[SquealEvent], told: int = 0) -> dict[str, object]:
    """`event_values` of the last that ended, and of all that ended since the last message, so that none is lost.

    `ended events` are their numbers, `none` where none has ended since. Those before the last have the keys of the
    last with a number behind: `ended event 2` ended just before `ended event`, `ended event 3` before that.

    Args:
        events: what follows the tones.
        ended: events that ended, the earliest first.
        told: how many of them stood in a message before.
    """
    values = event_values(events, ended[-1] if ended else None)
    values["ended events"] = " ".join(str(event.number) for event in ended[told:]) or "none"
    for place, event in enumerate(ended[told:-1][::-1], 2):
        own = event_values(events, event)
        values |= {f"{key} {place}": value for key, value in own.items() if key.startswith("ended ")}
    return values


def _message(state: SquealState, events: Mapping[str, object]) -> DiagnosticArray:
    values: dict[str, object] = {
        "detected": state.detected,
        "level [dB re 1 um]": state.level,
        "frequency [Hz]": state.frequency,
        "since [s]": f"{state.since / 1e9:.9f}" if state.since is not None else "none",
        **events,
    }
    level, text = (WARN, "squeal") if state.detected else (OK, "quiet")
    return diagnostics(state.stamp, status(level, "squeal", text, values))


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; returns the exit code."""
    return run_node(SquealDetectorNode, args)


if __name__ == "__main__":
    sys.exit(main())
