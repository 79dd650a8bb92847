"""Friction and stability computed again from a recording, with today's code: a bag of what the live nodes published."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from squeal_rig.analysis.estimate_output import EstimateOutput
from squeal_rig.analysis.estimate_stability import OfflineStability
from squeal_rig.configuration.declared import declarations
from squeal_rig.errors import RecordingError, SquealRigError
from squeal_rig.estimation.friction import FrictionEstimator, FrictionWindow
from squeal_rig.estimation.regression import MODEL_COLUMNS, FrictionRegression
from squeal_rig.estimation.settings import FrictionSettings
from squeal_rig.estimation.stability_follower import Estimate, InForce
from squeal_rig.instruments.channels import FRICTION_SAMPLE_RECORD
from squeal_rig.recording import Bag, BagWriter, cdr_from_samples, provenance
from squeal_rig.recording.cdr import float64_message, multi_array_message
from squeal_rig.recording.parameter_log import AT_START, parameters_of
from squeal_rig.samples.blocks import DAQ, DESCRIPTION, BlockJoiner, RecordedBlock


@dataclass(frozen=True)
class EstimateReport:
    """What was computed: recorded and computing time [s], messages by topic.

    `unexplained` counts summaries whose causes the log does not hold, `rejected` what the live nodes would refuse too.
    """

    recorded: float
    computing: float
    counts: dict[str, int] = field(default_factory=dict)
    unexplained: int = 0
    rejected: int = 0

    @property
    def speed(self) -> float:
        """Recorded seconds per second."""
        return self.recorded / self.computing if self.computing > 0.0 else math.inf


def estimate_bag(source: str | Path, directory: str | Path) -> EstimateReport:
    """Compute friction and stability again and write them into a new bag, under the topics of the live nodes.

    The estimator's settings are those of the recorded node where the bag tells them. Summaries of stability are made
    for the same causes as the recorded ones; where none were recorded, whenever the node would have been due.

    Raises:
        RecordingError: the bag cannot be read, is no recording of the rig, or the new one cannot be written.
    """
    began = time.perf_counter()
    bag = Bag(source)
    joiner = BlockJoiner(bag)
    if bag.topics[str(joiner.topics[DESCRIPTION])].message_count == 0:
        raise RecordingError(f"{source} holds no message on {DESCRIPTION}: the rig's constants are not known")
    prefix = str(joiner.topics[DAQ])[: -len(DAQ)]
    facts = {f"source.{key}": value for key, value in bag.custom_data.items()}
    with BagWriter(directory, custom_data=provenance() | facts | {"estimated_from": bag.path.name}) as writer:
        output = EstimateOutput(writer, bag, prefix)
        work = _Estimation(bag, prefix, output)
        live = output.live_summaries()
        for message in bag.messages([*joiner.names, *live]):
            if message.topic in live:
                work.stability.take_recorded(message)
                continue
            try:
                for block in joiner.take(message):
                    work.take(block)
            except SquealRigError:
                work.rejected += 1  # as the live nodes do
            if joiner.rig is not None:
                work.stability.take_rig(joiner.rig, message.log_time)
        for block in joiner.rest():
            work.take(block)
        work.stability.finish()
    took = time.perf_counter() - began
    return EstimateReport(bag.duration, took, output.counts, work.stability.unexplained, work.rejected)


def recorded_settings(bag: Bag, node: str) -> FrictionSettings:
    """Settings the live estimator ran with, where the bag tells them; the defaults elsewhere."""
    known = declarations(FrictionSettings)
    for record in bag.metadata_records:
        if record.name == AT_START:
            try:
                name, _, values = parameters_of(record.values)
            except RecordingError:
                continue
            if name == node:
                return FrictionSettings.from_mapping({key: values[key] for key in known if key in values})
    return FrictionSettings()


class _Estimation:
    """What the nodes `friction_estimator` and `stability` do, fed from a bag."""

    def __init__(self, bag: Bag, prefix: str, output: EstimateOutput) -> None:
        self._settings = recorded_settings(bag, f"{prefix}friction_estimator")
        self._output = output
        self._friction: FrictionEstimator | None = None
        self._regression = FrictionRegression()
        self.rejected = 0
        self.stability = OfflineStability(output)

    def take(self, block: RecordedBlock) -> None:
        """Take the next block."""
        daq, rig, now = block.daq, block.rig, block.log_time
        if self._friction is None or self._friction.rig.sample_rate != rig.sample_rate:
            self._friction = FrictionEstimator(rig, self._settings)
        self._friction.rig = rig
        mu, valid, windows = self._friction.add_samples(block.stamp, daq)
        samples = np.zeros(len(daq), FRICTION_SAMPLE_RECORD)
        samples["t"], samples["mu"], samples["valid"], samples["seq"] = daq["t"], mu, valid, daq["seq"]
        self._output.write("friction/samples", cdr_from_samples(samples, block.stamp), now)
        last = daq[-1]
        with self._refusing():
            self.stability.take_block(InForce(float(last["preload"]), float(last["belt_speed"]), int(last["seq"])), now)
        self._publish(windows, now)
        if block.truth is not None:
            self._publish(self._friction.add_truth(block.truth), now)

    @contextmanager
    def _refusing(self) -> Iterator[None]:
        """What a live node refuses and counts is refused and counted."""
        try:
            yield
        except SquealRigError:
            self.rejected += 1

    def _publish(self, windows: list[FrictionWindow], now: int) -> None:
        for window in windows:
            self._output.write("friction/windows", cdr_from_samples(window.as_record(), window.stamp), now)
            if not math.isnan(window.values["mu"]):
                self._output.write("friction/mu", float64_message(window.values["mu"]), now)
            with self._refusing():
                self.stability.take_estimate(Estimate(window.values["mu_ratio_of_means"], window.values["t_end"]), now)
            if self._regression.add_window(window.values):
                self._refit(now)

    def _refit(self, now: int) -> None:
        model = self._regression.fit()
        if model is not None:
            self._output.write(
                "friction/model", multi_array_message([model.row()], "friction model", ", ".join(MODEL_COLUMNS)), now
            )
