"""Fig. 4b: the friction law refitted from a virtual experiment, through instruments and estimator."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from squeal_rig.errors import ExperimentError
from squeal_rig.estimation.friction import FrictionEstimator
from squeal_rig.estimation.regression import FrictionModel, FrictionRegression
from squeal_rig.estimation.settings import FrictionSettings
from squeal_rig.instruments.acquisition import Acquisition
from squeal_rig.instruments.description import RigDescription
from squeal_rig.instruments.settings import BLOCKS_PER_SECOND, RigSettings
from squeal_rig.instruments.virtual import VirtualRig
from squeal_rig.model.parameters import RigParameters

PRELOADS = (50.0, 200.0)
SPEEDS = (1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0)
#: Arms soft enough to slide quietly at every point: below every threshold of the figure.
_QUIET_STIFFNESS = 1.0e7
_WINDOW = 0.1
_WINDOWS = 3


@dataclass(frozen=True)
class FrictionExperiment:
    """Measured points (speed [m/s], preload [N], estimated mu, true mu) and the law fitted to them."""

    points: tuple[tuple[float, float, float, float], ...]
    model: FrictionModel


def measure_friction(p: RigParameters) -> FrictionExperiment:
    """Slide at every point of Fig. 4b, estimate mu by Eq. (2.2) from the measured channels, fit the law.

    Raises:
        ExperimentError: the points do not determine the law.
    """
    regression = FrictionRegression()
    points = []
    for preload in PRELOADS:
        for speed in SPEEDS:
            estimated, true = _slide(p.replace(preload=preload, belt_speed=speed, pad_stiffness=_QUIET_STIFFNESS))
            regression.add(speed, preload, estimated)
            points.append((speed, preload, estimated, true))
    model = regression.fit()
    if model is None:
        raise ExperimentError("the points of the virtual experiment do not determine the friction law")
    return FrictionExperiment(tuple(points), model)


def _slide(p: RigParameters) -> tuple[float, float]:
    """Estimated and true mu at one operating point, means over windows."""
    settings = RigSettings()
    rig = Acquisition(VirtualRig(), p, settings)
    rig.start(0)
    estimator = FrictionEstimator(RigDescription(p, drum_radius=settings.drum_radius), FrictionSettings(window=_WINDOW))
    windows = []
    for _ in range(round(_WINDOW * _WINDOWS * BLOCKS_PER_SECOND)):
        block = rig.next_block()
        windows += estimator.add_samples(block.stamp, block.daq)[2]
        if block.truth is not None:
            windows += estimator.add_truth(block.truth)
    estimated, true = (float(np.mean([w.values[name] for w in windows])) for name in ("mu", "mu_true"))
    return estimated, true
