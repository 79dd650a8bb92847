"""The pad's path as a Taylor series in time: Eq. (2.3) differentiated by recurrences, and the first zero of a series.

Coefficients are scaled by the step: x(tau h) = sum_n X_n tau^n, 0 <= tau <= 1. Recurrences (Jorba and Zou, A software
package for the numerical integration of ODEs by means of high-order Taylor methods, Exp. Math. 14, 2005, section 3):
products by Cauchy's rule; p = L/l = (1 + w)^(-1/2), w = (|r|^2 - 2 a.r)/L^2, from (1 + w) p' = -p w'/2; T = tanh s
from T' = (1 - T^2) s'. The force of arm i is k_i (p_i - 1)(r - a_i), with p - 1 kept as its own series so that
nothing cancels.
"""

from __future__ import annotations

import math

from squeal_rig.model.dynamics import (
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
from squeal_rig.model.kernel import fused_kernel
from squeal_rig.model.propagator import GX, GY, K_AA, K_AB, K_BB

MAX_ORDER = 16
#: Where the arms' rotation is small and rate times step at most 0.25 the series ends in rounding here.
NEAR_ORDER = 11

# Rows of the workspace: position; w and p - 1 of each arm; their weighted sum; normal force per mass; and for
# friction that sees the slip: slip over V_reg, tanh, 1 - tanh^2, coefficient, F_t/N.
X, Y, W1, W2, P1, P2, PULL, NORMAL, SLIP, TANH, SECH2, COEFFICIENT, RATIO = range(13)
EVENT = 13
ROWS = 14

_EPS = 2.220446049250313e-16
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
def _local(c: Vector, x: float, y: float) -> tuple[float, float, float, float, float, float]:
    """One component of g (squeal_rig.model.propagator) about (x, y): value, two slopes, coefficients of xx,
    xy, yy.
    """
    xx = c[0] + c[3] * x + c[4] * y
    yy = c[2] + c[5] * x + c[6] * y
    value = x * x * xx + x * y * c[1] + y * y * yy
    along_x = 2.0 * x * xx + y * c[1] + x * x * c[3] + y * y * c[5]
    along_y = 2.0 * y * yy + x * c[1] + x * x * c[4] + y * y * c[6]
    return (
        value,
        along_x,
        along_y,
        xx + 2.0 * c[3] * x,
        c[1] + 2.0 * (c[4] * x + c[5] * y),
        yy + 2.0 * c[6] * y,
    )


@fused_kernel
def expand_near(
    state: Vector, q: Vector, flow: Vector, contact: bool, h: float, w: Vector
) -> tuple[float, float, float]:
    """As `expand`, to order 11, where the arms' rotation is small and friction constant; h at most the flow's step.

    The polynomial g is taken about the start of the step: exactly to first order in the step's own movement d, its
    second order up to order 5 in time. The cube left out is g_3(d), at most 2 k/m (d/L)^3 L: within the step below
    1e-12 r.

    Returns, of the coefficients of y from the second order on, the sum of |Y_n| and of n |Y_n|; and y(h) - y(0).
    """
    m, hh = q[MASS], h * h
    x0, y0, x1, y1 = state[0], state[1], h * state[2], h * state[3]
    fx, xx, xy, ax, bx, cx = _local(flow[GX : GX + 7], x0, y0)
    fy, yx, yy, ay, by, cy = _local(flow[GY : GY + 7], x0, y0)
    fx += q[LOAD_X] / m - flow[K_AA] * x0 - flow[K_AB] * y0
    fy += q[LOAD_Y] / m - flow[K_AB] * x0 - flow[K_BB] * y0
    xx, xy, yx, yy = hh * (xx - flow[K_AA]), hh * (xy - flow[K_AB]), hh * (yx - flow[K_AB]), hh * (yy - flow[K_BB])
    if contact:
        pressed = q[K_C] / m
        fx += q[MU] * pressed * (q[L_PRE] - y0)
        fy += pressed * (q[L_PRE] - y0)
        xy -= hh * q[MU] * pressed
        yy -= hh * pressed
    ax, bx, cx, ay, by, cy = hh * ax, hh * bx, hh * cx, hh * ay, hh * by, hh * cy
    dx, dy = h * q[C_X] / m, h * q[C_Y] / m
    # Reciprocals, and the damping last: what each order waits for is one product.
    x2, y2 = 0.5 * (hh * fx - dx * x1), 0.5 * (hh * fy - dy * y1)
    x3 = (1.0 / 6.0) * (xx * x1 + xy * y1) - (1.0 / 3.0) * dx * x2
    y3 = (1.0 / 6.0) * (yx * x1 + yy * y1) - (1.0 / 3.0) * dy * y2
    s, t, u = x1 * x1, x1 * y1, y1 * y1
    x4 = (1.0 / 12.0) * (xx * x2 + xy * y2 + (ax * s + bx * t + cx * u)) - 0.25 * dx * x3
    y4 = (1.0 / 12.0) * (yx * x2 + yy * y2 + (ay * s + by * t + cy * u)) - 0.25 * dy * y3
    s, t, u = 2.0 * x1 * x2, x1 * y2 + x2 * y1, 2.0 * y1 * y2
    x5 = 0.05 * (xx * x3 + xy * y3 + (ax * s + bx * t + cx * u)) - 0.2 * dx * x4
    y5 = 0.05 * (yx * x3 + yy * y3 + (ay * s + by * t + cy * u)) - 0.2 * dy * y4
    s, t, u = x2 * x2 + 2.0 * x1 * x3, x2 * y2 + (x1 * y3 + x3 * y1), y2 * y2 + 2.0 * y1 * y3
    x6 = (1.0 / 30.0) * (xx * x4 + xy * y4 + (ax * s + bx * t + cx * u)) - (1.0 / 6.0) * dx * x5
    y6 = (1.0 / 30.0) * (yx * x4 + yy * y4 + (ay * s + by * t + cy * u)) - (1.0 / 6.0) * dy * y5
    s, t, u = 2.0 * (x1 * x4 + x2 * x3), x1 * y4 + x4 * y1 + (x2 * y3 + x3 * y2), 2.0 * (y1 * y4 + y2 * y3)
    x7 = (1.0 / 42.0) * (xx * x5 + xy * y5 + (ax * s + bx * t + cx * u)) - (1.0 / 7.0) * dx * x6
    y7 = (1.0 / 42.0) * (yx * x5 + yy * y5 + (ay * s + by * t + cy * u)) - (1.0 / 7.0) * dy * y6
    x8 = (1.0 / 56.0) * (xx * x6 + xy * y6) - 0.125 * dx * x7
    y8 = (1.0 / 56.0) * (yx * x6 + yy * y6) - 0.125 * dy * y7
    x9 = (1.0 / 72.0) * (xx * x7 + xy * y7) - (1.0 / 9.0) * dx * x8
    y9 = (1.0 / 72.0) * (yx * x7 + yy * y7) - (1.0 / 9.0) * dy * y8
    x10 = (1.0 / 90.0) * (xx * x8 + xy * y8) - 0.1 * dx * x9
    y10 = (1.0 / 90.0) * (yx * x8 + yy * y8) - 0.1 * dy * y9
    x11 = (1.0 / 110.0) * (xx * x9 + xy * y9) - (1.0 / 11.0) * dx * x10
    y11 = (1.0 / 110.0) * (yx * x9 + yy * y9) - (1.0 / 11.0) * dy * y10
    w[X, 0], w[X, 1], w[X, 2], w[X, 3], w[X, 4], w[X, 5] = x0, x1, x2, x3, x4, x5
    w[X, 6], w[X, 7], w[X, 8], w[X, 9], w[X, 10], w[X, 11] = x6, x7, x8, x9, x10, x11
    w[Y, 0], w[Y, 1], w[Y, 2], w[Y, 3], w[Y, 4], w[Y, 5] = y0, y1, y2, y3, y4, y5
    w[Y, 6], w[Y, 7], w[Y, 8], w[Y, 9], w[Y, 10], w[Y, 11] = y6, y7, y8, y9, y10, y11
    m2, m3, m4, m5, m6 = abs(y2), abs(y3), abs(y4), abs(y5), abs(y6)
    # Beyond order 6 a bound is enough.
    tail = abs(y7) + abs(y8) + (abs(y9) + abs(y10) + abs(y11))
    size = (m2 + m3) + (m4 + m5) + (m6 + tail)
    slope = (2.0 * m2 + 3.0 * m3) + (4.0 * m4 + 5.0 * m5) + (6.0 * m6 + 11.0 * tail)
    return size, slope, (y11 + y10 + y9) + (y8 + y7 + y6) + (y5 + y4 + y3) + (y2 + y1)


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
def _evaluate_near(w: Vector, tau: float, h: float, state: Vector) -> None:
    """`evaluate` at order 11, a loop of known length."""
    x, y, vx, vy = w[X, NEAR_ORDER], w[Y, NEAR_ORDER], 0.0, 0.0
    for n in range(NEAR_ORDER - 1, -1, -1):
        vx, vy = vx * tau + x, vy * tau + y
        x, y = x * tau + w[X, n], y * tau + w[Y, n]
    state[0], state[1], state[2], state[3] = x, y, vx / h, vy / h


@fused_kernel
def evaluate(w: Vector, order: int, tau: float, h: float, state: Vector) -> None:
    """Put the path at tau (share of the step h [s]) into `state` (4,)."""
    if order == NEAR_ORDER:
        _evaluate_near(w, tau, h, state)
        return
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


@fused_kernel
def first_zero_near(c: Vector, size: float, slope: float, end: float) -> tuple[float, bool]:
    """`first_zero` of a series of order 11 up to 1, with short ways for what nearly always happens.

    A first term that outweighs the others excludes a zero. A slope that keeps its sign allows one at most: the
    signs at the ends tell whether there is, and Newton's method finds it. The other arguments are the sums that
    `expand_near` returns.
    """
    if c[0] == 0.0:
        if abs(c[1]) > size:
            return 1.0, False
        return first_zero(c[: NEAR_ORDER + 1], 1.0)
    if abs(c[0]) > abs(c[1]) + size:
        return 1.0, False
    if abs(c[1]) <= slope:
        return first_zero(c[: NEAR_ORDER + 1], 1.0)
    end += c[0]
    if (end > 0.0) == (c[0] > 0.0) and end != 0.0:
        return 1.0, False
    t = c[0] / (c[0] - end)
    for _ in range(8):
        value, steepness = c[NEAR_ORDER], 0.0
        for n in range(NEAR_ORDER - 1, -1, -1):
            steepness = steepness * t + value
            value = value * t + c[n]
        step = value / steepness
        t -= step
        if not 0.0 < t <= 1.0:
            break
        # The next step is the square of this one, in units of the whole step: below rounding.
        if abs(step) <= 1e-8:
            return t, True
    return first_zero(c[: NEAR_ORDER + 1], 1.0)
