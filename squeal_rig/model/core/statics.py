"""Static equilibrium of the pad in contact: exact by Newton, or of the linear model (Eqs. 3.1, 3.2)."""

from __future__ import annotations

import math

import numpy as np

from squeal_rig.errors import ModelError
from squeal_rig.model.core.dynamics import Vector, jacobian, preload_force, state_derivative
from squeal_rig.model.core.friction import force_ratio
from squeal_rig.model.parameters import RigParameters

_MAX_NEWTON_STEPS = 50
# Newton stops when a step is below this share of the position: the last step squares it, which is rounding.
_NEWTON_TOLERANCE = 1e-9


def stiffness_matrix(p: RigParameters) -> Vector:
    """Stiffness of the linear model [N/m] (2, 2), contact kept: Eqs. (3.1), (3.2) for any arm angles."""
    s1, c1 = math.sin(p.arm_angle_1), math.cos(p.arm_angle_1)
    s2, c2 = math.sin(p.arm_angle_2), math.cos(p.arm_angle_2)
    k_ab = p.k1 * s1 * c1 + p.k2 * s2 * c2
    return np.array(
        [
            [p.k1 * c1 * c1 + p.k2 * c2 * c2 + p.k3 + p.k4, k_ab + force_ratio(p) * p.contact_stiffness],
            [k_ab, p.k1 * s1 * s1 + p.k2 * s2 * s2 + p.contact_stiffness],
        ]
    )


def linear_equilibrium(p: RigParameters) -> tuple[float, float]:
    """Equilibrium (x, y) [m] of Eq. (3.1), without the stray mu of its second row (docs/reproduction.md)."""
    pretension = p.contact_stiffness * p.pretension_length
    pretension *= 0.5 * (math.tanh(p.contact_smoothing * p.pretension_length) + 1.0)
    load_x, load_y = preload_force(p)
    try:
        x, y = np.linalg.solve(stiffness_matrix(p), [force_ratio(p) * pretension + load_x, pretension + load_y])
    except np.linalg.LinAlgError:
        raise ModelError("no equilibrium: the stiffness matrix of Eq. (3.1) is singular") from None
    return float(x), float(y)


def equilibrium(p: RigParameters, linear: bool = False) -> tuple[float, float]:
    """Static equilibrium (x, y) [m] of the pad on the belt.

    Args:
        p: parameters.
        linear: of Eqs. (3.1), (3.2) instead of the exact Eq. (2.3).

    Raises:
        ModelError: there is none in contact (y < L_pre), or Newton's method does not find one.
    """
    x, y = linear_equilibrium(p)
    if not linear:
        x, y = _newton(p, x, y)
    if not y < p.pretension_length:
        raise ModelError(
            f"no equilibrium in contact: y = {y:.4g} m must be below pretension_length = {p.pretension_length:g} m"
        )
    return x, y


def _newton(p: RigParameters, x: float, y: float) -> tuple[float, float]:
    """Newton's method on the static part of Eq. (2.3), from the linear equilibrium."""
    # The contact is kept closed while iterating: a start just off the belt must not lose its stiffness.
    for _ in range(_MAX_NEWTON_STEPS):
        y = min(y, p.pretension_length)
        state = np.array([x, y, 0.0, 0.0])
        try:
            step = np.linalg.solve(jacobian(p, state)[2:, :2], state_derivative(p, state)[2:])
        except np.linalg.LinAlgError:
            break
        x, y = x - float(step[0]), y - float(step[1])
        if not (math.isfinite(x) and math.isfinite(y)):
            break
        if float(np.hypot(*step)) <= _NEWTON_TOLERANCE * math.hypot(x, y):
            return x, y
    if math.isfinite(x) and y > p.pretension_length:  # held on the belt, it leaves again: the caller says so
        return x, y
    raise ModelError("no equilibrium found: Newton's method on Eq. (2.3) did not converge from the linear equilibrium")


def normal_force(p: RigParameters, y: float) -> float:
    """Normal contact force N = k_c max(0, L_pre - y) [N] at pad height y [m]."""
    return p.contact_stiffness * max(0.0, p.pretension_length - y)
