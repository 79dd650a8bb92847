"""What the targets say of each free parameter: singular values, and the spread of sets that fit as well."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from squeal_rig.estimation.calibration.evaluation import Evaluator
from squeal_rig.estimation.calibration.problem import within_bounds
from squeal_rig.estimation.calibration.search import Found

Values = NDArray[np.float64]
_STEP = 1e-6
#: A direction in which the errors change less than this share of the steepest one is not determined by the targets.
UNDETERMINED = 1e-2
#: A parameter whose equally good values spread over more than this share of the best one is poorly determined.
WIDE = 0.2


@dataclass(frozen=True)
class Identifiability:
    """Of n free parameters.

    - names: the parameters, in the order of the columns
    - singular_values: (n,) of d(error)/d(relative change of a parameter), largest first; zeros at the end
    - directions: (n, n), row i: the relative changes that belong to singular value i, of length 1
    - lower, upper: (n,) smallest and largest value among the sets that fit equally well
    - wide: parameters those sets do not pin down
    """

    names: tuple[str, ...]
    singular_values: Values
    directions: Values
    lower: Values
    upper: Values
    wide: tuple[str, ...]

    def undetermined(self) -> tuple[str, ...]:
        """Each direction that the targets hardly see, in words: relative changes of the parameters."""
        weak = self.singular_values < UNDETERMINED * self.singular_values.max()
        return tuple(
            ", ".join(f"{name} {share:+.2f}" for name, share in zip(self.names, row, strict=True) if abs(share) >= 0.05)
            for row in self.directions[weak]
        )


def identifiability(found: Found) -> Identifiability:
    """Singular values of the errors at the optimum, and the spread over every equally good set that was seen."""
    evaluator = Evaluator(found.problem)
    names = tuple(item.name for item in found.problem.free)
    rows = []
    for name in names:
        changed, step = [], _step_of(found, name)
        # An optimum on a bound is stepped from on one side only.
        ends = [within_bounds(name, getattr(found.rig, name) + side * step) for side in (1.0, -1.0)]
        for end in ends:
            values = {name: end}
            values |= {tied: end for tied, other in found.problem.tied.items() if other == name}
            changed.append(_errors(evaluator, found, values))
        rows.append((changed[0] - changed[1]) * (step / _STEP) / (ends[0] - ends[1]))
    jacobian = np.nan_to_num(np.array(rows).T)
    _, singular, directions = np.linalg.svd(jacobian, full_matrices=True)
    columns = evaluator.coordinates.columns(found.near)
    spread = np.array([_ends(columns[name]) for name in names])
    best = np.array([getattr(found.rig, name) for name in names])
    lower, upper = np.minimum(spread[:, 0], best), np.maximum(spread[:, 1], best)
    wide = tuple(np.array(names)[upper - lower > WIDE * np.abs(best)].tolist())
    return Identifiability(
        names, np.append(singular, np.zeros(len(names) - len(singular))), directions, lower, upper, wide
    )


def _ends(values: object) -> tuple[float, float]:
    column = np.ravel(np.asarray(values, dtype=np.float64))
    return float(column.min()), float(column.max())


def _step_of(found: Found, name: str) -> float:
    """A small change of a parameter: a share of its value, or of its bounds where the value is zero."""
    value = abs(getattr(found.rig, name))
    item = next(item for item in found.problem.free if item.name == name)
    return _STEP * (value if value > 0.0 else item.upper - item.lower)


def _errors(evaluator: Evaluator, found: Found, values: dict[str, float]) -> Values:
    """Errors of every kind that weighs or is limited, one after the other."""
    problem = found.problem
    kinds = tuple(k for k in problem.targets.kinds() if problem.weights.get(k, 0.0) > 0.0 or k in problem.limits)
    judged = evaluator.of_rig(found.rig.replace(**values), kinds)
    return np.concatenate([judged.errors[kind][0] for kind in kinds])
