"""Complex eigenvalue analysis of one set of parameters."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from squeal_rig.model.core.dynamics import Vector, jacobian
from squeal_rig.model.core.friction import force_ratio_slope
from squeal_rig.model.core.statics import equilibrium, linear_equilibrium, normal_force, stiffness_matrix
from squeal_rig.model.parameters import RigParameters

Eigenvalues = NDArray[np.complex128]

#: Re(lambda) counts as growth above this share of |lambda|: rounding alone gives an undamped stable rig positive
#: real parts.
GROWTH_TOLERANCE = 1e-6


def state_matrix(p: RigParameters, linear: bool = False) -> Vector:
    """State matrix (4, 4) for (x, y, vx, vy): the analytic Jacobian at the exact equilibrium, or of Eqs. (3.1), (3.2).

    Raises:
        ModelError: the exact equilibrium does not exist.
    """
    if not linear:
        x, y = equilibrium(p)
        return jacobian(p, np.array([x, y, 0.0, 0.0]))
    damping_x = p.damping_x
    slope = force_ratio_slope(p)
    if slope != 0.0:
        damping_x -= slope * normal_force(p, linear_equilibrium(p)[1])
    matrix = np.zeros((4, 4))
    matrix[:2, 2:] = np.eye(2)
    matrix[2:, :2] = -stiffness_matrix(p) / p.mass
    matrix[2:, 2:] = -np.diag([damping_x, p.damping_y]) / p.mass
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
