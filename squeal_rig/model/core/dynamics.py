"""Eq. (2.3): forces on the pad, the right-hand side and its analytic Jacobian.

The kernels see the parameters as one float64 vector, made by `pack`; its layout is the constants below.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from squeal_rig.model.core.friction import force_ratio, force_ratio_slope, friction_coefficient
from squeal_rig.model.core.kernel import kernel
from squeal_rig.model.parameters import RigParameters

Vector = NDArray[np.float64]

# Layout of the packed parameters.
MASS, K1, K2, K34, K_C, L_PRE, C_X, C_Y = range(8)
L1, A1X, A1Y, L2, A2X, A2Y = range(8, 14)  # free lengths and anchors a_i = L_i (cos theta_i, sin theta_i)
LOAD_X, LOAD_Y = 14, 15  # the preload's force on the pad
MU, MU_AT_ZERO, MU_SLOPE, SPEED, V_REG = range(16, 21)
SLIP_DIRECTION, SLIP_SPEED = 21, 22  # 1.0 where the switch is on
PACKED_SIZE = 23


def pack(p: RigParameters) -> Vector:
    """The parameters as the kernels see them, float64 (23,), SI."""
    s1, c1 = math.sin(p.arm_angle_1), math.cos(p.arm_angle_1)
    s2, c2 = math.sin(p.arm_angle_2), math.cos(p.arm_angle_2)
    q = np.zeros(PACKED_SIZE)
    q[MASS], q[K1], q[K2], q[K34] = p.mass, p.k1, p.k2, p.k3 + p.k4
    q[K_C], q[L_PRE], q[C_X], q[C_Y] = p.contact_stiffness, p.pretension_length, p.damping_x, p.damping_y
    q[L1], q[A1X], q[A1Y] = p.arm_length_1, p.arm_length_1 * c1, p.arm_length_1 * s1
    q[L2], q[A2X], q[A2Y] = p.arm_length_2, p.arm_length_2 * c2, p.arm_length_2 * s2
    q[LOAD_X], q[LOAD_Y] = preload_force(p)
    q[MU] = friction_coefficient(p)
    q[MU_AT_ZERO] = friction_coefficient(p, speed=0.0)
    q[MU_SLOPE] = p.mu_speed + p.mu_speed_preload * p.preload
    q[SPEED], q[V_REG] = p.belt_speed, p.regularization_speed
    q[SLIP_DIRECTION] = float(p.friction_direction == "slip")
    q[SLIP_SPEED] = float(p.friction_speed == "slip")
    return q


def preload_force(p: RigParameters) -> tuple[float, float]:
    """Force of the preload on the pad [N] in x and y; x is zero where it acts vertically, as printed."""
    along = -p.preload * (math.cos(p.arm_angle_1) + math.cos(p.arm_angle_2))
    normal = -p.preload * (math.sin(p.arm_angle_1) + math.sin(p.arm_angle_2))
    return (along if p.preload_direction == "arms" else 0.0), normal


@kernel
def friction_ratio(vx: float, q: Vector) -> float:
    """F_t / N at pad velocity vx [m/s]: mu(V, F), with the two switches for slip."""
    mu = float(q[MU])
    slip = q[SPEED] - vx
    if q[SLIP_SPEED] > 0.0:
        mu = q[MU_AT_ZERO] + q[MU_SLOPE] * abs(slip)
    if q[SLIP_DIRECTION] > 0.0:
        mu *= math.tanh(slip / q[V_REG])
    return mu


@kernel
def arm_extensions(x: float, y: float, q: Vector) -> tuple[float, float]:
    """Extensions l_i - L_i [m] of both arms at pad position (x, y) [m].

    As (|r|^2 - 2 a.r)/(l + L): the plain difference of lengths loses four digits at r = 1e-5 m, L = 0.1 m.
    """
    square = x * x + y * y
    e1 = square - 2.0 * (q[A1X] * x + q[A1Y] * y)
    e2 = square - 2.0 * (q[A2X] * x + q[A2Y] * y)
    return (
        e1 / (math.sqrt(q[L1] * q[L1] + e1) + q[L1]),
        e2 / (math.sqrt(q[L2] * q[L2] + e2) + q[L2]),
    )


@kernel
def spring_force(x: float, y: float, q: Vector) -> tuple[float, float]:
    """Force of arms and clips on the pad [N]: Eq. (2.3), first terms, in x and y."""
    e1, e2 = arm_extensions(x, y, q)
    pull_1 = q[K1] * e1 / (q[L1] + e1)
    pull_2 = q[K2] * e2 / (q[L2] + e2)
    return (
        -pull_1 * (x - q[A1X]) - pull_2 * (x - q[A2X]) - q[K34] * x,
        -pull_1 * (y - q[A1Y]) - pull_2 * (y - q[A2Y]),
    )


@kernel
def acceleration(x: float, y: float, vx: float, vy: float, q: Vector) -> tuple[float, float]:
    """Pad acceleration [m/s^2], Eq. (2.3) with damping."""
    fx, fy = spring_force(x, y, q)
    normal = q[K_C] * max(0.0, q[L_PRE] - y)
    fx += q[LOAD_X] - q[C_X] * vx + friction_ratio(vx, q) * normal
    fy += q[LOAD_Y] - q[C_Y] * vy + normal
    return fx / q[MASS], fy / q[MASS]


def state_derivative(p: RigParameters, state: Vector) -> Vector:
    """Right-hand side of Eq. (2.3): d/dt of the state (x, y, vx, vy) [m, m/s], float64 (4,)."""
    x, y, vx, vy = (float(value) for value in state)
    ax, ay = acceleration(x, y, vx, vy, pack(p))
    return np.array([vx, vy, ax, ay])


def _arm_stiffness(k: float, length: float, ax: float, ay: float, x: float, y: float) -> Vector:
    """Tangent stiffness [N/m] (2, 2) of one arm: k n n^T, plus the geometric part k (l - L)/l (I - n n^T)."""
    rx, ry = x - ax, y - ay
    square = x * x + y * y - 2.0 * (ax * x + ay * y)
    stretched = math.sqrt(length * length + square)
    n = np.array([rx, ry]) / stretched
    along = np.outer(n, n)
    extension = square / (stretched + length)
    return k * (along + extension / stretched * (np.eye(2) - along))


def jacobian(p: RigParameters, state: Vector) -> Vector:
    """Analytic Jacobian (4, 4) of `state_derivative` at a state (x, y, vx, vy), geometric stiffness included.

    Off the belt (y > L_pre) the contact terms are zero; at y = L_pre exactly the side in contact is taken.
    """
    q = pack(p)
    x, y, vx, _ = (float(value) for value in state)
    stiffness = _arm_stiffness(p.k1, p.arm_length_1, q[A1X], q[A1Y], x, y)
    stiffness += _arm_stiffness(p.k2, p.arm_length_2, q[A2X], q[A2Y], x, y)
    stiffness[0, 0] += q[K34]
    damping = np.diag([p.damping_x, p.damping_y])
    if y <= p.pretension_length:
        stiffness[0, 1] += force_ratio(p, vx) * p.contact_stiffness
        stiffness[1, 1] += p.contact_stiffness
        damping[0, 0] -= force_ratio_slope(p, vx) * p.contact_stiffness * (p.pretension_length - y)
    result = np.zeros((4, 4))
    result[:2, 2:] = np.eye(2)
    result[2:, :2] = -stiffness / p.mass
    result[2:, 2:] = -damping / p.mass
    return result
