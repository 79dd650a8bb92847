"""Critical pad stiffness in compiled code: where the linear model, Eqs. (3.1), (3.2), loses its stability.

At a fixed ratio k1/k2 every entry of K is linear in the mean arm stiffness k, so a boundary is a root of a quadratic:
- undamped flutter, complex eigenvalues of K: (K11 - K22)^2/4 + K12 K21 < 0;
- damped flutter, the Hurwitz determinant of the characteristic polynomial: a1 a2 a3 - a3^2 - a1^2 a4 < 0;
- divergence: det K < 0.
Friction that sees the slip speed adds a damping that depends on k through N; with it, and with damping of one
direction alone, the boundary is searched for on the largest real part itself. So it is about the exact equilibrium,
where K is not linear in k.
"""

from __future__ import annotations

import math

import numpy as np

from squeal_rig.configuration.declared import declarations
from squeal_rig.model.core.forces import friction_ratio, friction_ratio_slope, jacobian_of
from squeal_rig.model.core.kernel import kernel
from squeal_rig.model.core.layout import (
    C_X,
    C_Y,
    COS_1,
    COS_2,
    K1,
    K2,
    K34,
    K_C,
    L_PRE,
    MASS,
    SIN_1,
    SIN_2,
    Vector,
)
from squeal_rig.model.core.statics import FOUND, linear_rest_position, linear_stiffness, rest_position
from squeal_rig.model.linear.roots import Roots, fill_roots, leading_root
from squeal_rig.model.parameters import RigParameters

# Below this K_ab/k is rounding (mirrored arms): there is no mode coupling (docs/physics.md, section 2).
_NO_COUPLING = 1e-12
# Where in a range growth is looked for; weak coupling alone can hide it below the tolerance at some of them.
_PROBES = (0.5, 0.3, 0.7, 0.1, 0.9, 0.01, 0.99)
_STIFFEST = float(declarations(RigParameters)["k1"].upper)
_SCAN_POINTS = 400
_FLUTTER_POINTS = 9
_BISECTIONS = 100
#: Pad stiffness [N/m] that is scanned about the exact equilibrium, and at how many points.
REST_SCAN = (1e6, 1e9, 120)


@kernel
def fill_linear_roots(q: Vector, roots: Roots) -> None:
    """Fill `roots` (4,) with the eigenvalues [rad/s] of the linear model, Eqs. (3.1), (3.2)."""
    xx, xy, yx, yy = linear_stiffness(q)
    m = q[MASS]
    fill_roots(xx / m, xy / m, yx / m, yy / m, linear_damping_x(q) / m, q[C_Y] / m, roots)


@kernel
def linear_damping_x(q: Vector) -> float:
    """Damping along the belt [N s/m], with what friction that sees the slip adds at the linear equilibrium."""
    slope = friction_ratio_slope(0.0, q)
    if slope == 0.0:
        return float(q[C_X])
    y = linear_rest_position(q)[1]
    return float(q[C_X] - slope * q[K_C] * max(0.0, q[L_PRE] - y))


@kernel
def fill_rest_roots(q: Vector, roots: Roots) -> bool:
    """Fill `roots` (4,) with the eigenvalues [rad/s] at the exact equilibrium; whether there is one in contact."""
    x, y, ending = rest_position(q)
    if ending != FOUND:
        return False
    a = jacobian_of(x, y, 0.0, q)
    fill_roots(-a[2, 0], -a[2, 1], -a[3, 0], -a[3, 1], -a[2, 2], -a[3, 3], roots)
    return True


@kernel
def stability_bounds(q: Vector, roots: Roots) -> tuple[float, float]:
    """Bounds [N/m] of the lowest unstable range of (k1 + k2)/2 at the ratio k1/k2 of `q`; nan, nan where there is none.

    `roots` (4,) is room to work in; k1 and k2 of `q` are changed on the way, and put back.
    """
    k1, k2 = q[K1], q[K2]
    bounds = _bounds(q, roots)
    q[K1], q[K2] = k1, k2
    return bounds


@kernel
def _bounds(q: Vector, roots: Roots) -> tuple[float, float]:
    share_1, share_2 = _shares(q)
    stiffest = _STIFFEST / max(share_1, share_2) * (1.0 - 1e-12)
    # Damping of one direction alone, which slip-dependent friction is as well, makes growth begin below the
    # tolerance of growth: no root tells where it passes that.
    if friction_ratio_slope(0.0, q) != 0.0 or (q[C_X] == 0.0) != (q[C_Y] == 0.0):
        return _scanned(q, share_1, share_2, stiffest, roots)
    undamped = q[C_X] == 0.0
    low, high = _undamped_flutter(q, share_1, share_2) if undamped else _damped_flutter(q, share_1, share_2)
    below, above = _divergence(q, share_1, share_2)
    if not _grows_within(low, high, stiffest, share_1, share_2, q, roots):
        low, high = math.nan, math.nan
    if not _grows_within(below, above, stiffest, share_1, share_2, q, roots):
        below, above = math.nan, math.nan
    if math.isnan(low) or below < low:
        low, high, below, above = below, above, low, high
    if below <= high:
        high = max(high, above)
    return low, high


@kernel
def bound_at_rest(q: Vector, roots: Roots) -> float:
    """Lowest unstable pad stiffness [N/m], k1 = k2, of the model linearised at its exact equilibrium.

    Geometric stiffness and turned arms included; nan where none of the stiffnesses scanned is unstable, 0 where the
    first is. They are a factor of 1.06 apart: a narrower unstable range can be missed. `roots` and `q` as above.
    """
    k1, k2 = q[K1], q[K2]
    lowest, highest, points = REST_SCAN
    stable, bound = 0.0, math.nan
    for i in range(points):
        k = lowest * (highest / lowest) ** (i / (points - 1))
        if _grows(k, 1.0, 1.0, True, q, roots):
            bound = 0.0 if i == 0 else _edge(stable, k, 1.0, 1.0, True, q, roots)
            break
        stable = k
    q[K1], q[K2] = k1, k2
    return bound


@kernel
def _shares(q: Vector) -> tuple[float, float]:
    """k1/k and k2/k with k = (k1 + k2)/2; equal arms where both are zero."""
    total = q[K1] + q[K2]
    return (2.0 * q[K1] / total, 2.0 * q[K2] / total) if total > 0.0 else (1.0, 1.0)


@kernel
def _unit_stiffness(q: Vector, share_1: float, share_2: float) -> tuple[float, float, float]:
    """K_aa/k, K_ab/k, K_bb/k of the arms."""
    aa = share_1 * q[COS_1] * q[COS_1] + share_2 * q[COS_2] * q[COS_2]
    ab = share_1 * q[SIN_1] * q[COS_1] + share_2 * q[SIN_2] * q[COS_2]
    bb = share_1 * q[SIN_1] * q[SIN_1] + share_2 * q[SIN_2] * q[SIN_2]
    return aa, (0.0 if abs(ab) < _NO_COUPLING else ab), bb


@kernel
def _undamped_flutter(q: Vector, share_1: float, share_2: float) -> tuple[float, float]:
    """Range of k with complex eigenvalues of K.

    With kappa = -K_ab/k, C2 = (K_aa - K_bb)/k, delta = k_c - k3 - k4 the boundary is
    (C2^2/4 + kappa^2) k^2 - (delta C2/2 + kappa mu k_c) k + delta^2/4 = 0. Its discriminant is taken in the form
    kappa (kappa mu^2 k_c^2 + delta C2 mu k_c - kappa delta^2): the textbook form is pure rounding at kappa = 0.
    """
    aa, ab, bb = _unit_stiffness(q, share_1, share_2)
    kappa, c2, delta, mu_kc = -ab, aa - bb, q[K_C] - q[K34], friction_ratio(0.0, q) * q[K_C]
    linear = 0.5 * delta * c2 + kappa * mu_kc
    discriminant = kappa * (kappa * mu_kc**2 + delta * c2 * mu_kc - kappa * delta**2)
    if not (kappa != 0.0 and linear > 0.0 and discriminant > 0.0):
        return math.nan, math.nan
    root = 0.5 * (linear + math.sqrt(discriminant))
    return 0.25 * delta**2 / root, root / (0.25 * c2**2 + kappa**2)


@kernel
def _damped_flutter(q: Vector, share_1: float, share_2: float) -> tuple[float, float]:
    """Range of k where the Hurwitz determinant of the damped characteristic polynomial is negative.

    With alpha = c_x/m, beta = c_y/m the determinant a1 a2 a3 - a3^2 - a1^2 a4 is
    alpha beta [(K11 - K22)^2/m^2 + a1 a3] + a1^2 K12 K21/m^2: no small difference of large terms. Here times m^2.
    """
    aa, ab, bb = _unit_stiffness(q, share_1, share_2)
    if ab == 0.0:
        return math.nan, math.nan
    alpha, beta = q[C_X] / q[MASS], q[C_Y] / q[MASS]
    a1 = alpha + beta
    a1_m = a1 * q[MASS]
    c2, delta, mu_kc = aa - bb, q[K_C] - q[K34], friction_ratio(0.0, q) * q[K_C]
    return _negative_range(
        alpha * beta * (c2 * c2) + a1**2 * ab * ab,
        alpha * beta * (-2.0 * delta * c2 + a1_m * (alpha * bb + beta * aa)) + a1**2 * mu_kc * ab,
        alpha * beta * (delta * delta + a1_m * (alpha * q[K_C] + beta * q[K34])),
    )


@kernel
def _divergence(q: Vector, share_1: float, share_2: float) -> tuple[float, float]:
    """Range of k with det K < 0; its quadratic term K_aa K_bb - K_ab^2 is k1 k2 sin^2(theta_1 - theta_2)."""
    aa, ab, bb = _unit_stiffness(q, share_1, share_2)
    sine = q[SIN_1] * q[COS_2] - q[COS_1] * q[SIN_2]
    return _negative_range(
        share_1 * share_2 * sine**2 if abs(sine) > _NO_COUPLING else 0.0,
        q[K34] * bb + aa * q[K_C] - friction_ratio(0.0, q) * q[K_C] * ab,
        q[K34] * q[K_C],
    )


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
def _grows(k: float, share_1: float, share_2: float, at_rest: bool, q: Vector, roots: Roots) -> bool:
    """Whether an eigenvalue grows at mean stiffness k, which `q` is set to; False without an equilibrium."""
    q[K1], q[K2] = share_1 * k, share_2 * k
    if at_rest:
        return bool(fill_rest_roots(q, roots) and leading_root(roots)[2])
    fill_linear_roots(q, roots)
    return bool(leading_root(roots)[2])


@kernel
def _grows_within(
    low: float, high: float, stiffest: float, share_1: float, share_2: float, q: Vector, roots: Roots
) -> bool:
    """Whether an eigenvalue grows at one of the probes in a range of k [N/m], as far as the declared bounds reach."""
    high = min(high, stiffest)
    if not low < high:
        return False
    for share in _PROBES:
        if _grows(low + share * (high - low), share_1, share_2, False, q, roots):
            return True
    return False


@kernel
def _scanned(q: Vector, share_1: float, share_2: float, stiffest: float, roots: Roots) -> tuple[float, float]:
    """The lowest unstable range by a scan of the largest real part over k and bisection of its edges."""
    grid = np.zeros(1 + _SCAN_POINTS + _FLUTTER_POINTS)
    lowest = 1e-4 * q[K_C]
    for i in range(_SCAN_POINTS):
        grid[1 + i] = lowest * (stiffest / lowest) ** (i / (_SCAN_POINTS - 1))
    used = 1 + _SCAN_POINTS
    low, high = _undamped_flutter(q, share_1, share_2)
    if low < high:  # it can be narrower than the grid
        for i in range(_FLUTTER_POINTS):
            k = low + i / (_FLUTTER_POINTS - 1) * (high - low)
            grid[used] = min(k, stiffest)
            used += 1
    grid[:used].sort()
    lower = math.nan
    for i in range(used):
        grows = _grows(grid[i], share_1, share_2, False, q, roots)
        if math.isnan(lower) and grows:
            lower = 0.0 if i == 0 else _edge(grid[i - 1], grid[i], share_1, share_2, False, q, roots)
        elif not math.isnan(lower) and not grows:
            return lower, _edge(grid[i], grid[i - 1], share_1, share_2, False, q, roots)
    return lower, lower + math.inf


@kernel
def _edge(
    stable: float, unstable: float, share_1: float, share_2: float, at_rest: bool, q: Vector, roots: Roots
) -> float:
    """The edge between a stable and an unstable stiffness, to rounding."""
    for _ in range(_BISECTIONS):
        middle = 0.5 * (stable + unstable)
        if middle in (stable, unstable):
            break
        if _grows(middle, share_1, share_2, at_rest, q, roots):
            unstable = middle
        else:
            stable = middle
    return 0.5 * (stable + unstable)
