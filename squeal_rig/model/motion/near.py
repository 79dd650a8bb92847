"""The pad's path as a Taylor series where the arms' rotation is small and friction constant, and its first zero.

As `series`, with all that a contact event needs made short: the order is fixed, and the rotation of the
arms is the polynomial g of `propagator`.
"""

from __future__ import annotations

from squeal_rig.model.core.kernel import fused_kernel, inlined_kernel
from squeal_rig.model.core.layout import C_X, C_Y, K_C, L_PRE, LOAD_X, LOAD_Y, MASS, MU, Vector
from squeal_rig.model.motion.propagator import GX, GY, K_AA, K_AB, K_BB, NEAR
from squeal_rig.model.motion.series import X, Y, first_zero, rests_on_edge

#: Rate times step is at most 0.25 here: what the series leaves out is below 0.25^10/10! = 3e-13 of the displacement.
NEAR_ORDER = 9


@inlined_kernel
def local_arms(g: Vector, x: float, y: float) -> tuple[float, float, float, float, float, float]:
    """One component of g, of coefficients `g` (7,), about (x, y): value, two slopes, second derivatives xx, xy, yy."""
    xx = g[0] + g[3] * x + g[4] * y
    yy = g[2] + g[5] * x + g[6] * y
    value = x * (x * xx + y * g[1]) + y * y * yy
    along_x = 2.0 * x * xx + y * g[1] + (x * x * g[3] + y * y * g[5])
    along_y = 2.0 * y * yy + x * g[1] + (x * x * g[4] + y * y * g[6])
    return (
        value,
        along_x,
        along_y,
        2.0 * xx + 4.0 * g[3] * x,
        g[1] + 2.0 * (g[4] * x + g[5] * y),
        2.0 * yy + 4.0 * g[6] * y,
    )


@inlined_kernel
def expand_near(
    state: Vector, q: Vector, flow: Vector, contact: bool, h: float, w: Vector
) -> tuple[float, float, float]:
    """As `expand`, to order 9; h at most the flow's step.

    The polynomial g is taken about the start of the step: exactly to first order in the step's own movement d, its
    second order up to order 5 in time. The cube left out is g_3(d), at most 2 k/m (d/L)^3 L: within the step below
    1e-12 r. The locals are derivatives, x_n = n! X_n, so that each order waits for one product of the last.

    Returns, of the coefficients of y from the second order on, the sum of |Y_n| and of n |Y_n|; and y(h) - y(0).
    """
    per_mass, hh = 1.0 / q[MASS], h * h
    x0, y0, x1, y1 = state[0], state[1], h * state[2], h * state[3]
    fx, xx, xy, ax, bx, cx = local_arms(flow[GX:GY], x0, y0)
    fy, yx, yy, ay, by, cy = local_arms(flow[GY:NEAR], x0, y0)
    stiffness = q[K_C] * per_mass if contact else 0.0
    pressed = stiffness * (q[L_PRE] - y0)
    fx += q[LOAD_X] * per_mass - flow[K_AA] * x0 - flow[K_AB] * y0 + q[MU] * pressed
    fy += q[LOAD_Y] * per_mass - flow[K_AB] * x0 - flow[K_BB] * y0 + pressed
    xx, xy = hh * (xx - flow[K_AA]), hh * (xy - flow[K_AB] - q[MU] * stiffness)
    yx, yy = hh * (yx - flow[K_AB]), hh * (yy - flow[K_BB] - stiffness)
    ax, bx, cx, ay, by, cy = hh * ax, hh * bx, hh * cx, hh * ay, hh * by, hh * cy
    dx, dy = h * q[C_X] * per_mass, h * q[C_Y] * per_mass
    x2, y2 = hh * fx - dx * x1, hh * fy - dy * y1
    x3, y3 = xx * x1 + xy * y1 - dx * x2, yx * x1 + yy * y1 - dy * y2
    # s, t, u: derivatives of d_x^2/2, d_x d_y, d_y^2/2.
    s, t, u = x1 * x1, 2.0 * x1 * y1, y1 * y1
    x4 = (ax * s + bx * t + cx * u) + xx * x2 + xy * y2 - dx * x3
    y4 = (ay * s + by * t + cy * u) + yx * x2 + yy * y2 - dy * y3
    s, t, u = 3.0 * x1 * x2, 3.0 * (x1 * y2 + x2 * y1), 3.0 * y1 * y2
    x5 = (ax * s + bx * t + cx * u) + xx * x3 + xy * y3 - dx * x4
    y5 = (ay * s + by * t + cy * u) + yx * x3 + yy * y3 - dy * y4
    s, t = 4.0 * x1 * x3 + 3.0 * x2 * x2, 4.0 * (x1 * y3 + x3 * y1) + 6.0 * x2 * y2
    u = 4.0 * y1 * y3 + 3.0 * y2 * y2
    x6 = (ax * s + bx * t + cx * u) + xx * x4 + xy * y4 - dx * x5
    y6 = (ay * s + by * t + cy * u) + yx * x4 + yy * y4 - dy * y5
    s, t = 5.0 * x1 * x4 + 10.0 * x2 * x3, 5.0 * (x1 * y4 + x4 * y1) + 10.0 * (x2 * y3 + x3 * y2)
    u = 5.0 * y1 * y4 + 10.0 * y2 * y3
    x7 = (ax * s + bx * t + cx * u) + xx * x5 + xy * y5 - dx * x6
    y7 = (ay * s + by * t + cy * u) + yx * x5 + yy * y5 - dy * y6
    x8, y8 = xx * x6 + xy * y6 - dx * x7, yx * x6 + yy * y6 - dy * y7
    x9, y9 = xx * x7 + xy * y7 - dx * x8, yx * x7 + yy * y7 - dy * y8
    w[X, 0], w[X, 1], w[X, 2], w[X, 3], w[X, 4] = x0, x1, x2 / 2.0, x3 * (1.0 / 6.0), x4 * (1.0 / 24.0)
    w[X, 5], w[X, 6], w[X, 7] = x5 * (1.0 / 120.0), x6 * (1.0 / 720.0), x7 * (1.0 / 5040.0)
    w[X, 8], w[X, 9] = x8 * (1.0 / 40320.0), x9 * (1.0 / 362880.0)
    y2, y3, y4, y5 = y2 / 2.0, y3 * (1.0 / 6.0), y4 * (1.0 / 24.0), y5 * (1.0 / 120.0)
    y6, y7, y8, y9 = y6 * (1.0 / 720.0), y7 * (1.0 / 5040.0), y8 * (1.0 / 40320.0), y9 * (1.0 / 362880.0)
    w[Y, 0], w[Y, 1], w[Y, 2], w[Y, 3], w[Y, 4], w[Y, 5] = y0, y1, y2, y3, y4, y5
    w[Y, 6], w[Y, 7], w[Y, 8], w[Y, 9] = y6, y7, y8, y9
    # Beyond order 4 a bound is enough.
    tail = (abs(y5) + abs(y6)) + (abs(y7) + abs(y8) + abs(y9))
    size = abs(y2) + abs(y3) + (abs(y4) + tail)
    slope = 2.0 * abs(y2) + 3.0 * abs(y3) + (4.0 * abs(y4) + 9.0 * tail)
    return size, slope, ((y9 + y8) + (y7 + y6)) + ((y5 + y4) + (y3 + y2)) + y1


@inlined_kernel
def evaluate_near(w: Vector, tau: float, h: float, state: Vector) -> None:
    """`evaluate` at order 9, a loop of known length."""
    x, y, vx, vy = w[X, NEAR_ORDER], w[Y, NEAR_ORDER], 0.0, 0.0
    for n in range(NEAR_ORDER - 1, -1, -1):
        vx, vy = vx * tau + x, vy * tau + y
        x, y = x * tau + w[X, n], y * tau + w[Y, n]
    per_step = 1.0 / h
    state[0], state[1], state[2], state[3] = x, y, vx * per_step, vy * per_step


@inlined_kernel
def first_zero_near(w: Vector, gap: float, size: float, slope: float, end: float) -> tuple[float, bool]:
    """`first_zero` of y - L_pre up to 1, with short ways for what nearly always happens.

    A first term that outweighs the others excludes a zero. A slope that keeps its sign allows one at most: the
    signs at the ends tell whether there is, and Newton's method finds it, from the reversed series on.
    `gap` is y - L_pre at 0; the other arguments are the sums that `expand_near` returns.
    """
    share, found, sure = _short_way(w, gap, size, slope, end)
    if not sure:
        share, found = _march(w, gap)
    return share, found


@inlined_kernel
def _short_way(w: Vector, gap: float, size: float, slope: float, end: float) -> tuple[float, bool, bool]:
    """As `first_zero_near`; whether a short way was found is the third answer."""
    steep = w[Y, 1]
    if gap == 0.0:
        return 1.0, False, abs(steep) > size
    if abs(gap) > abs(steep) + size:
        return 1.0, False, True
    if abs(steep) <= slope:
        return 1.0, False, False
    end += gap
    if (end > 0.0) == (gap > 0.0) and end != 0.0:
        return 1.0, False, True
    inverse = 1.0 / steep
    b, c, t = w[Y, 2] * inverse, w[Y, 3] * inverse, -gap * inverse
    bt = b * t
    t = min(1.0, t * (1.0 - bt * (1.0 - 2.0 * bt * (1.0 - 2.5 * bt)) - c * t * t * (1.0 - 5.0 * bt)))
    y2, y3, y4, y5, y6 = w[Y, 2], w[Y, 3], w[Y, 4], w[Y, 5], w[Y, 6]
    y7, y8, y9 = w[Y, 7], w[Y, 8], w[Y, 9]
    for _ in range(8):
        # Chebyshev's method: each error is about the cube of the last. The sums are split so that little is waited for.
        t2 = t * t
        t4 = t2 * t2
        t8 = t4 * t4
        value = (
            ((gap + steep * t) + (y2 + y3 * t) * t2) + ((y4 + y5 * t) + (y6 + y7 * t) * t2) * t4 + (y8 + y9 * t) * t8
        )
        low, high = 3.0 * y3 + 4.0 * y4 * t, 7.0 * y7 + 8.0 * y8 * t
        steepness = (steep + 2.0 * y2 * t + low * t2) + (5.0 * y5 + 6.0 * y6 * t + high * t2) * t4 + 9.0 * y9 * t8
        inverse = 1.0 / steepness
        step = value * inverse
        step *= 1.0 + step * inverse * (y2 + 3.0 * y3 * t + 6.0 * y4 * t2)
        t -= step
        if not 0.0 < t <= 1.0:
            break
        # The next step is the cube of this one, in units of the whole step: below rounding.
        if abs(step) <= 3e-6:
            return t, True, True
    return 1.0, False, False


@fused_kernel
def _march(w: Vector, gap: float) -> tuple[float, bool]:
    """`first_zero` of the row Y with another first term."""
    y = w[Y, 0]
    if rests_on_edge(gap, y, w):
        return 1.0, False
    w[Y, 0] = gap
    share, found = first_zero(w[Y, : NEAR_ORDER + 1], 1.0)
    w[Y, 0] = y
    return share, found
