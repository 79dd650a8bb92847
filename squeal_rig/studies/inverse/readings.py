"""The readings of the paper's geometry, each fitted for itself: which of them can give the reported thresholds."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from squeal_rig.estimation.calibration.evaluation import Evaluator
from squeal_rig.estimation.calibration.problem import Calibration, Free
from squeal_rig.estimation.calibration.search import calibrate
from squeal_rig.model.core.statics import equilibrium
from squeal_rig.model.parameters import RigParameters

_THIRD_QUARTER, _QUARTER = 0.75 * math.pi, 0.25 * math.pi
_ANGLES = (Free("arm_angle_1", 0.0, math.pi), Free("arm_angle_2", 0.0, math.pi))
# Pretension at most a tenth of the shortest arm: beyond, the pad would hang at another place than the drawn one.
_LENGTHS = (
    Free("arm_length_1", 0.01, 1.0, log=True),
    Free("arm_length_2", 0.01, 1.0, log=True),
    Free("pretension_length", 1e-7, 1e-3, log=True),
)
# Generations at the true equilibrium, where a candidate costs milliseconds: lengths fixed, and free.
_EXACT_GENERATIONS = {False: 40, True: 120}


@dataclass(frozen=True)
class Reading:
    """One reading of the geometry: angles [rad] or None where free, lengths free or as in the base."""

    name: str
    angles: tuple[float, float] | None
    equilibrium: str
    preload_direction: str
    free_lengths: bool

    def problem(self, base: Calibration) -> Calibration:
        """The base's inverse problem with this reading in place of its own; limits are dropped."""
        first, second = self.angles or (base.base.arm_angle_1, base.base.arm_angle_2)
        rig = base.base.replace(arm_angle_1=first, arm_angle_2=second, preload_direction=self.preload_direction)
        free = (*base.free, *(() if self.angles else _ANGLES), *(_LENGTHS if self.free_lengths else ()))
        weights = {"critical_pad_stiffness": 1.0, "squeal_frequency": 0.1}
        return replace(base, base=rig, free=free, weights=weights, limits={}, equilibrium=self.equilibrium)


READINGS = (
    Reading("both arms at 135 degrees", (_THIRD_QUARTER, _THIRD_QUARTER), "linear", "vertical", False),
    Reading("both angles free", None, "linear", "vertical", False),
    Reading("135 and 45 degrees, as printed", (_THIRD_QUARTER, _QUARTER), "linear", "vertical", False),
    Reading("both at 135, true equilibrium", (_THIRD_QUARTER, _THIRD_QUARTER), "exact", "vertical", False),
    Reading(
        "both at 135, true equilibrium, preload along arms", (_THIRD_QUARTER, _THIRD_QUARTER), "exact", "arms", False
    ),
    Reading(
        "both at 135, true equilibrium, preload along arms, lengths free",
        (_THIRD_QUARTER, _THIRD_QUARTER),
        "exact",
        "arms",
        True,
    ),
    Reading("135 and 45, true equilibrium, lengths free", (_THIRD_QUARTER, _QUARTER), "exact", "vertical", True),
    Reading("both angles free, true equilibrium, preload along arms, lengths free", None, "exact", "arms", True),
)


@dataclass(frozen=True)
class Fit:
    """The best rig of a reading. `missing`: how many thresholds, frequencies do not exist; errors as shares, nan then.

    `turned`: largest displacement of the pad at rest as a share of the shorter arm, over the corners of the demand.
    """

    reading: Reading
    rig: RigParameters
    missing_thresholds: int
    missing_frequencies: int
    threshold_mean: float
    threshold_rms: float
    threshold_largest: float
    frequency_mean: float
    turned: float


def fit_readings(
    base: Calibration,
    readings: Sequence[Reading] = READINGS,
    seed: int = 1,
    starts: int = 3,
    progress: Callable[[int, int], object] = lambda done, total: None,
) -> list[Fit]:
    """Fit each reading by itself, in thresholds and, with a tenth of their weight, frequencies.

    Args:
        base: gives targets, the machine's free parameters and the demand on friction.
        readings: which of them.
        seed, starts: of each search; at the true equilibrium, where each root takes a scan, one start.
        progress: called with the readings done and all of them.
    """
    fits = []
    for number, reading in enumerate(readings, 1):
        exact = reading.equilibrium == "exact"
        problem = reading.problem(base)
        found = (
            calibrate(problem, seed, 1, _EXACT_GENERATIONS[reading.free_lengths])
            if exact
            else calibrate(problem, seed, starts)
        )
        fits.append(_fit(reading, problem, found.rig))
        progress(number, len(readings))
    return fits


def _fit(reading: Reading, problem: Calibration, p: RigParameters) -> Fit:
    judged = Evaluator(problem).of_rig(p, ("critical_pad_stiffness", "squeal_frequency"))
    thresholds = np.abs(judged.errors["critical_pad_stiffness"][0])
    frequencies = np.abs(judged.errors["squeal_frequency"][0])
    return Fit(
        reading=reading,
        rig=p,
        missing_thresholds=int(np.isnan(thresholds).sum()),
        missing_frequencies=int(np.isnan(frequencies).sum()),
        threshold_mean=float(thresholds.mean()),
        threshold_rms=float(np.sqrt(np.mean(thresholds**2))),
        threshold_largest=float(thresholds.max()),
        frequency_mean=float(frequencies.mean()),
        turned=_turned(problem, p),
    )


def _turned(problem: Calibration, p: RigParameters) -> float:
    linear = problem.equilibrium == "linear"
    corners = [(f, v) for f in problem.friction.preload for v in problem.friction.belt_speed]
    places = [equilibrium(p.replace(preload=f, belt_speed=v), linear=linear) for f, v in corners]
    return max(math.hypot(*place) for place in places) / min(p.arm_length_1, p.arm_length_2)


def reading_rows(fits: Sequence[Fit]) -> list[dict[str, str]]:
    """The fits as rows of text, for a CSV file; an error that does not exist reads none."""
    return [
        {
            "reading": fit.reading.name,
            "missing_thresholds": str(fit.missing_thresholds),
            "missing_frequencies": str(fit.missing_frequencies),
            "threshold_mean": _share(fit.threshold_mean),
            "threshold_rms": _share(fit.threshold_rms),
            "threshold_largest": _share(fit.threshold_largest),
            "frequency_mean": _share(fit.frequency_mean),
            "arm_angle_1_deg": f"{math.degrees(fit.rig.arm_angle_1):.2f}",
            "arm_angle_2_deg": f"{math.degrees(fit.rig.arm_angle_2):.2f}",
            "arm_length_1": f"{fit.rig.arm_length_1:.4g}",
            "arm_length_2": f"{fit.rig.arm_length_2:.4g}",
            "pretension_length": f"{fit.rig.pretension_length:.4g}",
            "displacement_over_arm": f"{fit.turned:.2e}",
            "mass": f"{fit.rig.mass:.4g}",
            "contact_stiffness": f"{fit.rig.contact_stiffness:.5g}",
            "clip_stiffness": f"{fit.rig.k3 + fit.rig.k4:.5g}",
        }
        for fit in fits
    ]


def _share(value: float) -> str:
    return "none" if math.isnan(value) else f"{value:.4f}"
