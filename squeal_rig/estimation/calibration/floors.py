"""How close any first-order reading can come: k + D/k bilinear in preload and belt speed.

For every first-order reading, any arm angles, the lower stability root obeys k + D/k = L(V, F) with L bilinear and
D >= 0 (docs/physics.md). Divided by D: 1/k + B k = l, with l = L/D again bilinear and B = 1/D >= 0, which holds the
limit of infinite D (B = 0) as well. Five numbers for all thresholds: the floors are what is left of the errors.
"""

from __future__ import annotations

from dataclasses import dataclass
from inspect import signature
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import differential_evolution, linprog, minimize

from squeal_rig.errors import ModelError
from squeal_rig.estimation.calibration.targets import Targets

Values = NDArray[np.float64]
_SUBSET = 4
_BISECTIONS = 40
_STARTS = (0.0, 0.1, 0.3)  # B in units of 1/k_max^2


@dataclass(frozen=True)
class Floors:
    """Smallest relative errors that a bilinear k + D/k allows, each for itself, as shares."""

    rms: float
    mean: float
    largest: float


def bilinear_floors(targets: Targets) -> Floors:
    """Floors of the relative errors of the thresholds in `targets`.

    The largest error by linear programming, RMS and mean by local searches from every interpolation of four thresholds.

    Raises:
        ModelError: there are fewer than four thresholds.
    """
    points = _points(targets)
    return Floors(_best(points, "rms"), _best(points, "mean"), largest_floor(targets))


def largest_floor(targets: Targets) -> float:
    """The smallest largest relative error, by bisection over a linear programme in the four terms of l and B.

    |k_i/p_i - 1| <= e wherever h(p_i (1 + e)) <= l_i <= h(p_i (1 - e)) with h(k) = 1/k + B k, which falls up to
    k = 1/sqrt(B). B may therefore reach 1/(p_max (1 + e))^2 here; `searched_floor` lets it reach 1/p_max^2.
    """
    basis, k = _points(targets)
    lower, upper = 0.0, 0.5
    for _ in range(_BISECTIONS):
        middle = 0.5 * (lower + upper)
        if _reachable(basis, k, middle):
            upper = middle
        else:
            lower = middle
    return upper


def _reachable(basis: Values, k: Values, error: float) -> bool:
    high, low = k * (1.0 + error), k * (1.0 - error)
    # Unknowns: four terms of l and B, in units that make every entry of order 1.
    rows = np.vstack(
        [np.column_stack([-basis, high]), np.column_stack([basis, -low])],
    )
    bound = np.concatenate([-1.0 / high, 1.0 / low])
    bounds = [(None, None)] * _SUBSET + [(0.0, 1.0 / high.max() ** 2)]
    solved = linprog(np.zeros(_SUBSET + 1), A_ub=rows, b_ub=bound, bounds=bounds, method="highs")
    return bool(solved.status == 0)


def searched_floor(targets: Targets, measure: str, seed: int = 0) -> float:
    """The same floor by global search without any derivative: differential evolution over the corners of l and B.

    Args:
        targets: with at least four thresholds.
        measure: rms, mean or largest.
        seed: of the search.
    """
    basis, k = _points(targets)
    # Corners of the box of operating points: l there is of the order of 1/k, which makes good bounds.
    corners = np.linalg.pinv(np.array([[1.0, v, f, v * f] for v in (-1.0, 1.0) for f in (-1.0, 1.0)]))

    def loss(z: Values) -> Values:
        terms = corners @ z[:4]
        return _measure(_errors(basis @ terms, z[4], k), measure)

    bounds = [(0.2 / k.max(), 2.0 / k.min())] * 4 + [(0.0, 1.0 / k.max() ** 2)]
    # Before SciPy 1.15 `rng` was called `seed`.
    seeded: dict[str, Any] = {"rng" if "rng" in signature(differential_evolution).parameters else "seed": seed}
    found = differential_evolution(
        loss, bounds, popsize=30, maxiter=3000, tol=1e-10, vectorized=True, updating="deferred", polish=False, **seeded
    )
    return float(found.fun)


def _points(targets: Targets) -> tuple[Values, Values]:
    """Basis (n, 4) of a bilinear function on the box scaled to [-1, 1]^2, and the thresholds in units of their mean."""
    items = targets.of("critical_pad_stiffness")
    if len(items) < _SUBSET:
        raise ModelError(f"floors need at least {_SUBSET} thresholds, and there are {len(items)}")
    k = np.array([item.value for item in items])
    f, v = (_scaled([getattr(item, name) for item in items]) for name in ("preload", "belt_speed"))
    return np.column_stack([np.ones_like(f), v, f, v * f]), k / k.mean()


def _scaled(values: list[float]) -> Values:
    low, high = min(values), max(values)
    return np.array([2.0 * (value - low) / (high - low) - 1.0 if high > low else 0.0 for value in values])


def _errors(ell: Values, b: Values | float, k: Values) -> Values:
    """Relative errors of the lower roots of 1/k + B k = l; nan where there is none. `ell` (n,) or (n, S)."""
    under = ell**2 - 4.0 * b
    exists = (ell > 0.0) & (under >= 0.0)
    root = 2.0 / np.where(exists, ell + np.sqrt(np.where(exists, under, 1.0)), np.nan)
    return np.asarray(root / (k[:, None] if ell.ndim > 1 else k) - 1.0)


def _measure(errors: Values, measure: str) -> Values:
    """One number for each column of errors; infinite where a root is missing: such a candidate never wins."""
    size = np.abs(errors)
    with np.errstate(invalid="ignore"):
        if measure == "rms":
            result = np.sqrt(np.mean(size**2, axis=0))
        else:
            result = size.mean(axis=0) if measure == "mean" else size.max(axis=0)
    return np.asarray(np.where(np.isnan(result), np.inf, result))


def _best(points: tuple[Values, Values], measure: str) -> float:
    """Smallest RMS or mean over local searches from every interpolation of four thresholds and some values of B."""
    basis, k = points
    best = np.inf
    for subset in combinations(range(len(k)), _SUBSET):
        rows = list(subset)
        if abs(np.linalg.det(basis[rows])) < 1e-9:
            continue
        for b in np.array(_STARTS) / k.max() ** 2:
            terms = np.linalg.solve(basis[rows], 1.0 / k[rows] + b * k[rows])
            errors = _errors(basis @ terms, b, k)
            # An interpolation far off leads nowhere that a near one does not.
            if not np.all(np.abs(errors) < 0.5):
                continue
            best = min(best, _polished(basis, k, np.append(terms, b), measure))
    return float(best)


def _polished(basis: Values, k: Values, start: Values, measure: str) -> float:
    n = len(k)
    bound = 1.0 / k.max() ** 2
    limits = [(None, None)] * _SUBSET + [(0.0, bound)]

    def errors(z: Values) -> Values:
        return _errors(basis @ z[:_SUBSET], z[_SUBSET], k)

    if measure == "rms":
        found = minimize(lambda z: float(np.sum(errors(z) ** 2)), start, bounds=limits, method="SLSQP", tol=1e-14)
    else:
        # The sum of |e_i| as the smallest sum of t_i with -t_i <= e_i <= t_i.
        def inside(z: Values) -> Values:
            e, t = errors(z), z[_SUBSET + 1 :]
            return np.concatenate([t - e, t + e])

        found = minimize(
            lambda z: float(z[_SUBSET + 1 :].sum()),
            np.concatenate([start, np.abs(errors(start))]),
            jac=lambda z: np.concatenate([np.zeros(_SUBSET + 1), np.ones(n)]),
            bounds=limits + [(0.0, None)] * n,
            constraints={"type": "ineq", "fun": inside},
            method="SLSQP",
            tol=1e-12,
        )
    final = errors(np.clip(found.x[: _SUBSET + 1], [-np.inf] * _SUBSET + [0.0], [np.inf] * _SUBSET + [bound]))
    return float(min(_measure(final, measure), _measure(errors(start), measure)))
