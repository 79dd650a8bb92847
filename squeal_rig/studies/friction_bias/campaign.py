"""A campaign of steady sliding through a rig's instruments, many times: does the refitted law's interval cover it?

The motion is integrated once, with the rig's actuators; instruments do not act back on it, so each repeat is another
specimen of every instrument reading the same motion. Steady sliding has nothing above some hundred Hz: the sample rate
is a tenth of the rig's.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from squeal_rig.errors import ExperimentError
from squeal_rig.estimation.friction import FrictionEstimator
from squeal_rig.estimation.regression import FrictionModel, FrictionRegression
from squeal_rig.estimation.settings import FrictionSettings
from squeal_rig.instruments.acquisition import Acquisition
from squeal_rig.instruments.chain import Chain
from squeal_rig.instruments.data_sheets import DataSheets
from squeal_rig.instruments.description import RigDescription
from squeal_rig.instruments.driver import Samples
from squeal_rig.instruments.settings import BLOCKS_PER_SECOND, RigSettings
from squeal_rig.instruments.tolerances import promises
from squeal_rig.instruments.virtual import VirtualRig
from squeal_rig.model.core.law import COEFFICIENTS
from squeal_rig.model.parameters import RigParameters

SAMPLE_RATE = 5100
PRELOADS = (50.0, 125.0, 200.0)
SPEEDS = (1.0, 2.0, 3.0, 4.0)
#: Time at each operating point [s]: settling, and eight windows of 0.2 s.
DWELL = 2.2
# Time constant of the temperature [s], and how much of a motion instruments see before [s]: 0.2 % of the rise is left.
_WARMING, _WARM_AFTER = 1.0, 6.0


@dataclass(frozen=True)
class Campaign:
    """True values of a campaign: what ideal instruments read at each operating point, and the set points."""

    settings: RigSettings
    sheets: DataSheets
    blocks: list[Samples]
    set_points: list[RigParameters]


def slide(p: RigParameters, sheets: DataSheets) -> Campaign:
    """Slide at every point of `PRELOADS` and `SPEEDS`, with the sheets' actuators."""
    settings = RigSettings(sample_rate=SAMPLE_RATE)
    actuators = DataSheets(hydraulics=sheets.hydraulics, belt_drive=sheets.belt_drive)
    points = [p.replace(preload=preload, belt_speed=speed) for preload in PRELOADS for speed in SPEEDS]
    rig = Acquisition(VirtualRig(actuators), points[0], settings)
    rig.start(0)
    blocks, set_points = [], []
    for point in points:
        rig.set_point = point
        # In one piece: the motion is the same however it is divided, and what reads it is faster.
        daq = np.concatenate([rig.next_block().daq for _ in range(round(DWELL * BLOCKS_PER_SECOND))])
        daq["t"] = np.arange(len(daq)) / SAMPLE_RATE
        blocks.append(daq)
        set_points.append(point)
    return Campaign(settings, sheets, blocks, set_points)


def measure(campaign: Campaign, seed: int) -> FrictionModel:
    """The law as one specimen of the instruments tells it.

    Raises:
        ExperimentError: the points do not determine it.
    """
    settings = campaign.settings
    chain = warm_chain(campaign.sheets, settings.sample_rate, seed, campaign.blocks[0])
    estimator, regression, known = None, FrictionRegression(), None
    time = 0
    for daq, point in zip(campaign.blocks, campaign.set_points, strict=True):
        if point is not known:
            rig = described(point, campaign.sheets, settings)
            estimator = estimator or FrictionEstimator(rig, FrictionSettings())
            estimator.rig, known = rig, point
            regression.take_rig(rig, estimator.window_samples, FrictionSettings().minimum_normal_load)
        assert estimator is not None
        seen = daq.copy()
        chain.measure(seen)
        for window in estimator.add_samples(time, seen)[2]:
            regression.add_window(window.values)
        time += len(seen) * 10**9 // settings.sample_rate
    model = regression.fit()
    if model is None:
        raise ExperimentError("the points of the campaign do not determine the friction law")
    return model


def warm_chain(sheets: DataSheets, sample_rate: int, seed: int, motion: Samples) -> Chain:
    """One specimen of the instruments of a warm rig, which the sheets' bounds are of; it has seen `motion` before."""
    warm = dataclasses.replace(sheets.environment, temperature_time=_WARMING)
    chain = Chain(dataclasses.replace(sheets, environment=warm), sample_rate, seed)
    for _ in range(math.ceil(_WARM_AFTER * sample_rate / len(motion))):
        chain.measure(motion.copy())
    return chain


def described(p: RigParameters, sheets: DataSheets, settings: RigSettings) -> RigDescription:
    """A rig's description with what its data sheets promise, and without truth to wait for."""
    return RigDescription(
        p,
        publishes_truth=False,
        sample_rate=settings.sample_rate,
        drum_radius=settings.drum_radius,
        instruments=sheets.name,
        **promises(sheets, p, settings),  # type: ignore[arg-type]
    )


def covered(model: FrictionModel, p: RigParameters) -> Mapping[str, bool]:
    """Coefficient -> whether its 95 % interval holds that of `p`."""
    return {name: abs(model.coefficients[name] - getattr(p, name)) <= model.half_widths[name] for name in COEFFICIENTS}


def repeats(p: RigParameters, sheets: DataSheets, seeds: range) -> Iterator[FrictionModel]:
    """The law as each of many specimens tells it."""
    campaign = slide(p, sheets)
    for seed in seeds:
        yield measure(campaign, seed)


def coverage(models: list[FrictionModel], p: RigParameters) -> dict[str, float]:
    """Coefficient -> share of the models whose interval covers that of `p`."""
    inside = [covered(model, p) for model in models]
    return {name: float(np.mean([one[name] for one in inside])) for name in COEFFICIENTS}
