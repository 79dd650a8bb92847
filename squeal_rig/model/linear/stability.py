"""Critical pad stiffness: where the linear model, Eqs. (3.1), (3.2), loses its stability.

At a fixed ratio k1/k2 every entry of K is linear in the mean arm stiffness k, so a boundary is a root of a quadratic:
- undamped flutter, complex eigenvalues of K: (K11 - K22)^2/4 + K12 K21 < 0;
- damped flutter, the Hurwitz determinant of the characteristic polynomial: a1 a2 a3 - a3^2 - a1^2 a4 < 0;
- divergence: det K < 0.
Friction that sees the slip speed adds a damping that depends on k through N; with it, and with damping of one
direction alone, the boundary is searched for on the largest real part itself.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.polynomial import polynomial as poly
from numpy.typing import NDArray

from squeal_rig.configuration.declared import declarations
from squeal_rig.model.core.friction import force_ratio, force_ratio_slope
from squeal_rig.model.linear.eigen import (
    Eigenvalues,
    damping_ratio,
    eigenvalues,
    is_unstable,
    leading,
    squeal_frequency,
)
from squeal_rig.model.parameters import RigParameters

Coefficients = NDArray[np.float64]
Entries = tuple[Coefficients, Coefficients, Coefficients, Coefficients]
Band = tuple[float, float]
NO_BAND: Band = (math.nan, math.nan)

# Below this K_ab/k is rounding (mirrored arms): there is no mode coupling (docs/physics.md, section 2).
_NO_COUPLING = 1e-12
# Where in a range growth is looked for; weak coupling alone can hide it below the tolerance at some of them.
_PROBES = (0.01, 0.1, 0.3, 0.5, 0.7, 0.9, 0.99)
_SCAN_POINTS = 400
_FLUTTER_POINTS = 9
_BISECTIONS = 100


def stability_band(p: RigParameters) -> Band:
    """Bounds [N/m] of the lowest unstable range of (k1 + k2)/2, at the ratio k1/k2 of `p`; from the linear model.

    Returns (nan, nan) where there is none, and an upper bound of inf where stability never returns.
    """
    # Damping of one direction alone, which slip-dependent friction is as well, makes growth begin below the
    # tolerance of `is_unstable`: no root tells where it passes that.
    if force_ratio_slope(p) != 0.0 or (p.damping_x == 0.0) != (p.damping_y == 0.0):
        return _scanned_band(p)
    entries = _stiffness_polynomials(p)
    flutter = _damped_flutter(p, entries) if p.damping_x else _undamped_flutter(entries)
    bands = [band for band in (flutter, _negative_range(_determinant(p, entries))) if band is not None]
    confirmed = sorted(band for band in bands if _confirmed(p, *band))
    if not confirmed:
        return NO_BAND
    lower, upper = confirmed[0]
    for other_lower, other_upper in confirmed[1:]:
        if other_lower <= upper:
            upper = max(upper, other_upper)
    return lower, upper


def critical_pad_stiffness(p: RigParameters) -> float:
    """Critical pad stiffness k_cr [N/m], the lower bound of `stability_band`; nan where no stiffness is unstable."""
    return stability_band(p)[0]


@dataclass(frozen=True)
class StabilityReport:
    """Complex eigenvalue analysis of one set of parameters. Stiffness in N/m, rates in 1/s, frequency in Hz."""

    eigenvalues: Eigenvalues
    unstable: bool
    growth_rate: float
    damping_ratio: float
    squeal_frequency: float
    pad_stiffness: float
    critical_pad_stiffness: float
    upper_pad_stiffness: float
    margin: float


def stability_report(p: RigParameters) -> StabilityReport:
    """Eigenvalues at the exact equilibrium, beside the stability band of the linear model.

    The margin is (k_cr - k)/k_cr with k = (k1 + k2)/2, nan where there is no k_cr; the growth rate is the largest
    Re lambda.

    Raises:
        ModelError: the exact equilibrium does not exist.
    """
    values = eigenvalues(p)
    lower, upper = stability_band(p)
    value = leading(values)
    k = 0.5 * (p.k1 + p.k2)
    return StabilityReport(
        eigenvalues=values,
        unstable=is_unstable(values),
        growth_rate=value.real,
        damping_ratio=damping_ratio(value),
        squeal_frequency=squeal_frequency(values),
        pad_stiffness=k,
        critical_pad_stiffness=lower,
        upper_pad_stiffness=upper,
        margin=(lower - k) / lower if lower > 0.0 else math.nan,
    )


def _shares(p: RigParameters) -> tuple[float, float]:
    """k1/k and k2/k with k = (k1 + k2)/2; equal arms where both are zero."""
    total = p.k1 + p.k2
    return (2.0 * p.k1 / total, 2.0 * p.k2 / total) if total > 0.0 else (1.0, 1.0)


def _with_mean_stiffness(p: RigParameters, k: float) -> RigParameters:
    share_1, share_2 = _shares(p)
    return p.replace(k1=share_1 * k, k2=share_2 * k)


def _stiffness_polynomials(p: RigParameters) -> Entries:
    """K11, K12, K21, K22 as polynomials (constant, slope) in k, Eq. (3.2) for any angles."""
    share_1, share_2 = _shares(p)
    s1, c1 = math.sin(p.arm_angle_1), math.cos(p.arm_angle_1)
    s2, c2 = math.sin(p.arm_angle_2), math.cos(p.arm_angle_2)
    aa = share_1 * c1 * c1 + share_2 * c2 * c2
    ab = share_1 * s1 * c1 + share_2 * s2 * c2
    bb = share_1 * s1 * s1 + share_2 * s2 * s2
    if abs(ab) < _NO_COUPLING:
        ab = 0.0
    mu = force_ratio(p)
    k_c = p.contact_stiffness
    return np.array([p.k3 + p.k4, aa]), np.array([mu * k_c, ab]), np.array([0.0, ab]), np.array([k_c, bb])


def _determinant(p: RigParameters, entries: Entries) -> Coefficients:
    """det K; its quadratic term K_aa K_bb - K_ab^2 as k1 k2 sin^2(theta_1 - theta_2), 0 for parallel arms."""
    k11, k12, k21, k22 = entries
    share_1, share_2 = _shares(p)
    sine = math.sin(p.arm_angle_1 - p.arm_angle_2)
    return np.array(
        [
            k11[0] * k22[0],
            k11[0] * k22[1] + k11[1] * k22[0] - k12[0] * k21[1],
            share_1 * share_2 * sine**2 if abs(sine) > _NO_COUPLING else 0.0,
        ]
    )


def _undamped_flutter(entries: Entries) -> Band | None:
    """Range of k with complex eigenvalues of K.

    With kappa = -K_ab/k, C2 = (K_aa - K_bb)/k, delta = k_c - k3 - k4 the boundary is
    (C2^2/4 + kappa^2) k^2 - (delta C2/2 + kappa mu k_c) k + delta^2/4 = 0. Its discriminant is taken in the form
    kappa (kappa mu^2 k_c^2 + delta C2 mu k_c - kappa delta^2): the textbook form is pure rounding at kappa = 0.
    """
    k11, k12, k21, k22 = entries
    kappa, c2 = -k21[1], k11[1] - k22[1]
    delta, mu_kc = k22[0] - k11[0], k12[0]
    linear = 0.5 * delta * c2 + kappa * mu_kc
    discriminant = kappa * (kappa * mu_kc**2 + delta * c2 * mu_kc - kappa * delta**2)
    if not (kappa != 0.0 and linear > 0.0 and discriminant > 0.0):
        return None
    q = 0.5 * (linear + math.sqrt(discriminant))
    return float(0.25 * delta**2 / q), float(q / (0.25 * c2**2 + kappa**2))


def _damped_flutter(p: RigParameters, entries: Entries) -> Band | None:
    """Range of k where the Hurwitz determinant of the damped characteristic polynomial is negative.

    With alpha = c_x/m, beta = c_y/m the determinant a1 a2 a3 - a3^2 - a1^2 a4 is
    alpha beta [(K11 - K22)^2/m^2 + a1 a3] + a1^2 K12 K21/m^2: no small difference of large terms.
    """
    k11, k12, k21, k22 = entries
    if k21[1] == 0.0:
        return None
    alpha, beta = p.damping_x / p.mass, p.damping_y / p.mass
    a1 = alpha + beta
    difference = k11 - k22
    a1_a3 = a1 * p.mass * (alpha * k22 + beta * k11)  # times m^2, as all the rest
    stabilising = alpha * beta * poly.polyadd(poly.polymul(difference, difference), a1_a3)
    return _negative_range(poly.polyadd(stabilising, a1**2 * poly.polymul(k12, k21)))


def _negative_range(coefficients: Coefficients) -> Band | None:
    """Range of k >= 0 in which a polynomial a k^2 + b k + c with a >= 0 is negative; None where there is none."""
    c, b, a = np.concatenate([coefficients, np.zeros(3)])[:3]
    roots = sorted(root for root in _real_roots(float(a), float(b), float(c)) if root > 0.0)
    edges = [0.0, *roots, math.inf]
    for lower, upper in pairwise(edges):
        k = _inside(lower, upper)
        if (a * k + b) * k + c < 0.0:
            return lower, upper
    return None


def _real_roots(a: float, b: float, c: float) -> list[float]:
    """Real roots of a k^2 + b k + c, without cancellation."""
    if a == 0.0:
        return [-c / b] if b != 0.0 else []
    discriminant = b * b - 4.0 * a * c
    if discriminant <= 0.0:
        return []
    q = -0.5 * (b + math.copysign(math.sqrt(discriminant), b))
    return [q / a, c / q] if q != 0.0 else [0.0]


def _inside(lower: float, upper: float) -> float:
    """A point inside a range, away from its ends."""
    if math.isinf(upper):
        return 2.0 * lower if lower > 0.0 else 1.0
    return 0.5 * (lower + upper)


def _confirmed(p: RigParameters, lower: float, upper: float) -> bool:
    """Whether an eigenvalue grows somewhere in a range, as far as the parameters' own bounds reach."""
    upper = min(upper, _stiffest(p))
    return any(_unstable_at(p, lower + share * (upper - lower)) for share in _PROBES if lower < upper)


def _stiffest(p: RigParameters) -> float:
    """The largest mean stiffness at which neither arm is above its own bound."""
    return float(declarations(RigParameters)["k1"].upper) / max(_shares(p)) * (1.0 - 1e-12)


def _unstable_at(p: RigParameters, k: float) -> bool:
    return _growth(p, k) > 0.0


def _growth(p: RigParameters, k: float) -> float:
    """Largest Re(lambda)/|lambda| of the linear model at mean stiffness k, less the share that is rounding."""
    values = eigenvalues(_with_mean_stiffness(p, k), linear=True)
    return float(np.max(values.real / np.maximum(np.abs(values), np.finfo(float).tiny))) - 1e-6


def _scanned_band(p: RigParameters) -> Band:
    """The lowest unstable range by a scan of the largest real part over k and bisection of its edges."""
    stiffest = _stiffest(p)
    grid = np.concatenate([[0.0], np.geomspace(1e-4 * p.contact_stiffness, stiffest, _SCAN_POINTS)])
    strongest = _undamped_flutter(_stiffness_polynomials(p))
    if strongest is not None:  # it can be narrower than the grid
        grid = np.sort(np.append(grid, np.minimum(np.linspace(*strongest, _FLUTTER_POINTS), stiffest)))
    unstable = np.array([_unstable_at(p, float(k)) for k in grid])
    if not unstable.any():
        return NO_BAND
    first = int(np.argmax(unstable))
    stable_again = np.flatnonzero(~unstable[first:])
    lower = 0.0 if first == 0 else _bisected(p, float(grid[first - 1]), float(grid[first]))
    if stable_again.size == 0:
        return lower, math.inf
    last = first + int(stable_again[0])
    return lower, _bisected(p, float(grid[last]), float(grid[last - 1]))


def _bisected(p: RigParameters, stable: float, unstable: float) -> float:
    """The edge between a stable and an unstable stiffness, to rounding."""
    for _ in range(_BISECTIONS):
        middle = 0.5 * (stable + unstable)
        if middle in (stable, unstable):
            break
        if _unstable_at(p, middle):
            unstable = middle
        else:
            stable = middle
    return 0.5 * (stable + unstable)
