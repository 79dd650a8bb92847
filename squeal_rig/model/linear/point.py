"""One point of a stability map in compiled code: the linear model and the bounds of its unstable range."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from squeal_rig.model.core.dynamics import Vector
from squeal_rig.model.core.kernel import kernel
from squeal_rig.model.linear.roots import Roots, fill_roots, leading_root

#: The parameters a point depends on, in the order the kernels take them.
FIELDS = (
    "mass",
    "k1",
    "k2",
    "k3",
    "k4",
    "contact_stiffness",
    "arm_angle_1",
    "arm_angle_2",
    "damping_x",
    "damping_y",
    "preload",
    "belt_speed",
    "mu0",
    "mu_speed",
    "mu_preload",
    "mu_speed_preload",
    "pretension_length",
    "contact_smoothing",
    "regularization_speed",
)
(
    MASS,
    K1,
    K2,
    K3,
    K4,
    K_C,
    ANGLE_1,
    ANGLE_2,
    C_X,
    C_Y,
    PRELOAD,
    SPEED,
    MU0,
    MU_V,
    MU_F,
    MU_VF,
    L_PRE,
    SIGMA,
    V_REG,
) = range(len(FIELDS))
#: Switches: friction direction slip, friction speed slip, preload along the arms.
Switches = tuple[bool, bool, bool]

# As in `stability`.
_NO_COUPLING = 1e-12
_PROBES = (0.5, 0.3, 0.7, 0.1, 0.9, 0.01, 0.99)
_STIFFEST = 1e10


@kernel
def friction(p: Vector, switches: Switches) -> tuple[float, float]:
    """F_t/N and its slope over vx [s/m] for a pad at rest: `force_ratio` and `force_ratio_slope`."""
    direction, speed, _ = switches
    rise = p[MU_V] + p[MU_VF] * p[PRELOAD]
    mu = p[MU0] + p[MU_F] * p[PRELOAD] + rise * p[SPEED]
    slope = -rise if speed else 0.0
    if direction:
        tanh = math.tanh(p[SPEED] / p[V_REG])
        return mu * tanh, slope * tanh - mu * (1.0 - tanh * tanh) / p[V_REG]
    return mu, slope


@kernel
def fill_point_roots(p: Vector, switches: Switches, roots: Roots) -> None:
    """Fill `roots` (4,) with the eigenvalues [rad/s] of the linear model, Eqs. (3.1), (3.2)."""
    s1, c1, s2, c2 = math.sin(p[ANGLE_1]), math.cos(p[ANGLE_1]), math.sin(p[ANGLE_2]), math.cos(p[ANGLE_2])
    ratio, slope = friction(p, switches)
    k_ab = p[K1] * s1 * c1 + p[K2] * s2 * c2
    k11 = p[K1] * c1 * c1 + p[K2] * c2 * c2 + p[K3] + p[K4]
    k12 = k_ab + ratio * p[K_C]
    k22 = p[K1] * s1 * s1 + p[K2] * s2 * s2 + p[K_C]
    damping_x = p[C_X]
    if slope != 0.0:
        pretension = p[K_C] * p[L_PRE] * 0.5 * (math.tanh(p[SIGMA] * p[L_PRE]) + 1.0)
        load_x = ratio * pretension - (p[PRELOAD] * (c1 + c2) if switches[2] else 0.0)
        load_y = pretension - p[PRELOAD] * (s1 + s2)
        y = (k11 * load_y - k_ab * load_x) / (k11 * k22 - k12 * k_ab)
        damping_x -= slope * p[K_C] * max(0.0, p[L_PRE] - y)
    m = p[MASS]
    fill_roots(k11 / m, k12 / m, k_ab / m, k22 / m, damping_x / m, p[C_Y] / m, roots)


@kernel
def has_closed_bounds(p: Vector, switches: Switches) -> bool:
    """Whether the bounds of the unstable range are roots of quadratics, as in `stability_band`."""
    return friction(p, switches)[1] == 0.0 and (p[C_X] == 0.0) == (p[C_Y] == 0.0)


@kernel
def stability_bounds(p: Vector, switches: Switches, roots: Roots) -> tuple[float, float]:
    """`stability_band` where `has_closed_bounds`; nan, nan where there is none. `roots` is room to work in."""
    total = p[K1] + p[K2]
    share_1, share_2 = (2.0 * p[K1] / total, 2.0 * p[K2] / total) if total > 0.0 else (1.0, 1.0)
    s1, c1, s2, c2 = math.sin(p[ANGLE_1]), math.cos(p[ANGLE_1]), math.sin(p[ANGLE_2]), math.cos(p[ANGLE_2])
    aa = share_1 * c1 * c1 + share_2 * c2 * c2
    ab = share_1 * s1 * c1 + share_2 * s2 * c2
    bb = share_1 * s1 * s1 + share_2 * s2 * s2
    if abs(ab) < _NO_COUPLING:
        ab = 0.0
    mu_kc = friction(p, switches)[0] * p[K_C]
    clips = p[K3] + p[K4]
    delta, c_2 = p[K_C] - clips, aa - bb
    low, high = math.nan, math.nan
    if p[C_X] == 0.0:
        linear = 0.5 * delta * c_2 - ab * mu_kc
        discriminant = -ab * (-ab * mu_kc**2 + delta * c_2 * mu_kc + ab * delta**2)
        if ab != 0.0 and linear > 0.0 and discriminant > 0.0:
            root = 0.5 * (linear + math.sqrt(discriminant))
            low, high = 0.25 * delta**2 / root, root / (0.25 * c_2**2 + ab**2)
    elif ab != 0.0:
        x, y = p[C_X] / p[MASS], p[C_Y] / p[MASS]
        sum_3 = (x + y) * p[MASS]
        low, high = _negative_range(
            x * y * (c_2 * c_2) + (x + y) ** 2 * ab * ab,
            x * y * (-2.0 * delta * c_2 + sum_3 * (x * bb + y * aa)) + (x + y) ** 2 * mu_kc * ab,
            x * y * (delta * delta + sum_3 * (x * p[K_C] + y * clips)),
        )
    sine = math.sin(p[ANGLE_1] - p[ANGLE_2])
    below, above = _negative_range(
        share_1 * share_2 * sine**2 if abs(sine) > _NO_COUPLING else 0.0,
        clips * bb + aa * p[K_C] - mu_kc * ab,
        clips * p[K_C],
    )
    stiffest = _STIFFEST / max(share_1, share_2) * (1.0 - 1e-12)
    if not _grows_within(low, high, stiffest, share_1, share_2, p, switches, roots):
        low, high = math.nan, math.nan
    if not _grows_within(below, above, stiffest, share_1, share_2, p, switches, roots):
        below, above = math.nan, math.nan
    if math.isnan(low) or below < low:
        low, high, below, above = below, above, low, high
    if below <= high:
        high = max(high, above)
    return low, high


@kernel
def _negative_range(a: float, b: float, c: float) -> tuple[float, float]:
    """Lowest range of k > 0 in which a k^2 + b k + c, a >= 0, is negative; nan, nan where there is none."""
    first, second = math.nan, math.nan
    if a == 0.0:
        if b != 0.0:
            first = -c / b
    elif b * b - 4.0 * a * c > 0.0:
        q = -0.5 * (b + math.copysign(math.sqrt(b * b - 4.0 * a * c), b))
        first, second = q / a, (c / q if q != 0.0 else 0.0)
        if second < first:
            first, second = second, first
    if not first > 0.0:
        first, second = second, math.nan
    if not first > 0.0:
        return (0.0, math.inf) if (a + b) + c < 0.0 else (math.nan, math.nan)
    middle = 0.5 * first
    if (a * middle + b) * middle + c < 0.0:
        return 0.0, first
    if not second > 0.0:
        middle = 2.0 * first
        return (first, math.inf) if (a * middle + b) * middle + c < 0.0 else (math.nan, math.nan)
    return first, second


@kernel
def _grows_within(
    low: float,
    high: float,
    stiffest: float,
    share_1: float,
    share_2: float,
    p: Vector,
    switches: Switches,
    roots: Roots,
) -> bool:
    """Whether an eigenvalue grows at one of the probes in a range of k [N/m]."""
    high = min(high, stiffest)
    if not low < high:
        return False
    k1, k2 = p[K1], p[K2]
    grows = False
    for share in _PROBES:
        k = low + share * (high - low)
        p[K1], p[K2] = share_1 * k, share_2 * k
        fill_point_roots(p, switches, roots)
        grows = leading_root(roots)[2]
        if grows:
            break
    p[K1], p[K2] = k1, k2
    return grows


@kernel
def fill_points(
    base: Vector,
    varied: NDArray[np.int64],
    columns: Vector,
    switches: Switches,
    bands: bool,
    out: Vector,
    values: Roots,
) -> None:
    """Fill `out` (5, n) with growth rate, frequency, k_cr, upper bound and margin; `values` (n or 0, 4) with
    eigenvalues.

    `columns` (v, n) holds the parameters that vary, `varied` (v,) which of `FIELDS` they are. Bounds without closed
    form are left at -1.
    """
    p, roots = base.copy(), np.empty(4, dtype=np.complex128)
    for i in range(columns.shape[1]):
        for j in range(varied.shape[0]):
            p[varied[j]] = columns[j, i]
        fill_point_roots(p, switches, roots)
        growth, omega, grows = leading_root(roots)
        out[0, i], out[1, i] = growth, omega / (2.0 * math.pi) if grows else math.nan
        if values.shape[0] > 0:
            values[i] = roots
        if not bands:
            continue
        if not has_closed_bounds(p, switches):
            out[2, i] = -1.0
            continue
        out[2, i], out[3, i] = stability_bounds(p, switches, roots)
        if out[2, i] > 0.0:
            out[4, i] = (out[2, i] - 0.5 * (p[K1] + p[K2])) / out[2, i]
