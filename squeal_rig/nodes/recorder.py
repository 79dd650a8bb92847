"""Node `recorder`: writes topics as raw CDR to a rosbag2-compatible MCAP bag, all the time or around a squeal."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from datetime import datetime, timezone
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from squeal_rig.errors import DiskError, RecordingError
from squeal_rig.graph import qos
from squeal_rig.graph.conversions import ERROR, OK, WARN, status_values
from squeal_rig.graph.health import HEARD, LAST_TAKEN, Health, HealthPublisher
from squeal_rig.graph.lifetime import STEADY, Lifetime, run_node
from squeal_rig.graph.parameter_watch import ParameterWatch, Values
from squeal_rig.graph.parameters import NODE_OPTIONS, DeclaredParameters
from squeal_rig.graph.subscriptions import Taken, TopicSubscriptions
from squeal_rig.graph.triggers import offer_trigger
from squeal_rig.recording import QosProfile
from squeal_rig.recording.gaps import CLOUD_TYPE
from squeal_rig.recording.session import RecordingSession, SessionTopic
from squeal_rig.recording.settings import RecorderSettings
from squeal_rig.recording.writer import MAX_TIME

_FLUSH_PERIOD = 0.25
_RUN_FACTS = ("preset",)  # parameters of the rig that tell what a run was


class RecorderNode(Node):
    """Records topics as they appear in the graph, with the QoS and the type their publishers have."""

    def __init__(self, lifetime: Lifetime) -> None:
        super().__init__("recorder", **NODE_OPTIONS)
        self._lifetime = lifetime
        self._declared = DeclaredParameters(self, (RecorderSettings(),))
        self._session = RecordingSession(self._settings)
        self._squealing = False
        self._missed = 0
        self._lost_before = 0, 0  # `_topics.lost` and `_missed` when the bag was begun
        self._lost_of_last = 0
        self._blocks: dict[str, SessionTopic] = {}
        self._snapshot_due: float | None = None
        if self._settings.autostart:
            self._session.start(self._now())
        self._topics = TopicSubscriptions(self, self._settings.topics, self._found)
        self._watch = ParameterWatch(self, self._on_parameters, self._on_change)
        self.create_timer(_FLUSH_PERIOD, self._flush, clock=STEADY)
        self.create_subscription(DiagnosticArray, "squeal/state", self._on_squeal, qos.EVENTS)
        for name, action in (
            ("start", self._start),
            ("stop", self._stop),
            ("split", self._session.split),
            ("snapshot", lambda: self._session.snapshot("on request", self._now())),
        ):
            offer_trigger(self, name, self._logged(action))
        HealthPublisher(self, self._health)
        self._topics.discover()
        self.greeting = self._session.state

    @property
    def _settings(self) -> RecorderSettings:
        settings: RecorderSettings = self._declared.group(RecorderSettings)
        return settings

    def _now(self) -> int:
        return time.time_ns()  # what the middleware stamps the reception of a message with

    # --- what comes in

    def _found(self, topic: str, type_name: str, offered: list[QosProfile]) -> Taken:
        known = self._session.add_topic(topic, type_name, offered)
        if type_name == CLOUD_TYPE:
            self._blocks[topic] = known

        def take(data: bytes, info: dict[str, int | None]) -> None:
            missed = known.missed(info.get("publication_sequence_number"))
            if missed and self.count_publishers(topic) == 1:  # of several, each numbers its own
                self._missed += missed
            received = _sound_time(info["received_timestamp"]) or self._now()
            sent = _sound_time(info["source_timestamp"]) or received  # a publisher may stamp as it likes
            self._guarded(lambda: self._session.write(known, data, received, sent))

        return take

    def _on_parameters(self, node: str, values: Values) -> None:
        rig = f"{self.get_namespace().rstrip('/')}/rig"
        facts: dict[str, str] = {key: str(values[key]) for key in _RUN_FACTS if key in values} if node == rig else {}
        self._guarded(lambda: self._session.parameters_at_start(node, values, self._now(), facts))

    def _on_change(self, node: str, values: Values, deleted: tuple[str, ...]) -> None:
        self._guarded(lambda: self._session.parameters_changed(node, values, deleted, self._now()))

    def _on_squeal(self, message: DiagnosticArray) -> None:
        detected = any(status_values(status).get("detected") == "true" for status in message.status)
        if detected and not self._squealing and self._settings.snapshot_on_squeal and self._session.snapshots:
            self._snapshot_due = self._snapshot_due or time.monotonic() + self._settings.snapshot_delay
        self._squealing = detected

    def _flush(self) -> None:
        self._guarded(self._session.flush)
        if self._snapshot_due is not None and time.monotonic() >= self._snapshot_due:
            self._snapshot_due = None
            if self._session.recording:
                self._guarded(lambda: self.get_logger().info(self._session.snapshot("squeal detected", self._now())))

    def _guarded(self, action: Callable[[], Any]) -> None:
        """A disk that refuses ends the recording with a sentence; the rig and this node go on."""
        try:
            action()
        except DiskError as error:
            self._stopped_by(error)
        except RecordingError as error:
            self.get_logger().warning(str(error))

    def _stopped_by(self, error: DiskError) -> None:
        self.get_logger().error(f"recording stopped: {error}")
        self._session.fault = str(error)
        self._end(f"stopped: {error}")

    def _drain(self) -> None:
        """Take what has arrived by now: after a slow disk that may be seconds, which would be lost with the node."""
        if self._session.recording:
            self._topics.drain(self._now())

    # --- services

    def _start(self) -> str:
        self._session.start(self._now())
        self._lost_before = self._topics.lost, self._missed
        return self._session.state

    def _stop(self) -> str:
        if not self._session.recording:
            raise RecordingError("nothing is being recorded")
        directory = self._session.directory
        self._drain()
        self._end("complete: stopped on request")
        return f"closed {directory}"

    def _logged(self, action: Callable[[], str]) -> Callable[[], str]:
        def act() -> str:
            try:
                sentence = action()
            except DiskError as error:
                self._stopped_by(error)
                raise
            self.get_logger().info(sentence)
            return sentence

        return act

    # --- health and end

    def _health(self) -> Health:
        session, unknown = self._session, self._topics.unknown
        values = {
            "directory": str(session.directory or ""),
            "bytes": session.bytes_written,
            "state": session.state,
            "messages": session.message_count,
            "topics": len(self._topics),
            HEARD: ", ".join(self._topics.heard),
            **{LAST_TAKEN + topic: known.number for topic, known in self._blocks.items()},
            "lost messages": self._lost,
            "refused messages": session.refused,
            "in memory [s]": round(session.seconds_in_memory, 1),
            "snapshots": session.snapshot_count,
            "nodes with known parameters": self._watch.answered,
        }
        if session.fault:
            return ERROR, session.fault, values
        if unknown:
            return WARN, "not recorded: " + ", ".join(sorted(unknown)), values
        if self._lost:
            return WARN, f"{self._lost} messages were lost on the way here", values
        if session.refused:
            return WARN, f"{session.refused} messages were refused: {session.refusal}", values
        return OK, session.state, values

    @property
    def _lost(self) -> int:
        """Messages that did not get here for the open bag, or for the last one.

        The middleware tells them, and the numbers of a topic's one publisher: both may see the same ones, neither all.
        """
        if not self._session.recording:
            return self._lost_of_last
        told, missed = self._lost_before
        return max(self._topics.lost - told, self._missed - missed)

    def _end(self, ending: str) -> None:
        self._lost_of_last = self._lost
        try:
            self._session.stop(ending, {"lost_messages": str(self._lost), "finished_utc": _utc_now()})
        except RecordingError as error:
            self.get_logger().error(str(error))
            self._lifetime.exit_code = 1

    def close(self) -> None:
        """Close the bag; it says whether the node was ended or fell."""
        error = sys.exc_info()[1]
        try:
            self._drain()
        except Exception as failure:
            error = error or failure
            raise
        finally:
            self._end("complete" if error is None else f"aborted: {type(error).__name__}: {error}")


def _sound_time(time: int | None) -> int:
    """A time [ns] that a bag can hold, else 0."""
    return time if time is not None and 0 < time <= MAX_TIME else 0


def _utc_now() -> str:
    return datetime.now(timezone.utc).isoformat(timespec="milliseconds")


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; returns the exit code."""
    return run_node(RecorderNode, args)


if __name__ == "__main__":
    sys.exit(main())
