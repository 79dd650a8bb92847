"""The flow of Eq. (2.3) over one to four steps, in contact and off the belt, as polynomials of the state.

With z = (x, y, vx, vy) and the mode's linear part split off, Eq. (2.3) reads z' = A z + b + B g(r):

    A = [[0, I], [-K/m, -C/m]]   K of Eq. (3.2) about r = 0 (without the contact terms off the belt)
    b = (0, 0, load + contact pretension)/m        g(r): what the arms' rotation adds to their linear force, per mass

and variation of constants gives, exactly,

    z(h) = e^{Ah} z(0) + int_0^h e^{As} b ds + int_0^h e^{A(h-s)} B g(r(s)) ds.                                  (P)

In the last term r(s) is the linear path (one Picard sweep), which is linear in z(0), and g a polynomial of degree 3: so
z(h) is a polynomial of degree 3 in z(0). Its coefficients are computed here once per set of parameters, the integral by
three Gauss-Legendre nodes; those of 2 to 4 steps by putting the map into itself.

The arm's force in powers of r/L follows from the generating function of the Legendre polynomials P_n:
L/l - 1 = sum_n (r/L)^n P_n(cos psi), psi the angle between r and the arm's axis n, so the force k (L/l - 1)(r - a)
has at order n >= 2 the part k L (r/L)^n [P_{n-1} r/|r| - P_n n], never longer than 2 k L (r/L)^n. `g` keeps orders
2 and 3.

Error of one step, relative to r, with theta = h^2 sum k_i/(m L_i) r:
- orders 4 and up:       h^2/2 sum 2 k_i/m (r/L_i)^3
- one Picard sweep:      |P_1 r/|r| - P_2 n|^2 = sin^2 psi (1 + 3 cos^2 psi)/4 <= 1/3, so |g_2| <= 0.58 sum k_i/(m L_i)
  r^2 moves the path by 0.29 theta r at most; g_2 is the gradient of a cubic form, so |dg_2/dr| <= 2 max|g_2|/r, which
  acts on that for a mean of h^2/12: 0.03 theta^2
- Gauss-Legendre, 3 nodes: h^7/2016000 times a sixth derivative, (3 omega h)^6/2e6 theta <= 1e-7 theta
- composition:           of n steps the quadratic part is at most 0.29 n^2 theta r, the cubic one 0.25 n^2 theta r^2/L;
  dropped are products of the two and quadratic parts of quadratic parts: 4 theta^2 r/L + 3 theta^3 at n = 3
Up to r = `NEAR` the first is half of `NEAR_ERROR`, theta^2 at most `NEAR_ERROR` and r/L 0.01: together less than
`NEAR_ERROR`. Beyond it the engine takes Taylor steps of the full nonlinear equations (`series`). The
bound is a worst case: at the preset a step loses below 1e-13.
"""

from __future__ import annotations

import math

import numpy as np

from squeal_rig.model.core.kernel import kernel
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
    Vector,
)
from squeal_rig.model.motion.cubic import TERMS, compose, multiply_linear

#: Largest error of one step by propagators, as a share of the displacement (the bound above).
NEAR_ERROR = 1e-11
#: Largest product of the mode's fastest rate and the step: the Taylor series of the path then end in rounding at
#: order 11.
RATE_TIMES_STEP = 0.25

#: Samples that one evaluation of the maps reaches.
AHEAD = 4
# Layout: the maps of one mode, (35, 16) row by row: coefficients of cubic.py by x, y, vx, vy after 1 to 4 steps.
IN_CONTACT, OFF_BELT = 0, 560
# Limits of a step, in contact and off the belt: |y''| in it is at most BOUND . (1, |x|, |y|, |vx|, |vy|), and y leaves
# its chord by no more than TUBE where both ends are in the near range.
CONTACT_LIMITS, OFF_BELT_LIMITS = 1120, 1126
BOUND, TUBE = 0, 5
# What both modes share.
GX, GY = 1132, 1139  # coefficients of xx, xy, yy, xxx, xxy, xyy, yyy in g
NEAR, STEP, K_AA, K_AB, K_BB = 1146, 1147, 1148, 1149, 1150  # stiffness of arms and clips per mass
# What goes on from block to block, and is worth nothing under other parameters: the maps' last values, the states after
# the next four steps; where the first not yet passed begins, ALL_PASSED where there is none; and steps taken, modulo 4.
PATH, PASSED, STEPS = 1152, 1168, 1169
ALL_PASSED = 16
# What the path was made by: the maps, or one Taylor series, of which y leaves its chords by no more than PATH_TUBE.
KIND, PATH_TUBE = 1170, 1171
MAPS, SERIES = 0.0, 1.0
FLOW_SIZE = 1172

_TERMS = 16
_ROOT = math.sqrt(0.6)
_NODE_1, _NODE_2, _NODE_3 = 0.5 - 0.5 * _ROOT, 0.5, 0.5 + 0.5 * _ROOT


@kernel
def fastest_rate(q: Vector) -> float:
    """Upper bound of |lambda| [rad/s] of both modes: any lambda^2 = -(c lambda + k)/m lies below it."""
    c1, s1 = q[A1X] / q[L1], q[A1Y] / q[L1]
    c2, s2 = q[A2X] / q[L2], q[A2Y] / q[L2]
    k_ab = q[K1] * s1 * c1 + q[K2] * s2 * c2
    row_x = q[K1] * c1 * c1 + q[K2] * c2 * c2 + q[K34] + abs(k_ab) + abs(q[MU]) * q[K_C]
    row_y = q[K1] * s1 * s1 + q[K2] * s2 * s2 + q[K_C] + abs(k_ab)
    return float(max(q[C_X], q[C_Y]) / q[MASS] + math.sqrt(max(row_x, row_y) / q[MASS]))


@kernel
def substeps_needed(q: Vector, interval: float, longest: float) -> int:
    """Steps per output interval [s] that keep rate times step below its bound and each step below `longest` [s]."""
    share = max(interval * fastest_rate(q) / RATE_TIMES_STEP, interval / longest)
    return max(1, math.ceil(min(share, 1e9) * (1.0 - 1e-12)))


@kernel
def propagators(q: Vector, h: float, flow: Vector) -> None:
    """Fill `flow` (`FLOW_SIZE`,) for the packed parameters `q` and the step h [s]."""
    flow[PASSED], flow[STEPS], flow[KIND] = ALL_PASSED, 0.0, MAPS
    _shared(q, h, flow)
    for contact in (True, False):
        _mode(q, h, contact, flow)


@kernel
def _shared(q: Vector, h: float, flow: Vector) -> None:
    """Arm stiffness, the polynomial g and the range in which it holds."""
    flow[GX : GX + 14] = 0.0
    flow[K_AA], flow[K_AB], flow[K_BB] = q[K34] / q[MASS], 0.0, 0.0
    linear, cubic = 0.0, 0.0
    for stiffness, length, ax, ay in ((q[K1], q[L1], q[A1X], q[A1Y]), (q[K2], q[L2], q[A2X], q[A2Y])):
        k = stiffness / q[MASS]
        c, s = ax / length, ay / length
        flow[K_AA] += k * c * c
        flow[K_AB] += k * c * s
        flow[K_BB] += k * s * s
        _arm_polynomial(k / length, k / length**2, c, s, flow[GX : GX + 7])
        _arm_polynomial(k / length, k / length**2, s, c, flow[GY : GY + 7])
        linear += h * h * k / length
        cubic += h * h * k / length**3
    # The polynomials of g_y were made with x and y exchanged: put them in the order of x.
    for a, b in ((0, 2), (3, 6), (4, 5)):
        flow[GY + a], flow[GY + b] = flow[GY + b], flow[GY + a]
    near = 0.01 * min(q[L1], q[L2])
    if linear > 0.0:
        near = min(near, math.sqrt(NEAR_ERROR) / linear, (0.5 * NEAR_ERROR / cubic) ** (1.0 / 3.0))
    flow[NEAR], flow[STEP] = near, h


@kernel
def _arm_polynomial(second: float, third: float, c: float, s: float, out: Vector) -> None:
    """Add one arm's orders 2 and 3 of g along an axis with direction cosine c: the coefficients of its monomials."""
    out[0] += second * 1.5 * c * s * s
    out[1] += second * s * (1.0 - 3.0 * c * c)
    out[2] += second * c * (1.0 - 3.0 * s * s) / 2.0
    out[3] += third * (-2.5 * c**4 + 3.0 * c * c - 0.5)
    out[4] += third * c * s * (4.5 - 7.5 * c * c)
    out[5] += third * (1.0 - 7.5 * c * c * s * s)
    out[6] += third * c * s * (1.5 - 2.5 * s * s)


@kernel
def _mode(q: Vector, h: float, contact: bool, flow: Vector) -> None:
    """Maps and limits of one mode: one step by (P), the others by composition."""
    m = q[MASS]
    a, b = np.zeros((4, 4)), np.zeros(4)
    a[0, 2] = a[1, 3] = 1.0
    a[2, 0], a[2, 1], a[3, 0], a[3, 1] = -flow[K_AA], -flow[K_AB], -flow[K_AB], -flow[K_BB]
    a[2, 2], a[3, 3] = -q[C_X] / m, -q[C_Y] / m
    b[2], b[3] = q[LOAD_X] / m, q[LOAD_Y] / m
    if contact:
        a[2, 1] -= q[MU] * q[K_C] / m
        a[3, 1] -= q[K_C] / m
        b[2] += q[MU] * q[K_C] * q[L_PRE] / m
        b[3] += q[K_C] * q[L_PRE] / m
    maps, room = np.empty((AHEAD, 4, TERMS)), np.empty((7, TERMS))
    _one_step(a, b, h, flow[GX : GX + 7], flow[GY : GY + 7], maps[0], room)
    for n in range(1, AHEAD):
        compose(maps[0], maps[n - 1], maps[n], room)
    o = IN_CONTACT if contact else OFF_BELT
    for t in range(TERMS):
        for n in range(AHEAD):
            for i in range(4):
                flow[o + 4 * AHEAD * t + 4 * n + i] = maps[n, i, t]
    o = CONTACT_LIMITS if contact else OFF_BELT_LIMITS
    _acceleration_bound(q, a, b, h, flow[o + BOUND : o + BOUND + 5], flow[NEAR])
    flow[o + TUBE] = _tube(a, b, q, h, flow[NEAR])


@kernel
def _one_step(a: Vector, b: Vector, h: float, gx: Vector, gy: Vector, out: Vector, room: Vector) -> None:
    """Equation (P) as four polynomials of degree 3 in z(0), `out` (4, 35); `room` (7, 35)."""
    out[:] = 0.0
    whole, drift = _exponential(a, b, h)
    out[:, 0] = drift
    out[:, 1:5] = whole
    shares = (5.0 / 18.0, 8.0 / 18.0, 5.0 / 18.0)
    for n, node in enumerate((_NODE_1, _NODE_2, _NODE_3)):
        part, drift = _exponential(a, b, node * h)
        rest, _ = _exponential(a, b, (1.0 - node) * h)
        room[:] = 0.0
        for i in range(2):
            room[i, 0] = drift[i]
            room[i, 1:5] = part[i]
        multiply_linear(room[0], room[0], room[2])
        multiply_linear(room[0], room[1], room[3])
        multiply_linear(room[1], room[1], room[4])
        for axis, c in enumerate((gx, gy)):
            _add_monomials(c, room)
            for i in range(4):
                out[i] += shares[n] * h * rest[i, 2 + axis] * room[6]


@kernel
def _add_monomials(c: Vector, room: Vector) -> None:
    """g of the polynomials x, y, xx, xy, yy in `room[:5]` into `room[6]`."""
    x, y, xx, xy, yy, factor, g = room
    g[:] = c[0] * xx + c[1] * xy + c[2] * yy
    for square, along_x, along_y in ((xx, c[3], c[4]), (yy, c[5], c[6])):
        factor_of = along_x * x + along_y * y
        multiply_linear(factor_of, square, factor)
        g += factor


@kernel
def _exponential(a: Vector, b: Vector, h: float) -> tuple[Vector, Vector]:
    """e^{Ah} (4, 4) and int_0^h e^{As} b ds (4,)."""
    term = np.eye(4)
    whole = np.eye(4)
    drift = h * b
    for n in range(1, _TERMS + 1):
        following = np.zeros((4, 4))
        for i in range(4):
            for j in range(4):
                value = 0.0
                for k in range(4):
                    value += a[i, k] * term[k, j]
                following[i, j] = value * h / n
        term = following
        for i in range(4):
            for j in range(4):
                whole[i, j] += term[i, j]
                drift[i] += term[i, j] * b[j] * h / (n + 1)
    return whole, drift


@kernel
def _acceleration_bound(q: Vector, a: Vector, b: Vector, h: float, out: Vector, near: float) -> None:
    """Bound of |y''| within a step that starts at z: |e^{As}| <= e^{|A|h} entry by entry, so nothing escapes it.

    The part of g is at most 2 sum k_i/m near^2/L_i; 5 % cover its own effect on the path.
    """
    whole, drift = _exponential(np.abs(a), np.abs(b), h)
    out[:] = 0.0
    out[0] = abs(b[3]) + 2.0 * (q[K1] / q[L1] + q[K2] / q[L2]) / q[MASS] * near * near
    for k in range(4):
        out[0] += abs(a[3, k]) * drift[k]
        for j in range(4):
            out[1 + j] += abs(a[3, k]) * whole[k, j]
    for j in range(5):
        out[j] *= 1.05


@kernel
def _tube(a: Vector, b: Vector, q: Vector, h: float, near: float) -> float:
    """h^2/8 max|r''| of a step with both ends within `near`.

    With p = max|r''|: |r| <= near + h^2/8 p and |v| <= 2 near/h + h p in the step, so p <= k |r| + c |v| + |b| + |g|
    is an upper bound of p in terms of p itself; rate times step <= 0.25 keeps its factor below 0.26.
    """
    k = max(abs(a[2, 0]) + abs(a[2, 1]), abs(a[3, 0]) + abs(a[3, 1]))
    c = max(abs(a[2, 2]), abs(a[3, 3]))
    rest = max(abs(b[2]), abs(b[3])) + 2.0 * (q[K1] / q[L1] + q[K2] / q[L2]) / q[MASS] * near * near
    own = 0.125 * h * h * k + h * c
    if not own < 1.0:
        return math.inf
    return float(0.125 * h * h * 1.05 * ((k + 2.0 * c / h) * near + rest) / (1.0 - own))
