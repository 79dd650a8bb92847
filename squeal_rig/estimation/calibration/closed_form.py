"""Thresholds and squeal frequencies of many candidate rigs at once, undamped, by Eqs. (3.1), (3.2).

The same boundaries as ``stability``, on arrays: a search looks at hundreds of thousands of candidates.
Where there is no root the answer is nan, never a number that stands in for one.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from squeal_rig.model.parameters import RigParameters

Values = NDArray[np.float64]
#: Parameter name -> a number, or a column (S, 1) of one number a candidate.
Columns = Mapping[str, object]

# As in the model: below this K_ab/k is rounding (mirrored arms), there is no mode coupling.
_NO_COUPLING = 1e-12
# Slip direction: from this many widths on tanh is 1 to the last bit.
_SATURATED = 20.0


def column(values: Columns, name: str) -> Values:
    """A numeric parameter as an array that broadcasts against the operating points."""
    return np.asarray(values[name], dtype=np.float64)


def is_closed_form(values: Columns, slowest: float) -> bool:
    """Whether these formulas hold: no damping, and friction that does not see the pad (`slowest` belt [m/s])."""
    damped = np.any(column(values, "damping_x") != 0.0) or np.any(column(values, "damping_y") != 0.0)
    turning = values["friction_direction"] == "slip" and bool(
        np.any(slowest < _SATURATED * column(values, "regularization_speed"))
    )
    return not damped and values["friction_speed"] == "belt" and not turning


def friction(values: Columns, preload: Values, speed: Values) -> Values:
    """mu(V, F) of each candidate (S, 1) at each operating point (T,): (S, T)."""
    return np.asarray(
        column(values, "mu0")
        + column(values, "mu_speed") * speed
        + (column(values, "mu_preload") + column(values, "mu_speed_preload") * speed) * preload
    )


def _arms(values: Columns) -> tuple[Values, Values, Values, Values]:
    """K_aa/k, K_ab/k, K_bb/k at the ratio k1/k2 of each candidate, and the quadratic term of det K."""
    k1, k2 = column(values, "k1"), column(values, "k2")
    total = k1 + k2
    safe = np.where(total > 0.0, total, 1.0)
    share_1 = np.where(total > 0.0, 2.0 * k1 / safe, 1.0)
    share_2 = np.where(total > 0.0, 2.0 * k2 / safe, 1.0)
    angle_1, angle_2 = column(values, "arm_angle_1"), column(values, "arm_angle_2")
    s1, c1, s2, c2 = np.sin(angle_1), np.cos(angle_1), np.sin(angle_2), np.cos(angle_2)
    ab = share_1 * s1 * c1 + share_2 * s2 * c2
    ab = np.where(np.abs(ab) < _NO_COUPLING, 0.0, ab)
    sine = np.sin(angle_1 - angle_2)
    crossing = np.where(np.abs(sine) > _NO_COUPLING, share_1 * share_2 * sine**2, 0.0)
    return share_1 * c1**2 + share_2 * c2**2, ab, share_1 * s1**2 + share_2 * s2**2, crossing


def critical_stiffness(values: Columns, preload: Values, speed: Values) -> Values:
    """Critical pad stiffness [N/m] (S, T) of each candidate at each operating point (T,); nan where there is none.

    The lower root of flutter or of divergence, whichever comes first: docs/physics.md.
    """
    aa, ab, bb, crossing = _arms(values)
    mu_kc = friction(values, preload, speed) * column(values, "contact_stiffness")
    clips, k_c = column(values, "k3") + column(values, "k4"), column(values, "contact_stiffness")
    kappa, c2, delta = -ab, aa - bb, k_c - clips
    linear = 0.5 * delta * c2 + kappa * mu_kc
    discriminant = kappa * (kappa * mu_kc**2 + delta * c2 * mu_kc - kappa * delta**2)
    exists = (kappa != 0.0) & (linear > 0.0) & (discriminant > 0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        flutter = np.where(exists, 0.5 * delta**2 / (linear + np.sqrt(discriminant)), np.nan)
        # det K = c0 + c1 k + c2 k^2
        constant, slope = clips * k_c, clips * bb + k_c * aa - mu_kc * ab
        under = slope**2 - 4.0 * constant * crossing
        divergence = np.where((slope < 0.0) & (under > 0.0), 2.0 * constant / (np.sqrt(under) - slope), np.nan)
    return np.fmin(flutter, divergence)


def linear_frequency(values: Columns, k: Values, preload: Values, speed: Values) -> Values:
    """Squeal frequency [Hz] (S, T) of the linear model at mean pad stiffness k [N/m]; nan where nothing flutters."""
    aa, ab, bb, _ = _arms(values)
    mu_kc = friction(values, preload, speed) * column(values, "contact_stiffness")
    xx = aa * k + column(values, "k3") + column(values, "k4")
    yy = bb * k + column(values, "contact_stiffness")
    coupling = ab * k * (ab * k + mu_kc)
    flutters = 0.25 * (xx - yy) ** 2 + coupling < 0.0
    # lambda^2 = -(a +- ib)/m with a + ib the eigenvalue of K, so |Im lambda| = Re sqrt((a + ib)/m).
    modulus = np.sqrt(np.where(flutters, xx * yy - coupling, np.nan))
    return np.asarray(np.sqrt(0.5 * (modulus + 0.5 * (xx + yy)) / column(values, "mass")) / (2.0 * np.pi))


def as_columns(p: RigParameters) -> dict[str, object]:
    """The parameters of one rig as columns of a single candidate."""
    return dict(p.as_mapping())
