"""Replay of a bag through a fresh estimator, compared with what the live one published: number for number."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from squeal_rig.configuration.files import yaml_scalar
from squeal_rig.errors import ExperimentError
from squeal_rig.recording import Bag, samples_from_cdr
from squeal_rig.recording.gaps import samples_missing
from squeal_rig.samples.blocks import TRUTH, recorded_blocks, rig_topic
from squeal_rig.session.live import LiveGraph
from squeal_rig.session.processes import NodeProcess, stop_all
from squeal_rig.session.run import SignalWatch, wait_for_end

WINDOWS = "friction/windows"
_END_TIMEOUT = 30.0


@dataclass(frozen=True)
class ReplayComparison:
    """Windows recorded live, windows of the replay, and how many of them are equal in every field, bit for bit.

    `incomplete` windows hold samples that the bag has not, in the recording and in the replay: these cannot be equal.
    """

    live: int
    replayed: int
    equal: int
    incomplete: tuple[int, int] = (0, 0)

    @property
    def same(self) -> bool:
        """Whether the replay gave the same windows, number for number, wherever the bag has all samples."""
        return self.live - self.incomplete[0] == self.replayed - self.incomplete[1] == self.equal > 0

    @property
    def sentence(self) -> str:
        """What was found."""
        verdict = "the same, number for number" if self.same else "NOT the same"
        lost = f", {self.incomplete[0]} hold samples that the recorder lost" if self.incomplete[0] else ""
        return f"windows: {self.live} live, {self.replayed} replayed, {self.equal} equal in every bit{lost}: {verdict}"


def recorded_windows(bag: Path) -> np.ndarray:
    """All of `friction/windows` in a bag as one structured array."""
    opened = Bag(bag)
    topic = rig_topic(opened, WINDOWS)
    if topic is None:
        raise ExperimentError(f"{bag} has no topic {WINDOWS}: nothing to compare a replay with")
    pieces = [samples_from_cdr(message.data).samples for message in opened.messages([topic])]
    if not pieces:
        raise ExperimentError(f"{bag} holds no windows: nothing to compare a replay with")
    return np.concatenate(pieces)


def replay_and_compare(bag: Path, config: Path, rate: float, watch: SignalWatch) -> ReplayComparison:
    """Play a bag through a fresh friction estimator and compare its windows with the recorded ones.

    Raises:
        ExperimentError: a node did not start, died or did not end.
    """
    live = recorded_windows(bag)
    with tempfile.TemporaryDirectory(prefix="squeal_rig_") as logs:
        graph = LiveGraph(watch.check)
        graph.keeps_windows = True
        files = ["--params-file", str(config)]
        estimator = NodeProcess("friction_estimator", Path(logs), files)
        nodes = [estimator]
        try:
            graph.wait_for(lambda: graph.listeners("daq/samples") >= 2, "the fresh estimator", _END_TIMEOUT)
            play = {"bag": yaml_scalar(str(bag)), "rate": f"{rate:.3f}", "wait_for_subscribers": "10.0"}
            words = [word for name, value in play.items() for word in ("-p", f"{name}:={value}")]
            player = NodeProcess("player", Path(logs), [*files, *words])
            nodes.append(player)

            def check() -> None:
                graph.spin()
                estimator.check()

            code = wait_for_end(player, check, _END_TIMEOUT + Bag(bag).duration / rate)
            if code != 0:
                raise ExperimentError(f"node player ended with exit code {code}: {player.last_words()}")
            deadline = time.monotonic() + 5.0
            while len(graph.windows) < len(live) and time.monotonic() < deadline:
                graph.spin()
        finally:
            stop_all(nodes)
            graph.close()
    return compared(live, graph.windows, lost_spans(bag))


def lost_spans(bag: Path) -> list[tuple[float, float]]:
    """Begin and end [s since sample 0 of the run] of what a bag has not: samples, or the truth of samples."""
    spans, expected = [], None
    opened = Bag(bag)
    told = rig_topic(opened, TRUTH) is not None
    for block in recorded_blocks(opened):
        rate, seq = block.rig.sample_rate, block.daq["seq"]
        first, end = int(seq[0]), int(seq[-1]) + 1
        if expected is not None and samples_missing(expected, first):
            spans.append((expected / rate, first / rate))
        if told and block.truth is None:
            spans.append((first / rate, end / rate))
        expected = end
    return spans


def compared(
    live: np.ndarray, replayed: list[np.ndarray], lost: Sequence[tuple[float, float]] = ()
) -> ReplayComparison:
    """Compare windows by their start; nan equals nan. Windows that meet a span of `lost` [s] are counted apart."""

    def is_whole(window: np.ndarray) -> bool:
        return not any(window["t_start"] < end and begin < window["t_end"] for begin, end in lost)

    whole = [window for window in live if is_whole(window)]
    by_start = {float(window["t_start"]): window for window in replayed if is_whole(window)}
    equal = 0
    for window in whole:
        other = by_start.get(float(window["t_start"]))
        if other is not None and all(
            np.array_equal(window[n], other[n], equal_nan=True) for n in live.dtype.fields or ()
        ):
            equal += 1
    incomplete = len(live) - len(whole), len(replayed) - len(by_start)
    return ReplayComparison(len(live), len(replayed), equal, incomplete)
