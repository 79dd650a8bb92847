"""Fourth-order Runge-Kutta, the paper's integrator: fixed steps straight through contact events."""

from __future__ import annotations

import math

from squeal_rig.model.core.forces import acceleration, add_forces
from squeal_rig.model.core.kernel import kernel
from squeal_rig.model.core.layout import VX, VY, Vector, X, Y


@kernel
def advance(state: Vector, q: Vector, interval: float, substeps: int, out: Vector) -> int:
    """Fill `out` (n, 4) or (n, 6) with samples x, y, vx, vy and, where it has room, N, F_t, `interval` [s] apart, from
    `state` (4,) on, left one interval after the last.

    Returns the number of finite samples: below n the motion left every bound.
    """
    h = interval / substeps
    x, y, vx, vy = state[0], state[1], state[2], state[3]
    for i in range(out.shape[0]):
        if not math.isfinite(x + y + vx + vy):
            return i
        out[i, X], out[i, Y], out[i, VX], out[i, VY] = x, y, vx, vy
        for _ in range(substeps):
            ax1, ay1 = acceleration(x, y, vx, vy, q)
            vx2, vy2 = vx + 0.5 * h * ax1, vy + 0.5 * h * ay1
            ax2, ay2 = acceleration(x + 0.5 * h * vx, y + 0.5 * h * vy, vx2, vy2, q)
            vx3, vy3 = vx + 0.5 * h * ax2, vy + 0.5 * h * ay2
            ax3, ay3 = acceleration(x + 0.5 * h * vx2, y + 0.5 * h * vy2, vx3, vy3, q)
            vx4, vy4 = vx + h * ax3, vy + h * ay3
            ax4, ay4 = acceleration(x + h * vx3, y + h * vy3, vx4, vy4, q)
            x += h / 6.0 * (vx + 2.0 * vx2 + 2.0 * vx3 + vx4)
            y += h / 6.0 * (vy + 2.0 * vy2 + 2.0 * vy3 + vy4)
            vx += h / 6.0 * (ax1 + 2.0 * ax2 + 2.0 * ax3 + ax4)
            vy += h / 6.0 * (ay1 + 2.0 * ay2 + 2.0 * ay3 + ay4)
    state[0], state[1], state[2], state[3] = x, y, vx, vy
    add_forces(out, q)
    return len(out)
