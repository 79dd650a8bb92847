"""The pad's path as a Taylor series on a belt whose friction sees the slip, where the arms' rotation is small.

As `series`, with all that its length allows made short, since a step of the engine in contact needs one: the arms are
linear about the start of the step but for the polynomial g of `propagator`, and far from zero slip tanh is +-1 to
rounding and friction costs one product an order.

With d = r - r_0 the arms' force per mass is exactly, as g is a cubic polynomial,

    f(r_0) + J d + (a + c_1 d_x + c_2 d_y) d_x^2 + b d_x d_y + (e + c_3 d_x + c_4 d_y) d_y^2

for either axis: J and the second derivatives at r_0, c the coefficients of g's cubic terms. With s = V - vx friction is
(alpha + beta s) tanh(s/V_reg) N, as in `forces`. Coefficients are scaled by the step, products go by Cauchy's rule,
T = tanh from T' = (1 - T^2) s', as in `series`. All of it is written out order by order: loops over so few terms take
twice the time.

The arms' terms of degree 2 in d are kept up to order 10 of the force, those of degree 3 up to order 7. At rate times
step 0.65, four steps of the engine, the next ones are below (2 0.65)^11/11! and (3 0.65)^8/8! of 5e-5 and 4e-8 of the
displacement at the end of the near range, over n^2 as the force is integrated twice: 2e-13 and 2e-12, and a tenth of
that in squeal.
"""

from __future__ import annotations

import math

from squeal_rig.model.core.kernel import fused_kernel
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
from squeal_rig.model.motion.series import COEFFICIENT, SECH2, SLIP, TANH, X, Y

#: A series ends where its last term is so small a share of the path: what is left out is less by rate times step over
#: the order, rounding.
LAST_TERM = 128.0 * 2.220446049250313e-16
#: |s|/V_reg from which on 1 - |tanh| is below rounding, and where a step may start that takes it so.
SATURATED, SAFELY_SATURATED = 19.1, 22.0
#: How tanh was taken.
AS_IT_IS, AS_ONE, ABSENT = range(3)


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
        order: of the path at most, 14 or 16.
        w: workspace. Rows SLIP (s over V_reg), TANH, SECH2, COEFFICIENT are filled only where tanh is not saturated.

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
    wx, wy = w[X], w[Y]
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
    slip_step = -1.0 / (h * q[V_REG]) if bends else 0.0
    # Of each order: the path x, y; its products s = xx, t = xy, u = yy, and theirs with x and y; normal force p and
    # ratio r. What is known from lower orders stands first: nothing of the last order has to be waited for.
    x1, y1 = h * state[2], h * state[3]
    p0, r0 = normal_step * (y0 - q[L_PRE]), alpha + beta * slip
    if bends:
        r0 = _bend(0, r0, slip / q[V_REG], w)
    x2 = 0.5 * (fx + r0 * p0 - dx * x1)
    y2 = 0.5 * (fy - dy * y1)
    wx[0], wx[1], wx[2], wy[0], wy[1], wy[2] = x0, x1, x2, y0, y1, y2
    limit = LAST_TERM * max(abs(x0), abs(y0), abs(x1), abs(y1), abs(x2), abs(y2))
    p1, r1 = normal_step * y1, ratio_step * (2.0 * x2)
    if bends:
        r1 = _bend(1, r1, slip_step * (2.0 * x2), w)
    x3 = (1.0 / 6.0) * ((xx * x1 + xy * y1 + r0 * p1) + (r1 * p0 - dx * (2.0 * x2)))
    y3 = (1.0 / 6.0) * ((yx * x1 + yy * y1) - dy * (2.0 * y2))
    wx[3], wy[3] = x3, y3
    p2, r2 = normal_step * y2, ratio_step * (3.0 * x3)
    if bends:
        r2 = _bend(2, r2, slip_step * (3.0 * x3), w)
    s2, t2, u2 = x1 * x1, x1 * y1, y1 * y1
    force_x = ax * s2 + bx * t2 + cx * u2
    force_y = ay * s2 + by * t2 + cy * u2
    force_x += r1 * p1
    x4 = (1.0 / 12.0) * (force_x + (xx * x2 + xy * y2 + r0 * p2) + (r2 * p0 - dx * (3.0 * x3)))
    y4 = (1.0 / 12.0) * (force_y + (yx * x2 + yy * y2) - dy * (3.0 * y3))
    wx[4], wy[4] = x4, y4
    p3, r3 = normal_step * y3, ratio_step * (4.0 * x4)
    if bends:
        r3 = _bend(3, r3, slip_step * (4.0 * x4), w)
    s3, t3, u3 = 2.0 * x1 * x2, x1 * y2 + x2 * y1, 2.0 * y1 * y2
    sx, sy, ux, uy = s2 * x1, s2 * y1, u2 * x1, u2 * y1
    force_x = ax * s3 + bx * t3 + cx * u3
    force_y = ay * s3 + by * t3 + cy * u3
    force_x += gx3 * sx + gx4 * sy + gx5 * ux + gx6 * uy
    force_y += gy3 * sx + gy4 * sy + gy5 * ux + gy6 * uy
    force_x += r1 * p2 + r2 * p1
    x5 = (1.0 / 20.0) * (force_x + (xx * x3 + xy * y3 + r0 * p3) + (r3 * p0 - dx * (4.0 * x4)))
    y5 = (1.0 / 20.0) * (force_y + (yx * x3 + yy * y3) - dy * (4.0 * y4))
    wx[5], wy[5] = x5, y5
    p4, r4 = normal_step * y4, ratio_step * (5.0 * x5)
    if bends:
        r4 = _bend(4, r4, slip_step * (5.0 * x5), w)
    s4, u4 = 2.0 * x1 * x3 + x2 * x2, 2.0 * y1 * y3 + y2 * y2
    t4 = x1 * y3 + x2 * y2 + x3 * y1
    sx, sy, ux, uy = s2 * x2 + s3 * x1, s2 * y2 + s3 * y1, u2 * x2 + u3 * x1, u2 * y2 + u3 * y1
    force_x = ax * s4 + bx * t4 + cx * u4
    force_y = ay * s4 + by * t4 + cy * u4
    force_x += gx3 * sx + gx4 * sy + gx5 * ux + gx6 * uy
    force_y += gy3 * sx + gy4 * sy + gy5 * ux + gy6 * uy
    force_x += r1 * p3 + r2 * p2 + r3 * p1
    x6 = (1.0 / 30.0) * (force_x + (xx * x4 + xy * y4 + r0 * p4) + (r4 * p0 - dx * (5.0 * x5)))
    y6 = (1.0 / 30.0) * (force_y + (yx * x4 + yy * y4) - dy * (5.0 * y5))
    wx[6], wy[6] = x6, y6
    p5, r5 = normal_step * y5, ratio_step * (6.0 * x6)
    if bends:
        r5 = _bend(5, r5, slip_step * (6.0 * x6), w)
    s5, u5 = 2.0 * (x1 * x4 + x2 * x3), 2.0 * (y1 * y4 + y2 * y3)
    t5 = (x1 * y4 + x2 * y3) + (x3 * y2 + x4 * y1)
    sx, sy = s2 * x3 + s3 * x2 + s4 * x1, s2 * y3 + s3 * y2 + s4 * y1
    ux, uy = u2 * x3 + u3 * x2 + u4 * x1, u2 * y3 + u3 * y2 + u4 * y1
    force_x = ax * s5 + bx * t5 + cx * u5
    force_y = ay * s5 + by * t5 + cy * u5
    force_x += gx3 * sx + gx4 * sy + gx5 * ux + gx6 * uy
    force_y += gy3 * sx + gy4 * sy + gy5 * ux + gy6 * uy
    force_x += (r1 * p4 + r2 * p3) + (r3 * p2 + r4 * p1)
    x7 = (1.0 / 42.0) * (force_x + (xx * x5 + xy * y5 + r0 * p5) + (r5 * p0 - dx * (6.0 * x6)))
    y7 = (1.0 / 42.0) * (force_y + (yx * x5 + yy * y5) - dy * (6.0 * y6))
    wx[7], wy[7] = x7, y7
    p6, r6 = normal_step * y6, ratio_step * (7.0 * x7)
    if bends:
        r6 = _bend(6, r6, slip_step * (7.0 * x7), w)
    s6 = 2.0 * (x1 * x5 + x2 * x4) + x3 * x3
    t6 = (x1 * y5 + x2 * y4) + (x3 * y3 + x4 * y2 + x5 * y1)
    u6 = 2.0 * (y1 * y5 + y2 * y4) + y3 * y3
    sx, sy = (s2 * x4 + s3 * x3) + (s4 * x2 + s5 * x1), (s2 * y4 + s3 * y3) + (s4 * y2 + s5 * y1)
    ux, uy = (u2 * x4 + u3 * x3) + (u4 * x2 + u5 * x1), (u2 * y4 + u3 * y3) + (u4 * y2 + u5 * y1)
    force_x = ax * s6 + bx * t6 + cx * u6
    force_y = ay * s6 + by * t6 + cy * u6
    force_x += gx3 * sx + gx4 * sy + gx5 * ux + gx6 * uy
    force_y += gy3 * sx + gy4 * sy + gy5 * ux + gy6 * uy
    force_x += (r1 * p5 + r2 * p4) + (r3 * p3 + r4 * p2 + r5 * p1)
    x8 = (1.0 / 56.0) * (force_x + (xx * x6 + xy * y6 + r0 * p6) + (r6 * p0 - dx * (7.0 * x7)))
    y8 = (1.0 / 56.0) * (force_y + (yx * x6 + yy * y6) - dy * (7.0 * y7))
    wx[8], wy[8] = x8, y8
    p7, r7 = normal_step * y7, ratio_step * (8.0 * x8)
    if bends:
        r7 = _bend(7, r7, slip_step * (8.0 * x8), w)
    s7 = 2.0 * (x1 * x6 + x2 * x5 + x3 * x4)
    t7 = (x1 * y6 + x2 * y5 + x3 * y4) + (x4 * y3 + x5 * y2 + x6 * y1)
    u7 = 2.0 * (y1 * y6 + y2 * y5 + y3 * y4)
    sx, sy = (s2 * x5 + s3 * x4) + (s4 * x3 + s5 * x2 + s6 * x1), (s2 * y5 + s3 * y4) + (s4 * y3 + s5 * y2 + s6 * y1)
    ux, uy = (u2 * x5 + u3 * x4) + (u4 * x3 + u5 * x2 + u6 * x1), (u2 * y5 + u3 * y4) + (u4 * y3 + u5 * y2 + u6 * y1)
    force_x = ax * s7 + bx * t7 + cx * u7
    force_y = ay * s7 + by * t7 + cy * u7
    force_x += gx3 * sx + gx4 * sy + gx5 * ux + gx6 * uy
    force_y += gy3 * sx + gy4 * sy + gy5 * ux + gy6 * uy
    force_x += (r1 * p6 + r2 * p5 + r3 * p4) + (r4 * p3 + r5 * p2 + r6 * p1)
    x9 = (1.0 / 72.0) * (force_x + (xx * x7 + xy * y7 + r0 * p7) + (r7 * p0 - dx * (8.0 * x8)))
    y9 = (1.0 / 72.0) * (force_y + (yx * x7 + yy * y7) - dy * (8.0 * y8))
    wx[9], wy[9] = x9, y9
    if not bends and max(abs(x9), abs(y9)) <= limit:
        return 9, taken
    p8, r8 = normal_step * y8, ratio_step * (9.0 * x9)
    if bends:
        r8 = _bend(8, r8, slip_step * (9.0 * x9), w)
    s8 = 2.0 * (x1 * x7 + x2 * x6 + x3 * x5) + x4 * x4
    t8 = (x1 * y7 + x2 * y6 + x3 * y5) + (x4 * y4 + x5 * y3 + x6 * y2 + x7 * y1)
    u8 = 2.0 * (y1 * y7 + y2 * y6 + y3 * y5) + y4 * y4
    force_x = ax * s8 + bx * t8 + cx * u8
    force_y = ay * s8 + by * t8 + cy * u8
    force_x += (r1 * p7 + r2 * p6 + r3 * p5) + (r4 * p4 + r5 * p3 + r6 * p2 + r7 * p1)
    x10 = (1.0 / 90.0) * (force_x + (xx * x8 + xy * y8 + r0 * p8) + (r8 * p0 - dx * (9.0 * x9)))
    y10 = (1.0 / 90.0) * (force_y + (yx * x8 + yy * y8) - dy * (9.0 * y9))
    wx[10], wy[10] = x10, y10
    if not bends and max(abs(x10), abs(y10)) <= limit:
        return 10, taken
    p9, r9 = normal_step * y9, ratio_step * (10.0 * x10)
    if bends:
        r9 = _bend(9, r9, slip_step * (10.0 * x10), w)
    s9 = 2.0 * (x1 * x8 + x2 * x7 + x3 * x6 + x4 * x5)
    t9 = (x1 * y8 + x2 * y7 + x3 * y6 + x4 * y5) + (x5 * y4 + x6 * y3 + x7 * y2 + x8 * y1)
    u9 = 2.0 * (y1 * y8 + y2 * y7 + y3 * y6 + y4 * y5)
    force_x = ax * s9 + bx * t9 + cx * u9
    force_y = ay * s9 + by * t9 + cy * u9
    force_x += (r1 * p8 + r2 * p7 + r3 * p6 + r4 * p5) + (r5 * p4 + r6 * p3 + r7 * p2 + r8 * p1)
    x11 = (1.0 / 110.0) * (force_x + (xx * x9 + xy * y9 + r0 * p9) + (r9 * p0 - dx * (10.0 * x10)))
    y11 = (1.0 / 110.0) * (force_y + (yx * x9 + yy * y9) - dy * (10.0 * y10))
    wx[11], wy[11] = x11, y11
    if not bends and max(abs(x11), abs(y11)) <= limit:
        return 11, taken
    p10, r10 = normal_step * y10, ratio_step * (11.0 * x11)
    if bends:
        r10 = _bend(10, r10, slip_step * (11.0 * x11), w)
    s10 = 2.0 * (x1 * x9 + x2 * x8 + x3 * x7 + x4 * x6) + x5 * x5
    t10 = (x1 * y9 + x2 * y8 + x3 * y7 + x4 * y6) + (x5 * y5 + x6 * y4 + x7 * y3 + x8 * y2 + x9 * y1)
    u10 = 2.0 * (y1 * y9 + y2 * y8 + y3 * y7 + y4 * y6) + y5 * y5
    force_x = ax * s10 + bx * t10 + cx * u10
    force_y = ay * s10 + by * t10 + cy * u10
    force_x += (r1 * p9 + r2 * p8 + r3 * p7 + r4 * p6) + (r5 * p5 + r6 * p4 + r7 * p3 + r8 * p2)
    force_x += r9 * p1
    x12 = (1.0 / 132.0) * (force_x + (xx * x10 + xy * y10 + r0 * p10) + (r10 * p0 - dx * (11.0 * x11)))
    y12 = (1.0 / 132.0) * (force_y + (yx * x10 + yy * y10) - dy * (11.0 * y11))
    wx[12], wy[12] = x12, y12
    if not bends and max(abs(x12), abs(y12)) <= limit:
        return 12, taken
    p11, r11 = normal_step * y11, ratio_step * (12.0 * x12)
    if bends:
        r11 = _bend(11, r11, slip_step * (12.0 * x12), w)
    force_x = (r1 * p10 + r2 * p9 + r3 * p8 + r4 * p7) + (r5 * p6 + r6 * p5 + r7 * p4 + r8 * p3)
    force_x += r9 * p2 + r10 * p1
    x13 = (1.0 / 156.0) * (force_x + (xx * x11 + xy * y11 + r0 * p11) + (r11 * p0 - dx * (12.0 * x12)))
    y13 = (1.0 / 156.0) * ((yx * x11 + yy * y11) - dy * (12.0 * y12))
    wx[13], wy[13] = x13, y13
    if not bends and max(abs(x13), abs(y13)) <= limit:
        return 13, taken
    p12, r12 = normal_step * y12, ratio_step * (13.0 * x13)
    if bends:
        r12 = _bend(12, r12, slip_step * (13.0 * x13), w)
    force_x = (r1 * p11 + r2 * p10 + r3 * p9 + r4 * p8) + (r5 * p7 + r6 * p6 + r7 * p5 + r8 * p4)
    force_x += r9 * p3 + r10 * p2 + r11 * p1
    x14 = (1.0 / 182.0) * (force_x + (xx * x12 + xy * y12 + r0 * p12) + (r12 * p0 - dx * (13.0 * x13)))
    y14 = (1.0 / 182.0) * ((yx * x12 + yy * y12) - dy * (13.0 * y13))
    wx[14], wy[14] = x14, y14
    if order < 15 or (not bends and max(abs(x14), abs(y14)) <= limit):
        return 14, taken
    p13, r13 = normal_step * y13, ratio_step * (14.0 * x14)
    if bends:
        r13 = _bend(13, r13, slip_step * (14.0 * x14), w)
    force_x = (r1 * p12 + r2 * p11 + r3 * p10 + r4 * p9) + (r5 * p8 + r6 * p7 + r7 * p6 + r8 * p5)
    force_x += (r9 * p4 + r10 * p3) + (r11 * p2 + r12 * p1)
    x15 = (1.0 / 210.0) * (force_x + (xx * x13 + xy * y13 + r0 * p13) + (r13 * p0 - dx * (14.0 * x14)))
    y15 = (1.0 / 210.0) * ((yx * x13 + yy * y13) - dy * (14.0 * y14))
    wx[15], wy[15] = x15, y15
    if not bends and max(abs(x15), abs(y15)) <= limit:
        return 15, taken
    p14, r14 = normal_step * y14, ratio_step * (15.0 * x15)
    if bends:
        r14 = _bend(14, r14, slip_step * (15.0 * x15), w)
    force_x = (r1 * p13 + r2 * p12 + r3 * p11 + r4 * p10) + (r5 * p9 + r6 * p8 + r7 * p7 + r8 * p6)
    force_x += (r9 * p5 + r10 * p4) + (r11 * p3 + r12 * p2 + r13 * p1)
    x16 = (1.0 / 240.0) * (force_x + (xx * x14 + xy * y14 + r0 * p14) + (r14 * p0 - dx * (15.0 * x15)))
    y16 = (1.0 / 240.0) * ((yx * x14 + yy * y14) - dy * (15.0 * y15))
    wx[16], wy[16] = x16, y16
    return 16, taken


@fused_kernel
def _bend(n: int, coefficient_n: float, slip_n: float, w: Vector) -> float:
    """Order n of the ratio (alpha + beta s) tanh(s/V_reg), from that of alpha + beta s and that of s/V_reg.

    Rows COEFFICIENT, SLIP, TANH and SECH2 of the workspace hold the lower orders, and get this one.
    """
    tanh, sech, s, coefficient = w[TANH], w[SECH2], w[SLIP], w[COEFFICIENT]
    coefficient[n], s[n] = coefficient_n, slip_n
    if n == 0:
        tanh[0] = math.tanh(slip_n)
        sech[0] = 1.0 / math.cosh(slip_n) ** 2
    else:
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
    return total
