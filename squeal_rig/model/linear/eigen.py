"""Complex eigenvalue analysis of one rig: eigenvalues, the bounds of its unstable range, and the report of both."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from squeal_rig.model.core.forces import jacobian
from squeal_rig.model.core.layout import C_Y, MASS, Vector, pack
from squeal_rig.model.core.statics import equilibrium, linear_stiffness
from squeal_rig.model.linear.bounds import linear_damping_x, stability_bounds
from squeal_rig.model.linear.roots import GROWTH_TOLERANCE
from squeal_rig.model.parameters import RigParameters

Eigenvalues = NDArray[np.complex128]


def state_matrix(p: RigParameters, linear: bool = False) -> Vector:
    """State matrix (4, 4) for (x, y, vx, vy): the analytic Jacobian at the exact equilibrium, or of Eqs. (3.1), (3.2).

    Raises:
        ModelError: the exact equilibrium does not exist.
    """
    if not linear:
        x, y = equilibrium(p)
        return jacobian(p, np.array([x, y, 0.0, 0.0]))
    q = pack(p)
    matrix = np.zeros((4, 4))
    matrix[:2, 2:] = np.eye(2)
    matrix[2:, :2] = -np.reshape(linear_stiffness(q), (2, 2)) / q[MASS]
    matrix[2:, 2:] = -np.diag([linear_damping_x(q), q[C_Y]]) / q[MASS]
    return matrix


def eigenvalues(p: RigParameters, linear: bool = False) -> Eigenvalues:
    """Eigenvalues [rad/s], complex128 (4,), largest real part first, then largest imaginary part.

    Args:
        p: parameters.
        linear: of the linear model, Eqs. (3.1), (3.2), instead of the Jacobian at the exact equilibrium.

    Raises:
        ModelError: the exact equilibrium does not exist.
    """
    values = np.linalg.eigvals(state_matrix(p, linear)).astype(np.complex128)
    return values[np.lexsort((-values.imag, -values.real))]


def is_unstable(values: Eigenvalues) -> bool:
    """Whether any eigenvalue grows: Re > 1e-6 |lambda|."""
    return bool(np.any(values.real > GROWTH_TOLERANCE * np.abs(values)))


def leading(values: Eigenvalues) -> complex:
    """The eigenvalue with the largest real part, of its pair the one with Im >= 0 [rad/s]."""
    value = complex(values[np.argmax(values.real)])
    return complex(value.real, abs(value.imag))


def squeal_frequency(values: Eigenvalues) -> float:
    """|Im lambda|/2pi [Hz] of the eigenvalue with the largest real part; nan where nothing grows."""
    return leading(values).imag / (2.0 * math.pi) if is_unstable(values) else math.nan


def damping_ratio(value: complex) -> float:
    """Damping ratio zeta = -Re(lambda)/|lambda| of one mode; negative where it grows, nan at lambda = 0."""
    return -value.real / abs(value) if value else math.nan


def stability_band(p: RigParameters) -> tuple[float, float]:
    """Bounds [N/m] of the lowest unstable range of (k1 + k2)/2, at the ratio k1/k2 of `p`; from the linear model.

    Returns (nan, nan) where there is none, and an upper bound of inf where stability never returns.
    """
    return stability_bounds(pack(p), np.empty(4, dtype=np.complex128))


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
