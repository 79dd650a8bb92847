"""The pad's path as a Taylor series in time: Eq. (2.3) differentiated by recurrences, and the first zero of a series.

Coefficients are scaled by the step: x(tau h) = sum_n X_n tau^n, 0 <= tau <= 1. Recurrences (Jorba and Zou, A software
package for the numerical integration of ODEs by means of high-order Taylor methods, Exp. Math. 14, 2005, section 3):
products by Cauchy's rule; p = L/l = (1 + w)^(-1/2), w = (|r|^2 - 2 a.r)/L^2, from (1 + w) p' = -p w'/2; T = tanh s
from T' = (1 - T^2) s'. The force of arm i is k_i (p_i - 1)(r - a_i), with p - 1 kept as its own series so that
nothing cancels.
"""

from __future__ import annotations

import math

from squeal_rig.model.core.kernel import fused_kernel
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
    SLIP_DIRECTION,
    SLIP_SPEED,
    SPEED,
    V_REG,
    Vector,
)
from squeal_rig.model.motion.propagator import K_AA, K_AB, K_BB

MAX_ORDER = 16

# Rows of the workspace: position; w and p - 1 of each arm; their weighted sum; normal force per mass; and for
# friction that sees the slip: slip over V_reg, tanh, 1 - tanh^2, coefficient, F_t/N.
X, Y, W1, W2, P1, P2, PULL, NORMAL, SLIP, TANH, SECH2, COEFFICIENT, RATIO = range(13)
EVENT = 13
ROWS = 14

_EPS = 2.220446049250313e-16
_ROUNDING = 4.0 * _EPS
_MAX_ITERATIONS = 80


@fused_kernel
def expand(
    state: Vector,
    q: Vector,
    flow: Vector,
    contact: bool,
    slip_sign: float,
    h: float,
    order: int,
    arm_order: int,
    w: Vector,
) -> None:
    """Fill the rows X and Y of the workspace `w` (14, 17) with the path from `state` (4,) over h [s].

    Args:
        state: x, y, vx, vy [m, m/s].
        q: packed parameters.
        flow: propagators (only their linear stiffness is used).
        contact: whether the contact spring acts.
        slip_sign: sign of V - vx over the step, for friction that sees |V - vx|.
        h: step [s].
        order: of the path, at most 16.
        arm_order: up to which order of the force the arms are nonlinear; beyond it they are linear.
        w: workspace.
    """
    m = q[MASS]
    slips = contact and (q[SLIP_SPEED] > 0.0 or q[SLIP_DIRECTION] > 0.0)
    w[X, 0], w[Y, 0], w[X, 1], w[Y, 1] = state[0], state[1], h * state[2], h * state[3]
    hh = h * h
    clips = q[K34] / m
    normal = q[K_C] / m if contact else 0.0
    friction = q[MU]
    pull_x1, pull_y1, pull_x2, pull_y2 = q[K1] * q[A1X] / m, q[K1] * q[A1Y] / m, q[K2] * q[A2X] / m, q[K2] * q[A2Y] / m
    for n in range(order - 1):
        ax = -clips * w[X, n] if n <= arm_order else -flow[K_AA] * w[X, n] - flow[K_AB] * w[Y, n]
        ay = 0.0 if n <= arm_order else -flow[K_AB] * w[X, n] - flow[K_BB] * w[Y, n]
        if n <= arm_order:
            _arm_terms(n, q, w)
            for j in range(n + 1):
                ax += w[PULL, j] * w[X, n - j]
                ay += w[PULL, j] * w[Y, n - j]
            ax -= pull_x1 * w[P1, n] + pull_x2 * w[P2, n]
            ay -= pull_y1 * w[P1, n] + pull_y2 * w[P2, n]
        pressed = -normal * w[Y, n]
        if n == 0:
            pressed = normal * (q[L_PRE] - w[Y, 0])
            ax += q[LOAD_X] / m
            ay += q[LOAD_Y] / m
        ay += pressed
        if slips:
            w[NORMAL, n] = pressed
            _friction_terms(n, q, slip_sign, h, w)
            for j in range(n + 1):
                ax += w[RATIO, j] * w[NORMAL, n - j]
        else:
            ax += friction * pressed
        share = 1.0 / ((n + 1) * (n + 2))
        w[X, n + 2] = share * (hh * ax - h * q[C_X] / m * (n + 1) * w[X, n + 1])
        w[Y, n + 2] = share * (hh * ay - h * q[C_Y] / m * (n + 1) * w[Y, n + 1])


@fused_kernel
def _arm_terms(n: int, q: Vector, w: Vector) -> None:
    """Order n of w, p - 1 and of sum k_i/m (p_i - 1)."""
    square = 0.0
    for j in range(n + 1):
        square += w[X, j] * w[X, n - j] + w[Y, j] * w[Y, n - j]
    w[W1, n] = (square - 2.0 * (q[A1X] * w[X, n] + q[A1Y] * w[Y, n])) / (q[L1] * q[L1])
    w[W2, n] = (square - 2.0 * (q[A2X] * w[X, n] + q[A2Y] * w[Y, n])) / (q[L2] * q[L2])
    if n == 0:
        s1, s2 = 1.0 + w[W1, 0], 1.0 + w[W2, 0]
        w[P1, 0] = -w[W1, 0] / (s1 + math.sqrt(s1))
        w[P2, 0] = -w[W2, 0] / (s2 + math.sqrt(s2))
    else:
        p1, p2 = -0.5 * n * w[W1, n], -0.5 * n * w[W2, n]
        for j in range(1, n + 1):
            c = 0.5 * j - n
            p1 += c * w[W1, j] * w[P1, n - j]
            p2 += c * w[W2, j] * w[P2, n - j]
        w[P1, n] = p1 / (n * (1.0 + w[W1, 0]))
        w[P2, n] = p2 / (n * (1.0 + w[W2, 0]))
    w[PULL, n] = (q[K1] * w[P1, n] + q[K2] * w[P2, n]) / q[MASS]


@fused_kernel
def _friction_terms(n: int, q: Vector, slip_sign: float, h: float, w: Vector) -> None:
    """Order n of F_t/N where friction sees the slip V - vx."""
    slip = -(n + 1) * w[X, n + 1] / h
    if n == 0:
        slip += q[SPEED]
    coefficient = q[MU] if n == 0 else 0.0
    if q[SLIP_SPEED] > 0.0:
        coefficient = q[MU_SLOPE] * slip_sign * slip + (q[MU_AT_ZERO] if n == 0 else 0.0)
    w[COEFFICIENT, n] = coefficient
    if q[SLIP_DIRECTION] <= 0.0:
        w[RATIO, n] = coefficient
        return
    w[SLIP, n] = slip / q[V_REG]
    if n == 0:
        w[TANH, 0] = math.tanh(w[SLIP, 0])
        w[SECH2, 0] = 1.0 / math.cosh(min(abs(w[SLIP, 0]), 300.0)) ** 2
    else:
        tanh, square = 0.0, 0.0
        for j in range(1, n + 1):
            tanh += j * w[SLIP, j] * w[SECH2, n - j]
        w[TANH, n] = tanh / n
        for j in range(n + 1):
            square += w[TANH, j] * w[TANH, n - j]
        w[SECH2, n] = -square
    ratio = 0.0
    for j in range(n + 1):
        ratio += w[COEFFICIENT, j] * w[TANH, n - j]
    w[RATIO, n] = ratio


@fused_kernel
def evaluate(w: Vector, order: int, tau: float, h: float, state: Vector) -> None:
    """Put the path at tau (share of the step h [s]) into `state` (4,)."""
    x, y, vx, vy = w[X, order], w[Y, order], order * w[X, order], order * w[Y, order]
    for n in range(order - 1, 0, -1):
        x, y = x * tau + w[X, n], y * tau + w[Y, n]
        vx, vy = vx * tau + n * w[X, n], vy * tau + n * w[Y, n]
    state[0], state[1], state[2], state[3] = x * tau + w[X, 0], y * tau + w[Y, 0], vx / h, vy / h


@fused_kernel
def trusted_share(w: Vector, order: int) -> float:
    """Share of the step up to which the series is exact to rounding, from its last two terms (Jorba and Zou,
    section 3.2).
    """
    # Up to the acceleration: a pad may start at rest at r = 0.
    scale = max(abs(w[X, 0]), abs(w[Y, 0]), abs(w[X, 1]), abs(w[Y, 1]), abs(w[X, 2]), abs(w[Y, 2]))
    last = max(abs(w[X, order]), abs(w[Y, order]))
    before = max(abs(w[X, order - 1]), abs(w[Y, order - 1]))
    if not math.isfinite(last + before + scale):
        return 0.0
    share = 1.0
    if last > _EPS * scale:
        share = min(share, (_EPS * scale / last) ** (1.0 / order))
    if before > _EPS * scale:
        share = min(share, (_EPS * scale / before) ** (1.0 / (order - 1)))
    return share


@fused_kernel
def share_before_tanh_turns(w: Vector, order: int, share: float) -> float:
    """The part of a trusted share of the step in which the slip moves less than half way to the nearest pole of
    tanh, at +- i pi/2.

    Far from zero slip tanh is 1 to rounding and its series says nothing of the turn ahead: `trusted_share` cannot
    see it.
    """
    movement = 0.0
    for n in range(order - 2, 0, -1):
        movement = (movement + abs(w[SLIP, n])) * share
    allowed = 0.5 * math.sqrt(w[SLIP, 0] ** 2 + 2.4674011002723395)
    return share if movement <= allowed else share * allowed / movement


@fused_kernel
def rests_on_edge(gap: float, y: float, w: Vector) -> bool:
    """Whether the pad stays on the very edge to rounding over the step: then there are no events to look for."""
    return bool(max(abs(gap), abs(w[Y, 1]), abs(w[Y, 2]), abs(w[Y, 3])) <= _ROUNDING * abs(y))


@fused_kernel
def first_zero(c: Vector, limit: float) -> tuple[float, bool]:
    """First zero in (0, limit], limit <= 1, of sum_n c_n t^n, to rounding; zeros at 0 are divided out.

    March from 0 by the shortest time in which the series could reach zero: with value v, slope s towards zero and a
    bound M of the second derivative that is v = s t + M t^2/2. Such a step never passes the first zero, however
    many follow, and near a simple zero it is Newton's. So two crossings within a step or a graze are not missed,
    and none is invented.

    Returns up to where there is no zero (the limit, or less where the march was given up), and whether the zero is
    there.
    """
    low = 0
    while low < c.shape[0] and c[low] == 0.0:
        low += 1
    if low >= c.shape[0]:
        return limit, False
    top = c.shape[0] - 1
    curvature = 0.0
    for n in range(top, low + 1, -1):
        curvature = curvature * limit + (n - low) * (n - low - 1) * abs(c[n])
    sign = 1.0 if c[low] > 0.0 else -1.0
    t = 0.0
    for _ in range(_MAX_ITERATIONS):
        value, slope = c[top], 0.0
        for n in range(top - 1, low - 1, -1):
            slope = slope * t + value
            value = value * t + c[n]
        value *= sign
        closing = -slope * sign
        if value <= 0.0:
            return t, True
        reach = closing + math.sqrt(closing * closing + 2.0 * curvature * value)
        # Not within the limit, also where both are zero.
        if reach * (limit - t) < 2.0 * value:
            return limit, False
        advance = 2.0 * value / reach
        t = min(t + advance, limit)
        if advance <= _EPS * t:
            return t, True
    return t, False
