"""The pad's path as a Taylor series on a belt whose friction sees the slip, where the arms' rotation is small.

As `series`, with all that its length allows made short, since a step of the engine in contact needs one: the arms are
linear about the start of the step but for the polynomial g of `propagator`, and far from zero slip tanh is +-1 to
rounding and friction costs one product an order.

With d = r - r_0 the arms' force per mass is exactly, as g is a cubic polynomial,

    f(r_0) + J d + (a + c_1 d_x + c_2 d_y) d_x^2 + b d_x d_y + (e + c_3 d_x + c_4 d_y) d_y^2

for either axis: J and the second derivatives at r_0, c the coefficients of g's cubic terms. With s = V - vx friction is
(alpha + beta s) tanh(s/V_reg) N, as in `forces`. Coefficients are scaled by the step, products go by Cauchy's rule,
T = tanh from T' = (1 - T^2) s', as in `series`.
"""

from __future__ import annotations

import math

from squeal_rig.model.core.kernel import fused_kernel, inlined_kernel
from squeal_rig.model.core.layout import (
    C_X,
    C_Y,
    K_C,
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
from squeal_rig.model.motion.near import local_arms
from squeal_rig.model.motion.propagator import GX, GY, K_AA, K_AB, K_BB, NEAR
from squeal_rig.model.motion.series import NORMAL, P2, RATIO, SECH2, SLIP, TANH, W1, W2, X, Y

#: Up to these orders of the force the arms' terms of degree 2 and 3 in d are kept. At rate times step 0.65, four steps
#: of the engine, the next ones are below (2 0.65)^11/11! and (3 0.65)^8/8! of 5e-5 and 4e-8 of the displacement at the
#: end of the near range, over n^2 as the force is integrated twice: 2e-13 and 2e-12, and a tenth of that in squeal.
SQUARE_ORDER, CUBE_ORDER = 10, 7
#: A series ends where its last term is so small a share of the path: what is left out is less by rate times step over
#: the order, rounding.
LAST_TERM = 128.0 * 2.220446049250313e-16
_FIRST_ENDING = 9
#: |s|/V_reg from which on 1 - |tanh| is below rounding, and where a step may start that takes it so.
SATURATED, SAFELY_SATURATED = 19.1, 22.0
#: How tanh was taken.
AS_IT_IS, AS_ONE, ABSENT = range(3)

# Rows of the workspace that stand for something else here: d_x^2, d_y^2, the coefficient alpha + beta s.
_XX, _YY, _COEFFICIENT = W1, W2, P2


@fused_kernel
def expand_slip(
    state: Vector, q: Vector, flow: Vector, slip_sign: float, h: float, order: int, w: Vector
) -> tuple[int, int]:
    """Fill the rows X and Y of the workspace with the path in contact from `state` (4,) over h [s], in the near range.

    Args:
        state: x, y, vx, vy [m, m/s].
        q: packed parameters.
        flow: propagators: linear stiffness and g.
        slip_sign: sign of V - vx over the step, for friction that sees |V - vx|.
        h: step [s].
        order: of the path at most, 16 or less.
        w: workspace. Rows SLIP (s over V_reg), TANH, SECH2 are filled only where tanh is not saturated.

    Returns:
        the order reached: less than `order` once terms have become as small as `LAST_TERM`, where tanh does not bend;
        and how tanh was taken: `AS_IT_IS`, `AS_ONE` in size, which holds while |s| stays above `SATURATED` V_reg, or
        `ABSENT`.
    """
    per_mass, hh = 1.0 / q[MASS], h * h
    x0, y0 = state[0], state[1]
    fx, xx, xy, ax, bx, cx = local_arms(flow[GX:GY], x0, y0)
    fy, yx, yy, ay, by, cy = local_arms(flow[GY:NEAR], x0, y0)
    stiffness = q[K_C] * per_mass
    fx = hh * (fx + q[LOAD_X] * per_mass - flow[K_AA] * x0 - flow[K_AB] * y0)
    fy = hh * (fy + q[LOAD_Y] * per_mass - flow[K_AB] * x0 - flow[K_BB] * y0 + stiffness * (q[L_PRE] - y0))
    xx, xy = hh * (xx - flow[K_AA]), hh * (xy - flow[K_AB])
    yx, yy = hh * (yx - flow[K_AB]), hh * (yy - flow[K_BB] - stiffness)
    ax, bx, cx, ay, by, cy = 0.5 * hh * ax, hh * bx, 0.5 * hh * cx, 0.5 * hh * ay, hh * by, 0.5 * hh * cy
    gx3, gx4, gx5, gx6 = hh * flow[GX + 3], hh * flow[GX + 4], hh * flow[GX + 5], hh * flow[GX + 6]
    gy3, gy4, gy5, gy6 = hh * flow[GY + 3], hh * flow[GY + 4], hh * flow[GY + 5], hh * flow[GY + 6]
    dx, dy = h * q[C_X] * per_mass, h * q[C_Y] * per_mass
    wx, wy, normal, ratio = w[X], w[Y], w[NORMAL], w[RATIO]
    w_xx, w_yy = w[_XX], w[_YY]
    # Friction is (alpha + beta s) tanh(s/V_reg); per mass and scaled, the normal force carries h^2.
    alpha, beta = q[MU], 0.0
    if q[SLIP_SPEED] > 0.0:
        alpha, beta = q[MU_AT_ZERO], q[MU_SLOPE] * slip_sign
    slip = q[SPEED] - state[2]
    taken = AS_IT_IS if q[SLIP_DIRECTION] > 0.0 else ABSENT
    if taken == AS_IT_IS and abs(slip) >= SAFELY_SATURATED * q[V_REG]:
        taken = AS_ONE
        if slip < 0.0:
            alpha, beta = -alpha, -beta
    bends = taken == AS_IT_IS
    ratio_step, normal_step = -beta / h, -hh * stiffness
    wx[0], wy[0], wx[1], wy[1] = x0, y0, h * state[2], h * state[3]
    normal[0] = normal_step * (y0 - q[L_PRE])
    ratio[0] = alpha + beta * slip
    if bends:
        _bend(0, slip, ratio, q[V_REG], h, w)
    wx[2] = 0.5 * (fx + ratio[0] * normal[0] - dx * wx[1])
    wy[2] = 0.5 * (fy - dy * wy[1])
    limit = LAST_TERM * max(abs(x0), abs(y0), abs(wx[1]), abs(wy[1]), abs(wx[2]), abs(wy[2]))
    for n in range(1, order - 1):
        normal[n] = normal_step * wy[n]
        ratio[n] = ratio_step * (n + 1) * wx[n + 1]
        if bends:
            _bend(n, slip, ratio, q[V_REG], h, w)
        # What is known from lower orders first: nothing of the last order has to be waited for.
        friction = 0.0
        force_x, force_y = 0.0, 0.0
        if n <= SQUARE_ORDER:
            s, t, u = 0.0, 0.0, 0.0
            for j in range(1, n):
                x, y = wx[j], wy[j]
                s += x * wx[n - j]
                t += x * wy[n - j]
                u += y * wy[n - j]
                friction += ratio[n - j] * normal[j]
            w_xx[n], w_yy[n] = s, u
            force_x += ax * s + bx * t + cx * u
            force_y += ay * s + by * t + cy * u
            if n <= CUBE_ORDER:
                sx, sy, ux, uy = 0.0, 0.0, 0.0, 0.0
                for j in range(2, n):
                    sx += w_xx[j] * wx[n - j]
                    sy += w_xx[j] * wy[n - j]
                    ux += w_yy[j] * wx[n - j]
                    uy += w_yy[j] * wy[n - j]
                force_x += gx3 * sx + gx4 * sy + gx5 * ux + gx6 * uy
                force_y += gy3 * sx + gy4 * sy + gy5 * ux + gy6 * uy
        else:
            for j in range(1, n):
                friction += ratio[n - j] * normal[j]
        friction += ratio[0] * normal[n]
        friction += ratio[n] * normal[0]
        share = 1.0 / ((n + 1) * (n + 2))
        force_x += xx * wx[n] + xy * wy[n] + friction
        force_y += yx * wx[n] + yy * wy[n]
        wx[n + 2] = share * (force_x - dx * (n + 1) * wx[n + 1])
        wy[n + 2] = share * (force_y - dy * (n + 1) * wy[n + 1])
        if n + 2 >= _FIRST_ENDING and not bends and max(abs(wx[n + 2]), abs(wy[n + 2])) <= limit:
            return n + 2, taken
    return order, taken


@inlined_kernel
def _bend(n: int, slip: float, ratio: Vector, v_reg: float, h: float, w: Vector) -> None:
    """Order n of tanh(s/V_reg), and of the ratio, where `ratio` holds that of alpha + beta s."""
    tanh, sech, s, coefficient = w[TANH], w[SECH2], w[SLIP], w[_COEFFICIENT]
    coefficient[n] = ratio[n]
    if n == 0:
        s[0] = slip / v_reg
        tanh[0] = math.tanh(s[0])
        sech[0] = 1.0 / math.cosh(s[0]) ** 2
    else:
        s[n] = -(n + 1) * w[X, n + 1] / (h * v_reg)
        total = 0.0
        for j in range(1, n + 1):
            total += j * s[j] * sech[n - j]
        tanh[n] = total / n
        square = 0.0
        for j in range(n + 1):
            square += tanh[j] * tanh[n - j]
        sech[n] = -square
    total = 0.0
    for j in range(n + 1):
        total += coefficient[j] * tanh[n - j]
    ratio[n] = total
