"""Global search and local polish of a calibration, several starts, from one seed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from squeal_rig.errors import ModelError
from squeal_rig.estimation.calibration.evaluation import Evaluation, Evaluator
from squeal_rig.estimation.calibration.problem import Calibration
from squeal_rig.model.parameters import RigParameters

Values = NDArray[np.float64]


class Ranked(Protocol):
    """What the global search needs: candidates in the unit box, and how they rank."""

    @property
    def size(self) -> int:
        """Number of coordinates."""

    def of(self, z: Values) -> Evaluation:
        """Judge candidates z (S, n)."""


#: Called with the start (from 0), the generations in all and the one just done.
Progress = Callable[[int, int, int], None]

GENERATIONS = 600
_PER_COORDINATE = 15
_CROSSOVER = 0.9
_SCALES = (0.4, 0.9)
_CONVERGED = 1e-10
#: Candidates count as equally good up to this factor on the loss.
EQUALLY_GOOD = 1.05
_KEPT = 400


@dataclass(frozen=True)
class Found:
    """Result of a calibration.

    `rig` is the best one; `z` its coordinates (n,); `starts` the loss each start ended with; `near` coordinates (S, n)
    of candidates seen on the way with a loss within `EQUALLY_GOOD` of the best; `missing` roots the best one lacks.
    """

    problem: Calibration
    seed: int
    rig: RigParameters
    z: Values
    loss: float
    missing: int
    outside: float
    starts: tuple[float, ...]
    near: Values


def calibrate(
    problem: Calibration,
    seed: int = 1,
    starts: int = 4,
    generations: int = GENERATIONS,
    progress: Progress | None = None,
) -> Found:
    """Solve an inverse problem: the same seed gives the same rig.

    Args:
        problem: what is free and what is to be met.
        seed: of all starts.
        starts: independent searches, each polished.
        generations: at most, of each search.
        progress: called once a generation.

    Raises:
        ModelError: fewer than one start or generation.
    """
    if starts < 1 or generations < 1:
        raise ModelError(f"starts = {starts} and generations = {generations} must both be 1 or more")
    evaluator = Evaluator(problem)
    seeds = np.random.SeedSequence(seed).spawn(starts)
    ends, losses, archive = [], [], []
    for number, own in enumerate(seeds):
        rng = np.random.default_rng(own)
        tell = partial(progress, number, generations) if progress else _silent
        z, seen = evolve(evaluator, rng, _PER_COORDINATE * evaluator.size, generations, tell)
        z = _polish(evaluator, z)
        ends.append(z)
        archive.append(seen)
        losses.append(float(evaluator.of(z[None]).loss[0]))
    pool = np.array(ends)
    judged = evaluator.of(pool)
    best = int(judged.order()[0])
    near = _near(evaluator, np.vstack([pool, *archive]), float(judged.loss[best]))
    return Found(
        problem=problem,
        seed=seed,
        rig=evaluator.coordinates.parameters(pool[best : best + 1])[0],
        z=pool[best],
        loss=float(judged.loss[best]),
        missing=int(judged.missing[best]),
        outside=float(judged.outside[best]),
        starts=tuple(losses),
        near=near if len(near) else pool[best : best + 1],
    )


def _silent(generation: int) -> None:
    """Where nobody watches."""


def _near(evaluator: Evaluator, candidates: Values, loss: float) -> Values:
    judged = evaluator.of(candidates)
    good = (judged.missing == 0) & (judged.outside == 0.0) & (judged.loss <= EQUALLY_GOOD * loss + 1e-12)
    return np.asarray(candidates[good])


def evolve(
    evaluator: Ranked,
    rng: np.random.Generator,
    count: int,
    generations: int,
    progress: Callable[[int], object],
) -> tuple[Values, Values]:
    """Differential evolution (best/1/bin, scale drawn anew each generation) in the unit box, ranked by `Evaluation`.

    Returns the best candidate and a sample of what was accepted after convergence had begun.
    """
    n = evaluator.size
    z = (rng.permuted(np.tile(np.arange(count), (n, 1)), axis=1).T + rng.random((count, n))) / count
    judged = evaluator.of(z)
    seen: list[Values] = []
    for generation in range(1, generations + 1):
        best = z[judged.order()[0]]
        # Half the population follows the best, the other half somebody: it does not collapse at once.
        base = np.where(rng.random((count, 1)) < 0.5, best, z[rng.integers(count, size=count)])
        a, b = z[rng.integers(count, size=count)], z[rng.integers(count, size=count)]
        mutant = base + rng.uniform(*_SCALES, size=(count, 1)) * (a - b)
        crossed = rng.random((count, n)) < _CROSSOVER
        crossed[np.arange(count), rng.integers(n, size=count)] = True
        trial = np.where(crossed, mutant, z)
        beyond = (trial < 0.0) | (trial > 1.0)
        # Back from a bound to half the way there: optima on a bound are still reached, as closely as one likes.
        trial = np.where(beyond, 0.5 * (z + np.where(trial < 0.0, 0.0, 1.0)), trial)
        tried = evaluator.of(trial)
        better = tried.beats(judged)
        z = np.where(better[:, None], trial, z)
        judged = _merged(judged, tried, better)
        seen.append(trial[better])
        progress(generation)
        worst = judged.loss.max()
        if np.isfinite(worst) and np.ptp(judged.loss) <= _CONVERGED * abs(worst):
            break
    everything = np.vstack(seen[-generations:])
    chosen = everything[rng.permutation(len(everything))[: _KEPT * n]]
    return z[judged.order()[0]], chosen


def _merged(old: Evaluation, new: Evaluation, better: NDArray[np.bool_]) -> Evaluation:
    return Evaluation(
        {},
        {},
        np.where(better, new.missing, old.missing),
        np.where(better, new.outside, old.outside),
        np.where(better, new.loss, old.loss),
    )


class _Smooth:
    """The problem as a smooth programme in (z, t): t_i >= |error_i| stands for an error in a mean, one t for all."""

    def __init__(self, evaluator: Evaluator, z: Values) -> None:
        self.evaluator = evaluator
        problem = evaluator.problem
        self.n = len(z)
        self.kinds = list(evaluator.of(z[None]).errors)
        self.weights = [problem.weights.get(kind, 0.0) for kind in self.kinds]
        self.limits = [dict(problem.limits.get(kind, {})) for kind in self.kinds]
        self.measure = problem.measure
        self._key: bytes = b""

    def at(self, z: Values) -> tuple[list[Values], list[Values]]:
        """Errors of each kind and their derivatives (m, n), by central differences in one vectorised call."""
        if z.tobytes() != self._key:
            step = 1e-6
            inside = np.clip(z, step, 1.0 - step)
            moves = step * np.eye(self.n)
            # Beyond the unit box by rounding at most; the errors themselves are taken at z.
            judged = self.evaluator.of(np.vstack([z[None], inside + moves, inside - moves]), tuple(self.kinds))
            self._errors, self._slopes = [], []
            for kind in self.kinds:
                e = judged.errors[kind]
                wanted = ~np.isnan([item.value for item in self.evaluator.problem.targets.of(kind)])
                e = e[:, wanted]
                self._errors.append(e[0])
                self._slopes.append(((e[1 : self.n + 1] - e[self.n + 1 :]) / (2.0 * step)).T)
            self._key = z.tobytes()
        return self._errors, self._slopes

    def start(self, z: Values) -> Values:
        return np.concatenate([z, *[np.abs(e) for e in self.at(z)[0]]])

    def loss(self, zt: Values) -> tuple[float, Values]:
        errors, slopes = self.at(zt[: self.n])
        total, gradient, place = 0.0, np.zeros(len(zt)), self.n
        for w, e, s in zip(self.weights, errors, slopes, strict=True):
            t = zt[place : place + len(e)]
            if self.measure == "rms":
                size = float(np.sqrt(np.mean(e**2)))
                total += w * size
                gradient[: self.n] += w * (e @ s) / (len(e) * max(size, 1e-12))
            elif self.measure == "mean":
                total += w * float(t.mean())
                gradient[place : place + len(e)] = w / len(e)
            else:  # every t of the kind is held level by the constraints: the first stands for all
                total += w * float(t[0])
                gradient[place] = w
            place += len(e)
        return total, gradient

    def constraints(self, zt: Values) -> tuple[Values, Values]:
        """Values (>= 0 where met) and derivatives of every inequality."""
        errors, slopes = self.at(zt[: self.n])
        values, rows, place = [], [], self.n
        for limits, e, s in zip(self.limits, errors, slopes, strict=True):
            m = len(e)
            t = zt[place : place + m]
            unit = np.zeros((m, len(zt)))
            # With the largest error the first t bounds all of them.
            columns = np.full(m, place) if self.measure == "largest" else np.arange(place, place + m)
            unit[np.arange(m), columns] = 1.0
            bound = zt[columns]
            for sign in (1.0, -1.0):
                row = unit.copy()
                row[:, : self.n] = -sign * s
                values.append(bound - sign * e)
                rows.append(row)
            for measure, limit in limits.items():
                row = np.zeros((1, len(zt)))
                if measure == "rms":
                    size = float(np.sqrt(np.mean(e**2)))
                    row[0, : self.n] = -(e @ s) / (m * max(size, 1e-12))
                    values.append(np.array([limit - size]))
                elif measure == "mean":
                    row[0, place : place + m] = -1.0 / m
                    values.append(np.array([limit - t.mean()]))
                else:
                    row = np.zeros((m, len(zt)))
                    row[np.arange(m), columns] = -1.0
                    values.append(limit - bound)
                rows.append(row)
            place += m
        return np.concatenate(values), np.vstack(rows)


def _polish(evaluator: Evaluator, z: Values) -> Values:
    """Sequential quadratic programming from z, kept only where it ranks before z."""
    judged = evaluator.of(z[None])
    if judged.missing[0] > 0 or any(kind in judged.errors for kind in ("contact_loss", "nonlinear_frequency")):
        return z  # nothing smooth to go down on
    smooth = _Smooth(evaluator, z)
    start = smooth.start(z)
    found = minimize(
        smooth.loss,
        start,
        jac=True,
        bounds=[(0.0, 1.0)] * len(z) + [(0.0, None)] * (len(start) - len(z)),
        constraints={
            "type": "ineq",
            "fun": lambda zt: smooth.constraints(zt)[0],
            "jac": lambda zt: smooth.constraints(zt)[1],
        },
        method="SLSQP",
        options={"maxiter": 300, "ftol": 1e-13},
    )
    ends = np.clip(found.x[: len(z)], 0.0, 1.0)
    if not np.isfinite(ends).all():
        return z
    pair = np.array([ends, z])
    return np.asarray(pair[evaluator.of(pair).order()[0]])
