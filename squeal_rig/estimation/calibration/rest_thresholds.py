"""Critical pad stiffness of the model linearised at its true equilibrium: geometric stiffness and turned arms included.

The closed forms are of the first order about r = 0. Here nothing is left out: a scan over k for the first unstable
stiffness, the equilibrium solved at every k, then bisection.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

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
    PACKED_SIZE,
    friction_ratio,
    pack,
)
from squeal_rig.model.core.kernel import kernel
from squeal_rig.model.core.rest import rest_position
from squeal_rig.model.linear.eigen import eigenvalues, is_unstable
from squeal_rig.model.parameters import RigParameters

Values = NDArray[np.float64]

#: Pad stiffness that is scanned [N/m]: a threshold beyond is reported as none.
SCANNED = (1e6, 1e9)
_POINTS = 120
_BISECTIONS = 45
# As in the model: growth counts above this share of |lambda|.
_GROWTH = 1e-6


def critical_stiffness_at_rest(p: RigParameters) -> float:
    """Critical pad stiffness [N/m], k1 = k2, of the undamped model at its exact equilibrium; nan where there is none.

    Flutter and divergence alike; friction that sees the pad's speed is left out. The scan is of 120 stiffnesses a
    factor of 1.06 apart: a narrower unstable range can be missed.
    """
    return float(_scan(pack(p), np.geomspace(*SCANNED, _POINTS)))


def is_threshold_at_rest(p: RigParameters, k: float, share: float = 1e-3) -> bool:
    """Whether the eigenvalues at the exact equilibrium are stable just below k and unstable just above."""
    below, above = (is_unstable(eigenvalues(p.replace(pad_stiffness=k * (1.0 + sign * share)))) for sign in (-1.0, 1.0))
    return above and not below


@kernel
def _stiffness(x: float, y: float, q: Values) -> tuple[float, float, float, float]:
    """Tangent stiffness [N/m] at (x, y), contact kept, friction at the belt's speed: xx, xy, yx, yy."""
    xx, xy, yy = q[K34], 0.0, 0.0
    for k, length, ax, ay in ((q[K1], q[L1], q[A1X], q[A1Y]), (q[K2], q[L2], q[A2X], q[A2Y])):
        dx, dy = x - ax, y - ay
        stretched = math.sqrt(dx * dx + dy * dy)
        nx, ny = dx / stretched, dy / stretched
        turned = (stretched - length) / stretched
        xx += k * (nx * nx + turned * ny * ny)
        xy += k * (1.0 - turned) * nx * ny
        yy += k * (ny * ny + turned * nx * nx)
    across = xy + float(friction_ratio(0.0, q)) * q[K_C]
    return float(xx), float(across), float(xy), float(yy + q[K_C])


@kernel
def _is_unstable(q: Values, k: float) -> bool:
    """Whether an eigenvalue of the stiffness at rest is negative or complex; False without an equilibrium."""
    q[K1] = k
    q[K2] = k
    x, y, found = rest_position(q)
    if not found or y >= q[L_PRE]:
        return False
    xx, xy, yx, yy = _stiffness(x, y, q)
    half = 0.5 * (xx + yy)
    determinant = xx * yy - xy * yx
    square = half * half - determinant
    if square < 0.0:
        # lambda^2 = -(a +- ib)/m: Re lambda/|lambda| is the sine of half the angle of a + ib.
        return math.sin(0.5 * math.atan2(math.sqrt(-square), half)) > _GROWTH
    return determinant < 0.0 or half < 0.0


@kernel
def _scan(q: Values, grid: Values) -> float:
    """The first unstable stiffness on the grid, refined; nan where none is, 0 where the very first is unstable."""
    own = np.empty(PACKED_SIZE)
    own[:] = q
    for i in range(grid.shape[0]):
        if _is_unstable(own, grid[i]):
            if i == 0:
                return 0.0
            stable, unstable = grid[i - 1], grid[i]
            for _ in range(_BISECTIONS):
                middle = 0.5 * (stable + unstable)
                if _is_unstable(own, middle):
                    unstable = middle
                else:
                    stable = middle
            return float(0.5 * (stable + unstable))
    return math.nan
