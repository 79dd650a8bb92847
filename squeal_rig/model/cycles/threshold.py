"""Where flutter begins along a parameter, and the linear mode there: the known end of a branch of cycles.

At the threshold of the exact equilibrium an eigenvalue is i omega, and the motion r = r* + A Re(v e^{i omega t}) is a
closed orbit up to the amplitude at which the pad just leaves the belt, max y = L_pre.
"""

from __future__ import annotations

import math

import numpy as np

from squeal_rig.model.core.forces import jacobian_of
from squeal_rig.model.core.layout import C_X, C_Y, K_C, L_PRE, MASS, MU, Vector
from squeal_rig.model.core.statics import linear_stiffness, rest_position
from squeal_rig.model.cycles.path import Path
from squeal_rig.model.linear.bounds import fill_rest_roots, stability_bounds
from squeal_rig.model.linear.roots import leading_root

# The exact threshold lies this near the linear model's, relative: first guess of the search's width.
_NEAR, _WIDENINGS, _STEPS = 1e-5, 40, 80
_NO_COUPLING = 1e-12


def growth(q: Vector) -> float:
    """Largest Re lambda [1/s] at the exact equilibrium; nan where there is none in contact."""
    roots = np.empty(4, dtype=np.complex128)
    return float(leading_root(roots)[0]) if fill_rest_roots(q, roots) else math.nan


def linear_flutter_friction(q: Vector) -> float:
    """Friction coefficient at which flutter begins, linear model with damping; nan where none does.

    The Hurwitz determinant (`linear.bounds`) is linear in K_xy = K_ab + mu k_c:
    alpha beta [(K11 - K22)^2/m^2 + a1 a3] + a1^2 K12 K21/m^2 = 0.
    """
    xx, xy, yx, yy = linear_stiffness(q)
    m, alpha, beta = q[MASS], q[C_X] / q[MASS], q[C_Y] / q[MASS]
    if abs(yx) < _NO_COUPLING * (xx + yy):
        return math.nan
    a1, a3 = alpha + beta, (alpha * yy + beta * xx) / m
    coupling = -alpha * beta * (((xx - yy) / m) ** 2 + a1 * a3) * m * m / (a1 * a1 * yx)
    mu = float(q[MU] + (coupling - xy) / q[K_C])
    return mu if mu >= 0.0 else math.nan


def threshold_near(path: Path, guess: float) -> float:
    """Value of the parameter at which an eigenvalue of the exact equilibrium begins to grow, near a guess; nan where
    there is none.
    """
    if not math.isfinite(guess):
        return math.nan

    def at(value: float) -> float:
        return growth(path.packed(value)) if path.lower <= value <= path.upper else math.nan

    width = _NEAR * abs(guess)
    low, high = guess, guess
    f_low = f_high = at(guess)
    for _ in range(_WIDENINGS):
        low, high = guess - width, guess + width
        f_low, f_high = at(low), at(high)
        if f_low * f_high <= 0.0 or not math.isfinite(f_low + f_high):
            break
        width *= 1.6
    if not f_low * f_high <= 0.0:
        return math.nan
    for _ in range(_STEPS):
        middle = 0.5 * (low + high)
        secant = low - f_low * (high - low) / (f_high - f_low) if f_high != f_low else middle
        # A secant step, and a half step so that both ends close in.
        for value in (secant, middle):
            if not low < value < high:
                continue
            f = at(value)
            if f * f_low > 0.0:
                low, f_low = value, f
            else:
                high, f_high = value, f
        if high - low <= 1e-15 * abs(high):
            break
    return 0.5 * (low + high)


def flutter_friction(path: Path) -> float:
    """Threshold in `mu0` [-] of the path's rig, which varies mu0; nan where there is none."""
    q = path.packed(path.value)
    return threshold_near(path, path.value + linear_flutter_friction(q) - float(q[MU]))


def flutter_stiffness(path: Path) -> tuple[float, float]:
    """Thresholds in the mean arm stiffness [N/m]: where flutter begins and where it ends; nan where there is none."""
    low, high = stability_bounds(path.packed(path.value).copy(), np.empty(4, dtype=np.complex128))
    return tuple(threshold_near(path, k) if 0.0 < k < path.upper else math.nan for k in (low, high))  # type: ignore[return-value]


def threshold_mode(path: Path, value: float, amplitude: float) -> tuple[Vector, Vector]:
    """The linear mode at a threshold as unknowns (6,) of `Shooter`, and their change with the amplitude.

    `amplitude` is a share of the one at which the pad just touches separation.
    """
    q = path.packed(value)
    x, y, _ = rest_position(q)
    values, vectors = np.linalg.eig(jacobian_of(x, y, 0.0, q))
    i = int(np.argmax(values.real + 1e-9 * values.imag))
    v, omega = vectors[:, i], abs(float(values[i].imag))
    if values[i].imag < 0.0:
        v = v.conj()
    v = v / v[0] * abs(v[0])  # x has its maximum at t = 0
    v *= (q[L_PRE] - y) / abs(v[1])
    mode = np.array([v[0].real, v[1].real, 0.0, v[3].real, 0.0, 0.0])
    start = np.array([x, y, 0.0, 0.0, 2.0 * math.pi / omega, value])
    return start + amplitude * mode, mode
