"""What a set of candidates makes of the targets: errors, roots that are missing, and how candidates rank.

No penalty stands in for a root: a candidate with fewer missing roots ranks before any other, then the one that breaks
demands and limits less, and only then the loss counts.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from squeal_rig.estimation.calibration.problem import Calibration
from squeal_rig.estimation.calibration.targets import JUMP_RANGE, KINDS, Target
from squeal_rig.model.core.law import COEFFICIENTS, friction_basis, friction_law
from squeal_rig.model.linear.maps import map_points
from squeal_rig.model.motion.ensemble import simulate_many
from squeal_rig.model.parameters import RigParameters

Values = NDArray[np.float64]
#: Parameter name -> a number, a word, or a column (S, 1) of one number a candidate.
Columns = Mapping[str, Any]
#: Kinds that take a simulation of the motion.
SIMULATED = ("nonlinear_frequency", "contact_loss")
_PRELOAD_GRID = np.geomspace(1.0, 2000.0, 40)
_BISECTIONS = 40
# A corner of the demand is met up to the digits a preset is written with.
_FRICTION_ROUNDING = 1e-6


@dataclass(frozen=True)
class Evaluation:
    """Candidates (S,) seen by the targets.

    - computed: kind -> (S, n), in the targets' unit; nan where there is none (contact loss: shares of time)
    - errors: kind -> (S, n), relative; of contact loss the difference of shares; nan where either has none
    - missing: roots that should be there and are not, or the other way round
    - outside: how far friction leaves its demand, and errors their limits
    - loss: the weighted measure of the errors; inf where a root is missing
    """

    computed: dict[str, Values]
    errors: dict[str, Values]
    missing: Values
    outside: Values
    loss: Values

    def order(self) -> NDArray[np.intp]:
        """Candidates from best to worst."""
        return np.lexsort((self.loss, self.outside, self.missing))

    def beats(self, other: Evaluation) -> NDArray[np.bool_]:
        """Where a candidate ranks before, or level with, the one at the same place in `other`."""
        fewer, as_many = self.missing < other.missing, self.missing == other.missing
        less, as_far = self.outside < other.outside, self.outside == other.outside
        return np.asarray(fewer | (as_many & (less | (as_far & (self.loss <= other.loss)))))


class Coordinates:
    """The free parameters as coordinates z (S, n) in [0, 1]; a free friction law by its four corners."""

    def __init__(self, problem: Calibration) -> None:
        self._problem = problem
        # A law of as many coefficients as the box has corners is searched by its values there.
        corners = problem.has_free_friction and len(COEFFICIENTS) == 4
        self._own = [item for item in problem.free if not (corners and item.name in COEFFICIENTS)]
        demand = problem.friction
        self.corner_preload = np.array([f for f in demand.preload for _ in range(2)])
        self.corner_speed = np.array([v for _ in range(2) for v in demand.belt_speed])
        self._terms = np.linalg.inv(friction_basis(self.corner_speed, self.corner_preload)) if corners else None
        self.size = len(self._own) + 4 * corners

    def columns(self, z: Values) -> dict[str, object]:
        """Parameter name -> column (S, 1) of every candidate; fixed ones as they are."""
        values: dict[str, object] = dict(self._problem.base.as_mapping())
        for i, item in enumerate(self._own):
            share = z[:, i : i + 1]
            if item.log:
                values[item.name] = item.lower * (item.upper / item.lower) ** share
            else:
                values[item.name] = item.lower + (item.upper - item.lower) * share
        if self._terms is not None:
            demand = self._problem.friction
            mu = demand.lower + (demand.upper - demand.lower) * z[:, len(self._own) :]
            terms = mu @ self._terms.T
            values.update({name: terms[:, i : i + 1] for i, name in enumerate(COEFFICIENTS)})
        values.update({name: values[other] for name, other in self._problem.tied.items()})
        return values

    def parameters(self, z: Values) -> list[RigParameters]:
        """Candidates as rigs; a friction term beyond its own bounds is refused as everywhere."""
        columns = self.columns(z)
        return [_rig(self._problem.base, columns, i) for i in range(len(z))]


def _rig(base: RigParameters, columns: Columns, i: int) -> RigParameters:
    return base.replace(
        **{name: float(value[i, 0]) for name, value in columns.items() if isinstance(value, np.ndarray)}
    )


class Evaluator:
    """Computes `Evaluation`s of one problem, all candidates at once."""

    def __init__(self, problem: Calibration) -> None:
        self.problem = problem
        self.coordinates = Coordinates(problem)

    @property
    def size(self) -> int:
        """Number of coordinates."""
        return self.coordinates.size

    def of(self, z: Values, kinds: tuple[str, ...] | None = None) -> Evaluation:
        """Evaluate candidates z (S, n); only kinds that weigh or are limited, unless others are asked for."""
        columns = self.coordinates.columns(z)
        return self._evaluate(columns, len(z), self._needed() if kinds is None else kinds)

    def of_rig(self, p: RigParameters, kinds: tuple[str, ...] = KINDS) -> Evaluation:
        """Evaluate one rig against every target."""
        columns = {
            name: np.array([[value]]) if isinstance(value, float) else value for name, value in p.as_mapping().items()
        }
        return self._evaluate(columns, 1, kinds)

    def _needed(self) -> tuple[str, ...]:
        weights = self.problem.weights
        return tuple(kind for kind in KINDS if weights.get(kind, 0.0) > 0.0 or kind in self.problem.limits)

    def _evaluate(self, columns: Columns, count: int, kinds: tuple[str, ...]) -> Evaluation:
        targets = {kind: self.problem.targets.of(kind) for kind in kinds if self.problem.targets.of(kind)}
        outside = self._friction_outside(columns, count)
        missing = np.zeros(count)
        computed, errors = {}, {}
        for kind in sorted(targets, key=lambda kind: kind in SIMULATED):
            if kind not in SIMULATED:
                computed[kind] = self._linear(kind, columns, count, targets[kind])
        simulated = [kind for kind in targets if kind in SIMULATED]
        if simulated:
            computed.update(self._nonlinear(columns, count, simulated, outside))
        wanted: dict[str, NDArray[np.bool_]] = {}
        for kind in targets:
            errors[kind] = self._errors(kind, computed[kind], targets[kind])
            wanted[kind] = np.array([not math.isnan(item.value) for item in targets[kind]])
            found = self._found(kind, computed[kind])
            missing += (wanted[kind] != found).sum(axis=1) if self._counts(kind) else 0.0
        loss = np.zeros(count)
        for kind, weight in self.problem.weights.items():
            if weight > 0.0 and kind in errors:
                loss += weight * _measured(errors[kind][:, wanted[kind]], self.problem.measure)
        for kind, limits in self.problem.limits.items():
            for measure, limit in limits.items():
                if kind in errors:
                    over = np.maximum(_measured(errors[kind][:, wanted[kind]], measure) - limit, 0.0)
                    outside += np.where(missing == 0, over, 0.0)
        return Evaluation(computed, errors, missing, outside, np.where(missing == 0, loss, np.inf))

    def _counts(self, kind: str) -> bool:
        return kind in self._needed()

    def _found(self, kind: str, computed: Values) -> NDArray[np.bool_]:
        if kind != "peak_displacement_jump":
            return ~np.isnan(computed)
        inside = (computed >= JUMP_RANGE[0]) & (computed <= JUMP_RANGE[1])
        # A wanted jump counts wherever it lies; an unwanted one where one looked for it.
        wanted = np.array([not math.isnan(item.value) for item in self.problem.targets.of(kind)])
        return np.where(wanted, ~np.isnan(computed), inside)

    def _friction_outside(self, columns: Columns, count: int) -> Values:
        c, demand = self.coordinates, self.problem.friction
        mu = np.broadcast_to(friction_law(columns, c.corner_speed, c.corner_preload), (count, 4))
        over = np.maximum(mu - demand.upper, 0.0) + np.maximum(demand.lower - mu, 0.0)
        return np.asarray(np.where(over > _FRICTION_ROUNDING, over, 0.0).sum(axis=1))

    def _linear(self, kind: str, columns: Columns, count: int, targets: tuple[Target, ...]) -> Values:
        preload = np.array([item.preload for item in targets])
        speed = np.array([item.belt_speed for item in targets])
        k = np.array([item.pad_stiffness for item in targets])
        if kind == "critical_pad_stiffness":
            return self._thresholds(columns, count, preload, speed)
        if kind == "peak_displacement_jump":
            return self._jumps(columns, count, k, speed)
        at = {**columns, "preload": preload, "belt_speed": speed, "k1": k, "k2": k}
        found = map_points(at, bands=False, at_rest=self._at_rest).squeal_frequency
        return np.broadcast_to(found, (count, len(targets)))

    @property
    def _at_rest(self) -> bool:
        return self.problem.equilibrium == "exact"

    def _thresholds(self, columns: Columns, count: int, preload: Values, speed: Values) -> Values:
        at = {**columns, "preload": preload, "belt_speed": speed}
        found = map_points(at, at_rest=self._at_rest).critical_pad_stiffness
        return np.broadcast_to(found, (count, len(preload)))

    def _jumps(self, columns: Columns, count: int, k: Values, speed: Values) -> Values:
        """Smallest preload [N] at which the threshold falls to k, by a grid and bisection; nan where it never does."""
        grid, lines = np.meshgrid(_PRELOAD_GRID, np.arange(len(k)), indexing="ij")
        found = self._thresholds(columns, count, grid.ravel(), speed[lines.ravel()])
        unstable = (found <= k[lines.ravel()]).reshape(count, len(_PRELOAD_GRID), len(k))
        first = unstable.argmax(axis=1)
        result = np.where(unstable.any(axis=1), _PRELOAD_GRID[first], np.nan)
        for i, j in zip(*np.nonzero(unstable.any(axis=1) & (first > 0)), strict=True):
            one = {n: v[i : i + 1] if isinstance(v, np.ndarray) else v for n, v in columns.items()}
            low, high = _PRELOAD_GRID[first[i, j] - 1], _PRELOAD_GRID[first[i, j]]
            for _ in range(_BISECTIONS):
                middle = 0.5 * (low + high)
                if self._thresholds(one, 1, np.array([middle]), speed[j : j + 1])[0, 0] <= k[j]:
                    high = middle
                else:
                    low = middle
            result[i, j] = high
        return result

    def _nonlinear(self, columns: Columns, count: int, kinds: list[str], outside: Values) -> dict[str, Values]:
        """Frequency [Hz] and share of time off the belt, from the motion itself."""
        s = self.problem.simulation
        result = {}
        points = sorted({_point(item) for kind in kinds for item in self.problem.targets.of(kind)})
        ready = np.flatnonzero(outside == 0.0)
        rigs = [_rig(self.problem.base, columns, int(i)) for i in ready]
        runs = [p.replace(preload=f, belt_speed=v, pad_stiffness=k) for p in rigs for f, v, k in points]
        if runs:
            motion = simulate_many(runs, s.duration, settle=s.settle, initial_compressions=s.compressions).summaries
        for kind in kinds:
            table = np.full((count, len(points)), np.nan)
            if runs:
                values = motion["squeal_frequency"] if kind == "nonlinear_frequency" else motion["contact_loss_time"]
                table[ready] = values.reshape(len(ready), len(points)) / (1.0 if kind != "contact_loss" else s.duration)
            result[kind] = table[:, [points.index(_point(item)) for item in self.problem.targets.of(kind)]]
        return result

    def _errors(self, kind: str, computed: Values, targets: tuple[Target, ...]) -> Values:
        values = np.array([item.value for item in targets])
        if kind != "contact_loss":
            return np.asarray(computed / values - 1.0)
        record = self.problem.simulation.record
        if record == 0.0:  # the length that suits the shares best, by least squares
            scale = np.sum(computed * values, axis=1, keepdims=True) / np.sum(values**2)
        else:
            scale = np.full((len(computed), 1), 1.0 / record)
        return np.asarray(computed - scale * values)


def _point(item: Target) -> tuple[float, float, float]:
    return item.preload, item.belt_speed, item.pad_stiffness


def _measured(errors: Values, measure: str) -> Values:
    """RMS, mean or largest of the errors (S, n) of what is wanted; one that could not be computed counts elsewhere."""
    if not errors.shape[1]:
        return np.zeros(len(errors))
    size = np.where(np.isnan(errors), 0.0, np.abs(errors))
    if measure == "rms":
        return np.asarray(np.sqrt(np.mean(size**2, axis=1)))
    return np.asarray(size.mean(axis=1) if measure == "mean" else size.max(axis=1))
