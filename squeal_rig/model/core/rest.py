"""Static equilibrium of Eq. (2.3), compiled, for many operating points; `statics` has the one for one point."""

from __future__ import annotations

import math

from squeal_rig.model.core.dynamics import (
    A1X,
    A1Y,
    A2X,
    A2Y,
    K1,
    K2,
    K34,
    K_C,
    L1,
    L2,
    L_PRE,
    LOAD_X,
    LOAD_Y,
    Vector,
    friction_ratio,
    spring_force,
)
from squeal_rig.model.core.kernel import kernel

_MAX_STEPS = 50
# As in `equilibrium`: Newton's last step squares this share of the position.
_TOLERANCE = 1e-9


@kernel
def rest_position(q: Vector) -> tuple[float, float, bool]:
    """Equilibrium (x, y) [m] of the packed parameters by Newton's method from r = 0, and whether there is one
    in contact.
    """
    ratio = friction_ratio(0.0, q)
    x, y = 0.0, 0.0
    for _ in range(_MAX_STEPS):
        y = min(y, q[L_PRE])
        fx, fy = spring_force(x, y, q)
        normal = q[K_C] * (q[L_PRE] - y)
        fx += q[LOAD_X] + ratio * normal
        fy += q[LOAD_Y] + normal
        xx, xy, yy = q[K34], 0.0, 0.0
        for k, length, ax, ay in ((q[K1], q[L1], q[A1X], q[A1Y]), (q[K2], q[L2], q[A2X], q[A2Y])):
            # Tangent stiffness k [n n^T + (l - L)/l (I - n n^T)] along the arm's direction n.
            dx, dy = x - ax, y - ay
            stretched = math.sqrt(dx * dx + dy * dy)
            nx, ny = dx / stretched, dy / stretched
            turned = (stretched - length) / stretched
            xx += k * (nx * nx + turned * ny * ny)
            xy += k * (1.0 - turned) * nx * ny
            yy += k * (ny * ny + turned * nx * nx)
        across = xy + ratio * q[K_C]
        pressed = yy + q[K_C]
        determinant = xx * pressed - across * xy
        if determinant == 0.0:
            break
        step_x = (fx * pressed - fy * across) / determinant
        step_y = (xx * fy - xy * fx) / determinant
        x, y = x + step_x, y + step_y
        if not math.isfinite(x + y):
            break
        if math.hypot(step_x, step_y) <= _TOLERANCE * math.hypot(x, y):
            return x, y, y < q[L_PRE]
    return x, y, False
