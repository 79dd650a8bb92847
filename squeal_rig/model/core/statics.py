"""Static equilibrium of the pad in contact: exact, or of the linear model (Eqs. 3.1, 3.2), compiled and for one rig."""

from __future__ import annotations

import math

from squeal_rig.errors import ModelError
from squeal_rig.model.core.forces import friction_ratio, spring_force, spring_stiffness
from squeal_rig.model.core.kernel import kernel
from squeal_rig.model.core.layout import (
    COS_1,
    COS_2,
    K1,
    K2,
    K34,
    K_C,
    L_PRE,
    LOAD_X,
    LOAD_Y,
    SIGMA,
    SIN_1,
    SIN_2,
    Vector,
    pack,
)
from squeal_rig.model.parameters import RigParameters

#: What became of the search for an equilibrium.
FOUND, OFF_BELT, NOT_FOUND = range(3)
_MAX_STEPS = 50
# Newton stops when a step is below this share of the position: the last step squares it, which is rounding.
_TOLERANCE = 1e-9


@kernel
def linear_stiffness(q: Vector) -> tuple[float, float, float, float]:
    """K of the linear model [N/m], contact kept, Eqs. (3.1), (3.2) for any arm angles: xx, xy, yx, yy."""
    xx = q[K1] * q[COS_1] * q[COS_1] + q[K2] * q[COS_2] * q[COS_2] + q[K34]
    xy = q[K1] * q[SIN_1] * q[COS_1] + q[K2] * q[SIN_2] * q[COS_2]
    yy = q[K1] * q[SIN_1] * q[SIN_1] + q[K2] * q[SIN_2] * q[SIN_2] + q[K_C]
    return float(xx), float(xy + friction_ratio(0.0, q) * q[K_C]), float(xy), float(yy)


@kernel
def linear_rest_position(q: Vector) -> tuple[float, float, int]:
    """Equilibrium (x, y) [m] of Eq. (3.1), without the stray mu of its second row (docs/physics.md), and its ending."""
    xx, xy, yx, yy = linear_stiffness(q)
    pretension = q[K_C] * q[L_PRE] * 0.5 * (math.tanh(q[SIGMA] * q[L_PRE]) + 1.0)
    load_x, load_y = friction_ratio(0.0, q) * pretension + q[LOAD_X], pretension + q[LOAD_Y]
    determinant = xx * yy - xy * yx
    if determinant == 0.0:
        return math.nan, math.nan, NOT_FOUND
    x, y = (yy * load_x - xy * load_y) / determinant, (xx * load_y - yx * load_x) / determinant
    return x, y, FOUND if y < q[L_PRE] else OFF_BELT


@kernel
def rest_position(q: Vector) -> tuple[float, float, int]:
    """Equilibrium (x, y) [m] of Eq. (2.3) by Newton's method from r = 0, and its ending."""
    ratio = friction_ratio(0.0, q)
    x, y = 0.0, 0.0
    for _ in range(_MAX_STEPS):
        # The contact is kept closed while iterating: a start just off the belt must not lose its stiffness.
        y = min(y, q[L_PRE])
        fx, fy = spring_force(x, y, q)
        normal = q[K_C] * (q[L_PRE] - y)
        fx += q[LOAD_X] + ratio * normal
        fy += q[LOAD_Y] + normal
        xx, xy, yy = spring_stiffness(x, y, q)
        across, pressed = xy + ratio * q[K_C], yy + q[K_C]
        determinant = xx * pressed - across * xy
        if determinant == 0.0:
            break
        step_x = (fx * pressed - fy * across) / determinant
        step_y = (xx * fy - xy * fx) / determinant
        x, y = x + step_x, y + step_y
        if not math.isfinite(x + y):
            break
        if math.hypot(step_x, step_y) <= _TOLERANCE * math.hypot(x, y):
            return x, y, FOUND if y < q[L_PRE] else OFF_BELT
    # Held on the belt, it leaves again.
    return x, y, OFF_BELT if math.isfinite(x) and y > q[L_PRE] else NOT_FOUND


def equilibrium(p: RigParameters, linear: bool = False) -> tuple[float, float]:
    """Static equilibrium (x, y) [m] of the pad on the belt.

    Args:
        p: parameters.
        linear: of Eqs. (3.1), (3.2) instead of the exact Eq. (2.3).

    Raises:
        ModelError: there is none in contact (y < L_pre), or Newton's method does not find one.
    """
    x, y, ending = linear_rest_position(pack(p)) if linear else rest_position(pack(p))
    if ending == NOT_FOUND:
        raise ModelError(
            "no equilibrium: the stiffness matrix of Eq. (3.1) is singular"
            if linear
            else "no equilibrium found: Newton's method on Eq. (2.3) did not converge from r = 0"
        )
    if ending == OFF_BELT:
        raise ModelError(
            f"no equilibrium in contact: y = {y:.4g} m must be below pretension_length = {p.pretension_length:g} m"
        )
    return x, y
