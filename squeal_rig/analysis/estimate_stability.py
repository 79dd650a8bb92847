"""Summaries of stability from a log: for the causes that the recorded ones name, or whenever the node would be due."""

from __future__ import annotations

from collections import OrderedDict, deque
from typing import Any

from squeal_rig.analysis.estimate_output import EIGENVALUES, SUMMARY, EstimateOutput
from squeal_rig.estimation.stability_follower import (
    DESCRIPTION_KEY,
    EIGENVALUE_LABELS,
    SAMPLE_KEY,
    SUMMARY_FRAME,
    WINDOW_KEY,
    Estimate,
    InForce,
    StabilityFollower,
    StabilitySummary,
    description_crc,
    summary_of,
)
from squeal_rig.instruments.description import RigDescription
from squeal_rig.recording import RawMessage
from squeal_rig.recording.cdr import diagnostics_message, multi_array_message, text_of

# A summary may be recorded a little before what it was made from: it waits for this much of the log [ns].
_PATIENCE = 500_000_000
_REMEMBERED = 3000  # blocks, 30 s of them


class OfflineStability:
    """Makes the summaries and writes them.

    A recorded summary says from which description, sample and window it was made; the same is made again from the log.
    `unexplained` counts those whose causes the log does not hold.
    """

    def __init__(self, output: EstimateOutput) -> None:
        self._output = output
        self._recorded = bool(output.live_summaries())
        self._decode = output.summary_decoder() if self._recorded else None
        self._follower = StabilityFollower()
        self._rig: RigDescription | None = None
        self._rigs: dict[str, RigDescription] = {}
        self._blocks: OrderedDict[str, InForce] = OrderedDict()
        self._windows: OrderedDict[str, Estimate] = OrderedDict()
        self._pending: deque[tuple[int, int, Any]] = deque()
        self.unexplained = 0

    def take_rig(self, rig: RigDescription, now: int) -> None:
        """Take the description in force at a log time [ns]; nothing happens where it is the known one."""
        if rig is self._rig:
            return
        changed, self._rig = rig != self._rig, rig
        self._rigs[description_crc(rig)] = rig
        if changed:
            self._follower.take_rig(rig)
            self._schedule(now)

    def take_block(self, in_force: InForce, now: int) -> None:
        """Take what is in force at the end of a block."""
        _remember(self._blocks, str(in_force.sample), in_force)
        self._follower.take_block(in_force)
        self._schedule(now)

    def take_estimate(self, estimate: Estimate, now: int) -> None:
        """Take a window's friction coefficient."""
        _remember(self._windows, text_of(estimate.window_end), estimate)
        self._follower.take_estimate(estimate)

    def take_recorded(self, message: RawMessage) -> None:
        """Take a recorded summary: its causes are to be evaluated again."""
        assert self._decode is not None
        if not self._recorded:
            return
        decoded = self._decode(message.data)
        if not any(pair.key == DESCRIPTION_KEY for status in decoded.status for pair in status.values):
            self._recorded = False  # of a version that named no causes
            return
        stamp = decoded.header.stamp
        self._pending.append((message.log_time, stamp.sec * 10**9 + stamp.nanosec, decoded))

    def finish(self) -> None:
        """Evaluate what still waits."""
        while self._pending:
            self._repeat(*self._pending.popleft())

    def _schedule(self, now: int) -> None:
        if not self._recorded:
            if self._follower.is_due(now * 1e-9):
                self._write(self._follower.summary(now * 1e-9), now, now)
            return
        while self._pending and now - self._pending[0][0] > _PATIENCE:
            self._repeat(*self._pending.popleft())

    def _repeat(self, log_time: int, stamp: int, recorded: Any) -> None:
        """Make the summary again that names these causes."""
        causes = {pair.key: pair.value for status in recorded.status for pair in status.values}
        rig = self._rigs.get(causes.get(DESCRIPTION_KEY, ""))
        in_force = self._blocks.get(causes.get(SAMPLE_KEY, ""))
        estimate = self._windows.get(causes.get(WINDOW_KEY, ""))
        missing = (SAMPLE_KEY in causes and in_force is None) or (WINDOW_KEY in causes and estimate is None)
        if rig is None or missing:
            self.unexplained += 1
            return
        self._write(summary_of(rig, in_force, estimate), stamp, log_time)

    def _write(self, summary: StabilitySummary, stamp: int, log_time: int) -> None:
        if summary.eigenvalues is not None:
            self._output.write(EIGENVALUES, multi_array_message(summary.eigenvalues, *EIGENVALUE_LABELS), log_time)
        statuses = [(s.level, s.name, s.message, s.values) for s in summary.statuses]
        self._output.write(SUMMARY, diagnostics_message(stamp, SUMMARY_FRAME, statuses), log_time)


def _remember(known: OrderedDict[str, Any], key: str, value: Any) -> None:
    known[key] = value
    while len(known) > _REMEMBERED:
        known.popitem(last=False)
