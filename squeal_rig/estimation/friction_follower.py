"""Friction of a rig as it runs, as the messages that tell it. The node and offline estimation share it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from squeal_rig.estimation.friction import FrictionEstimator, FrictionWindow
from squeal_rig.estimation.regression import INTERVAL_COLUMNS, MODEL_COLUMNS, FrictionRegression
from squeal_rig.estimation.settings import FrictionSettings
from squeal_rig.instruments.channels import FRICTION_SAMPLE_RECORD
from squeal_rig.instruments.description import RigDescription
from squeal_rig.instruments.driver import Samples
from squeal_rig.recording import cdr_from_samples
from squeal_rig.recording.cdr import float64_message, multi_array_message

SAMPLES, WINDOWS, MU, MODEL = "friction/samples", "friction/windows", "friction/mu", "friction/model"
_MODEL_NAME = "friction model"

Message = tuple[str, bytes]  # relative topic, serialised


class FrictionFollower:
    """Keeps what is known of a running rig; every block gives the messages that follow from it, in their order."""

    def __init__(self, settings: FrictionSettings) -> None:
        self._settings = settings
        self._estimator: FrictionEstimator | None = None
        self._regression = FrictionRegression()
        self._intervals = False

    def take_rig(self, rig: RigDescription) -> None:
        """Take the rig's description; windows go on where the sample rate stays."""
        if self._estimator is None or self._estimator.rig.sample_rate != rig.sample_rate:
            self._estimator = FrictionEstimator(rig, self._settings)
        self._estimator.rig = rig
        self._regression.take_rig(rig, self._estimator.window_samples, self._settings.minimum_normal_load)
        self._intervals = bool(rig.noise)

    def take_block(self, stamp: int, daq: Samples) -> list[Message]:
        """Take a block of `daq/samples` [ns]; nothing comes of it before the rig is described."""
        if self._estimator is None:
            return []
        mu, valid, windows = self._estimator.add_samples(stamp, daq)
        samples = np.zeros(len(daq), FRICTION_SAMPLE_RECORD)
        samples["t"], samples["mu"], samples["valid"], samples["seq"] = daq["t"], mu, valid, daq["seq"]
        return [(SAMPLES, cdr_from_samples(samples, stamp)), *self._messages(windows)]

    def take_truth(self, truth: Samples) -> list[Message]:
        """Take a block of `truth/samples`."""
        return list(self._messages(self._estimator.add_truth(truth))) if self._estimator is not None else []

    def _messages(self, windows: Sequence[FrictionWindow]) -> Iterator[Message]:
        for window in windows:
            yield WINDOWS, cdr_from_samples(window.as_record(), window.stamp)
            if not math.isnan(window.values["mu"]):
                yield MU, float64_message(window.values["mu"])
            model = self._regression.fit() if self._regression.add_window(window.values) else None
            if model is not None:
                columns = (*MODEL_COLUMNS, *INTERVAL_COLUMNS) if self._intervals else MODEL_COLUMNS
                yield MODEL, multi_array_message([model.row(self._intervals)], _MODEL_NAME, ", ".join(columns))
