"""The trade-off of the paper's inverse problem: thresholds against Table 1's frequencies, and against mass."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from squeal_rig.estimation.calibration.evaluation import Evaluator
from squeal_rig.estimation.calibration.problem import Calibration
from squeal_rig.estimation.calibration.search import calibrate
from squeal_rig.model.parameters import RigParameters

#: Weights of the frequencies against the thresholds' 1, and upper bounds of the mass [kg], of the usual curve.
WEIGHTS = (0.01, 0.03, 0.1, 0.2, 0.3, 0.5, 1.0, 2.0, 4.0, 10.0)
MASSES = (10.0, 11.5, 15.0, 20.0, 30.0, 50.0, 100.0, 200.0)
#: Weight of the frequencies along the masses: small, so that the mass goes to the thresholds.
WEIGHT_ALONG_MASSES = 0.1


@dataclass(frozen=True)
class TradeOff:
    """One point: what was asked, the rig, and its relative errors as shares; `frequencies` [Hz] lowest and highest."""

    weight: float
    largest_mass: float
    rig: RigParameters
    threshold_mean: float
    threshold_rms: float
    threshold_largest: float
    frequency_mean: float
    frequency_largest: float
    frequencies: tuple[float, float]


def trade_off(
    problem: Calibration,
    weights: Sequence[float] = WEIGHTS,
    masses: Sequence[float] = MASSES,
    seed: int = 1,
    starts: int = 6,
    progress: Callable[[int, int], object] = lambda done, total: None,
) -> list[TradeOff]:
    """Best rigs over the weight of the frequencies, at the problem's bound of the mass, then over that bound.

    Args:
        problem: with mass among the free parameters; its weights and limits are replaced.
        weights: of the squeal frequencies, where a threshold weighs 1.
        masses: upper bounds of the mass [kg].
        seed, starts: of each search.
        progress: called with the points done and the points in all.
    """
    largest = next(item.upper for item in problem.free if item.name == "mass")
    asked = [(weight, largest) for weight in weights] + [(WEIGHT_ALONG_MASSES, mass) for mass in masses]
    points = []
    for number, (weight, mass) in enumerate(asked, 1):
        points.append(_point(problem, weight, mass, seed, starts))
        progress(number, len(asked))
    return points


def _point(problem: Calibration, weight: float, mass: float, seed: int, starts: int) -> TradeOff:
    free = tuple(replace(item, upper=mass) if item.name == "mass" else item for item in problem.free)
    weights = {"critical_pad_stiffness": 1.0, "squeal_frequency": weight}
    found = calibrate(replace(problem, free=free, weights=weights, limits={}), seed, starts)
    judged = Evaluator(found.problem).of_rig(found.rig, ("critical_pad_stiffness", "squeal_frequency"))
    thresholds = np.abs(judged.errors["critical_pad_stiffness"][0])
    frequencies = np.abs(judged.errors["squeal_frequency"][0])
    computed = judged.computed["squeal_frequency"][0]
    return TradeOff(
        weight=weight,
        largest_mass=mass,
        rig=found.rig,
        threshold_mean=float(thresholds.mean()),
        threshold_rms=float(np.sqrt(np.mean(thresholds**2))),
        threshold_largest=float(thresholds.max()),
        frequency_mean=float(frequencies.mean()),
        frequency_largest=float(frequencies.max()),
        frequencies=(float(computed.min()), float(computed.max())),
    )


def trade_off_rows(points: Sequence[TradeOff]) -> list[dict[str, str]]:
    """The points as rows of text, for a CSV file."""
    return [
        {
            "frequency_weight": f"{point.weight:g}",
            "largest_mass_kg": f"{point.largest_mass:g}",
            "mass_kg": f"{point.rig.mass:.4g}",
            "threshold_mean": f"{point.threshold_mean:.4f}",
            "threshold_rms": f"{point.threshold_rms:.4f}",
            "threshold_largest": f"{point.threshold_largest:.4f}",
            "frequency_mean": f"{point.frequency_mean:.4f}",
            "frequency_largest": f"{point.frequency_largest:.4f}",
            "lowest_frequency_hz": f"{point.frequencies[0]:.1f}",
            "highest_frequency_hz": f"{point.frequencies[1]:.1f}",
            "contact_stiffness": f"{point.rig.contact_stiffness:.5g}",
            "clip_stiffness": f"{point.rig.k3 + point.rig.k4:.5g}",
        }
        for point in points
    ]
