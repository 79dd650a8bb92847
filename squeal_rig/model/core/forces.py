"""Eq. (2.3): forces on the pad, the right-hand side and its analytic Jacobian, in compiled code.

The kernels see the parameters packed (`layout`).
"""

from __future__ import annotations

import math

import numpy as np

from squeal_rig.model.core.kernel import fused_kernel, kernel
from squeal_rig.model.core.layout import (
    A1X,
    A1Y,
    A2X,
    A2Y,
    C_X,
    C_Y,
    K1,
    K2,
    K34,
    K_C,
    L1,
    L2,
    L_PRE,
    LOAD_X,
    LOAD_Y,
    MASS,
    MU,
    MU_AT_ZERO,
    MU_SLOPE,
    NORMAL,
    SAMPLE_SIZE,
    SLIP_DIRECTION,
    SLIP_SPEED,
    SPEED,
    TANGENTIAL,
    V_REG,
    VX,
    Vector,
    Y,
    pack,
)
from squeal_rig.model.parameters import RigParameters

#: |s|/V_reg from which on tanh is computed as 1; that it is 1 to rounding from 19.1 on is enough for a path (`slip`).
_TANH_IS_ONE = 22.0


@kernel
def friction_ratio(vx: float, q: Vector) -> float:
    """F_t / N at pad velocity vx [m/s]: mu(V, F), with the two switches for slip."""
    mu = float(q[MU])
    slip = q[SPEED] - vx
    if q[SLIP_SPEED] > 0.0:
        mu = q[MU_AT_ZERO] + q[MU_SLOPE] * abs(slip)
    if q[SLIP_DIRECTION] > 0.0:
        share = slip / q[V_REG]
        mu *= math.copysign(1.0, share) if abs(share) >= _TANH_IS_ONE else math.tanh(share)
    return mu


@kernel
def friction_ratio_slope(vx: float, q: Vector) -> float:
    """d(F_t/N)/d(vx) at pad velocity vx [s/m]: zero for the printed law, else what slip-dependent friction adds.

    With `friction_speed="slip"` it acts like damping c_x = N dmu/dV on x alone. A negative slope destabilises the
    undamped rig everywhere, a positive one too where K_ab (K_ab + mu k_c) < 0: only with c > 0 is its sign decisive.
    """
    slip = q[SPEED] - vx
    mu, slope = float(q[MU]), 0.0
    if q[SLIP_SPEED] > 0.0:
        mu = q[MU_AT_ZERO] + q[MU_SLOPE] * abs(slip)
        slope = -q[MU_SLOPE] * math.copysign(1.0, slip)
    if q[SLIP_DIRECTION] > 0.0:
        tanh = math.tanh(slip / q[V_REG])
        slope = slope * tanh - mu * (1.0 - tanh * tanh) / q[V_REG]
    return slope


@kernel
def contact_force(y: float, q: Vector) -> float:
    """Normal contact force N = k_c max(0, L_pre - y) [N] at pad height y [m]."""
    return float(q[K_C] * max(0.0, q[L_PRE] - y))


@fused_kernel
def fill_forces(y: Vector, vx: Vector, q: Vector, normal: Vector, tangential: Vector) -> None:
    """Fill N and F_t (n,) [N] at heights y (n,) [m] and velocities vx (n,) [m/s]."""
    stiffness, edge, mu = q[K_C], q[L_PRE], q[MU]
    for i in range(len(y)):
        force = stiffness * max(0.0, edge - y[i])
        normal[i], tangential[i] = force, mu * force
    if q[SLIP_SPEED] > 0.0 or q[SLIP_DIRECTION] > 0.0:
        # Up to this vx the ratio is mu in every digit.
        plain = -math.inf if q[SLIP_SPEED] > 0.0 else q[SPEED] - _TANH_IS_ONE * q[V_REG]
        for i in range(len(y)):
            if vx[i] > plain and normal[i] > 0.0:
                tangential[i] = friction_ratio(vx[i], q) * normal[i]


@fused_kernel
def add_forces(samples: Vector, q: Vector) -> None:
    """Fill the forces of samples (n, 6), whose states are there; samples (n, 4) have no room for any."""
    if samples.shape[1] == SAMPLE_SIZE:
        fill_forces(samples[:, Y], samples[:, VX], q, samples[:, NORMAL], samples[:, TANGENTIAL])


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
def spring_stiffness(x: float, y: float, q: Vector) -> tuple[float, float, float]:
    """Tangent stiffness [N/m] of arms and clips at (x, y) [m]: xx, xy, yy.

    Of one arm k [n n^T + (l - L)/l (I - n n^T)], n its direction.
    """
    e1, e2 = arm_extensions(x, y, q)
    xx, xy, yy = q[K34], 0.0, 0.0
    for k, length, extension, ax, ay in ((q[K1], q[L1], e1, q[A1X], q[A1Y]), (q[K2], q[L2], e2, q[A2X], q[A2Y])):
        stretched = length + extension
        nx, ny = (x - ax) / stretched, (y - ay) / stretched
        turned = extension / stretched
        xx += k * (nx * nx + turned * ny * ny)
        xy += k * (1.0 - turned) * nx * ny
        yy += k * (ny * ny + turned * nx * nx)
    return float(xx), float(xy), float(yy)


@kernel
def acceleration(x: float, y: float, vx: float, vy: float, q: Vector) -> tuple[float, float]:
    """Pad acceleration [m/s^2], Eq. (2.3) with damping."""
    fx, fy = spring_force(x, y, q)
    normal = q[K_C] * max(0.0, q[L_PRE] - y)
    fx += q[LOAD_X] - q[C_X] * vx + friction_ratio(vx, q) * normal
    fy += q[LOAD_Y] - q[C_Y] * vy + normal
    return fx / q[MASS], fy / q[MASS]


@kernel
def jacobian_of(x: float, y: float, vx: float, q: Vector) -> Vector:
    """`jacobian` of packed parameters."""
    xx, xy, yy = spring_stiffness(x, y, q)
    yx, damping_x = xy, q[C_X]
    if y <= q[L_PRE]:
        xy += friction_ratio(vx, q) * q[K_C]
        yy += q[K_C]
        damping_x -= friction_ratio_slope(vx, q) * contact_force(y, q)
    result = np.zeros((4, 4))
    result[0, 2] = result[1, 3] = 1.0
    result[2, 0], result[2, 1], result[2, 2] = -xx / q[MASS], -xy / q[MASS], -damping_x / q[MASS]
    result[3, 0], result[3, 1], result[3, 3] = -yx / q[MASS], -yy / q[MASS], -q[C_Y] / q[MASS]
    return result


def state_derivative(p: RigParameters, state: Vector) -> Vector:
    """Right-hand side of Eq. (2.3): d/dt of the state (x, y, vx, vy) [m, m/s], float64 (4,)."""
    x, y, vx, vy = (float(value) for value in state)
    ax, ay = acceleration(x, y, vx, vy, pack(p))
    return np.array([vx, vy, ax, ay])


def jacobian(p: RigParameters, state: Vector) -> Vector:
    """Analytic Jacobian (4, 4) of `state_derivative` at a state (x, y, vx, vy), geometric stiffness included.

    Off the belt (y > L_pre) the contact terms are zero; at y = L_pre exactly the side in contact is taken.
    """
    x, y, vx, _ = (float(value) for value in state)
    return jacobian_of(x, y, vx, pack(p))
