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

from squeal_rig.model.core.kernel import fused_kernel, inlined_kernel, kernel
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
from squeal_rig.model.motion.cubic import TERMS, add_product_linear, monomials, multiply_linear, substitute

#: Largest error of one step by propagators, as a share of the displacement (the bound above).
NEAR_ERROR = 1e-11
#: Largest product of the mode's fastest rate and the step: the Taylor series of the path then end in rounding at
#: order 11.
RATE_TIMES_STEP = 0.25

#: Samples that one evaluation of the maps reaches.
AHEAD = 4
# Layout: the maps of one mode, (35, 16) row by row: coefficients of cubic.py by x, y, vx, vy after 4, 1, 2 and 3 steps.
# The last first: the next evaluation starts from it, and the processor begins that while it computes the others.
IN_CONTACT, OFF_BELT = 0, 560
# Limits of a step, in contact and off the belt: |y''| in it is at most BOUND . (1, |x|, |y|, |vx|, |vy|), and y leaves
# its chord by no more than TUBE where both ends are in the near range.
CONTACT_LIMITS, OFF_BELT_LIMITS = 1120, 1126
BOUND, TUBE = 0, 5
# What both modes share.
GX, GY = 1132, 1139  # coefficients of xx, xy, yy, xxx, xxy, xyy, yyy in g
NEAR, STEP, K_AA, K_AB, K_BB = 1146, 1147, 1148, 1149, 1150  # stiffness of arms and clips per mass
# What goes on from block to block, and is worth nothing under other parameters: the maps' last values, the states after
# the next four steps in the maps' order (`place_in_path`); how many of its numbers are passed, in order of time,
# ALL_PASSED where nothing is left; and steps taken, modulo 4.
PATH, PASSED, STEPS = 1152, 1168, 1169
ALL_PASSED = 16
# What the path was made by: the maps, or one Taylor series, of which y leaves its chords by no more than PATH_TUBE.
KIND, PATH_TUBE = 1170, 1171
MAPS, SERIES = 0.0, 1.0
# Room for making the maps: A and b of a mode; e^{Ah} and the integral of e^{As} b for four steps; polynomials.
_A, _B, _EXPONENTIALS, _TERM, _ROOM, _MAPS, _MONOMIALS = 1176, 1192, 1200, 1300, 1336, 1584, 2144
FLOW_SIZE = _MONOMIALS + TERMS * TERMS

_TERMS = 16
_ROOT = math.sqrt(0.6)
# Gauss-Legendre nodes, of which n and 2 - n together are one step; the whole step; and that of |A| and |b|.
_SHARES = np.array([0.5 - 0.5 * _ROOT, 0.5, 0.5 + 0.5 * _ROOT, 1.0, 1.0])
_POWERS, _BY_SIZE = 5, 4
_WEIGHTS = np.array([5.0 / 18.0, 8.0 / 18.0, 5.0 / 18.0])
_EXPONENTIAL = 20  # numbers in one: the matrix, then the integral


@inlined_kernel
def place_in_path(passed: int) -> int:
    """Where in the path the next state begins once `passed` numbers of it are passed: the last state stands first."""
    return (passed + 4) & (ALL_PASSED - 1)


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


@fused_kernel
def propagators(q: Vector, h: float, flow: Vector) -> None:
    """Fill `flow` (`FLOW_SIZE`,) for the packed parameters `q` and the step h [s]: of each mode the map of one step by
    (P), the others by composition, and the limits.

    Made of calls alone, over plain loops on one vector: `make_propagators` rests on the first, and loops without arrays
    of their own compile several times as fast.
    """
    _shared(q, h, flow)
    for mode in range(2):
        _linear_part(q, mode, flow)
        for n in range(_POWERS):
            _exponential(h, n, flow)
        _one_step(h, flow)
        _more_steps(flow)
        _file_maps(mode, flow)
        _limits(q, h, mode, flow)


def make_propagators(q: Vector, h: float, flow: Vector) -> None:
    """`propagators` run by the interpreter, what it calls compiled: as fast but for 0.02 ms, and soon ready to run."""
    getattr(propagators, "py_func", propagators)(q, h, flow)


@fused_kernel
def _shared(q: Vector, h: float, flow: Vector) -> None:
    """Arm stiffness, the polynomial g and the range in which it holds; no path is left."""
    flow[PASSED], flow[STEPS], flow[KIND] = ALL_PASSED, 0.0, MAPS
    for n in range(14):
        flow[GX + n] = 0.0
    flow[K_AA], flow[K_AB], flow[K_BB] = q[K34] / q[MASS], 0.0, 0.0
    linear, cubic = 0.0, 0.0
    for arm in range(2):
        first, second = arm == 0, arm != 0
        length = q[L1] * first + q[L2] * second
        k = (q[K1] * first + q[K2] * second) / q[MASS]
        c, s = (q[A1X] * first + q[A2X] * second) / length, (q[A1Y] * first + q[A2Y] * second) / length
        flow[K_AA] += k * c * c
        flow[K_AB] += k * c * s
        flow[K_BB] += k * s * s
        _add_arm(k / length, k / length**2, c, s, flow)
        linear += h * h * k / length
        cubic += h * h * k / length**3
    near = 0.01 * min(q[L1], q[L2])
    if linear > 0.0:
        near = min(near, math.sqrt(NEAR_ERROR) / linear, (0.5 * NEAR_ERROR / cubic) ** (1.0 / 3.0))
    flow[NEAR], flow[STEP] = near, h


@fused_kernel
def _add_arm(second: float, third: float, c: float, s: float, flow: Vector) -> None:
    """Add one arm's orders 2 and 3 of g, its direction (c, s): the coefficients of the monomials.

    Those of g_y are those of g_x with x and y, c and s exchanged.
    """
    for axis in range(2):
        o, along = (GX, 1) if axis == 0 else (GY + 2, -1)
        flow[o] += second * 1.5 * c * s * s
        flow[o + along] += second * s * (1.0 - 3.0 * c * c)
        flow[o + 2 * along] += second * c * (1.0 - 3.0 * s * s) / 2.0
        o = GX + 3 if axis == 0 else GY + 6
        flow[o] += third * (-2.5 * c**4 + 3.0 * c * c - 0.5)
        flow[o + along] += third * c * s * (4.5 - 7.5 * c * c)
        flow[o + 2 * along] += third * (1.0 - 7.5 * c * c * s * s)
        flow[o + 3 * along] += third * c * s * (1.5 - 2.5 * s * s)
        c, s = s, c


@fused_kernel
def _linear_part(q: Vector, mode: int, flow: Vector) -> None:
    """A (row by row) and b of a mode: 0 in contact, 1 off the belt."""
    m, a, b = q[MASS], flow[_A:_B], flow[_B : _B + 4]
    for n in range(16):
        a[n] = 0.0
    a[2], a[7] = 1.0, 1.0
    a[8], a[9], a[12], a[13] = -flow[K_AA], -flow[K_AB], -flow[K_AB], -flow[K_BB]
    a[10], a[15] = -q[C_X] / m, -q[C_Y] / m
    b[0], b[1], b[2], b[3] = 0.0, 0.0, q[LOAD_X] / m, q[LOAD_Y] / m
    if mode == 0:
        a[9] -= q[MU] * q[K_C] / m
        a[13] -= q[K_C] / m
        b[2] += q[MU] * q[K_C] * q[L_PRE] / m
        b[3] += q[K_C] * q[L_PRE] / m


@fused_kernel
def _one_step(h: float, flow: Vector) -> None:
    """Equation (P) as four polynomials of degree 3 in z(0), the first map."""
    out = flow[_MAPS : _MAPS + 4 * TERMS].reshape((4, TERMS))
    room = flow[_ROOM : _ROOM + 7 * TERMS].reshape((7, TERMS))
    for i in range(4):
        for t in range(TERMS):
            out[i, t] = 0.0
    for n in range(3, -1, -1):
        to, rows = (out, 4) if n == 3 else (room, 2)
        o = _EXPONENTIALS + n * _EXPONENTIAL
        for i in range(rows):
            for t in range(TERMS):
                to[i, t] = 0.0
            to[i, 0] = flow[o + 16 + i]
            for j in range(4):
                to[i, 1 + j] = flow[o + 4 * i + j]
        if n == 3:
            continue
        for i in range(3):  # xx, xy, yy
            multiply_linear(room[i // 2], room[(i + 1) // 2], room[2 + i])
        rest = _EXPONENTIALS + (2 - n) * _EXPONENTIAL
        for axis in range(2):
            _add_monomials(flow, GX + axis * (GY - GX), room)
            for i in range(4):
                weight = _WEIGHTS[n] * h * flow[rest + 4 * i + 2 + axis]
                for t in range(TERMS):
                    out[i, t] += weight * room[6, t]


@fused_kernel
def _more_steps(flow: Vector) -> None:
    """The maps of two steps and more: that of one fewer, with that of one for its variables."""
    maps = flow[_MAPS:_MONOMIALS].reshape((AHEAD, 4, TERMS))
    step = flow[_MONOMIALS:FLOW_SIZE].reshape((TERMS, TERMS))
    monomials(maps[0], step)
    for n in range(1, AHEAD):
        substitute(maps[n - 1], step, maps[n])


@fused_kernel
def _file_maps(mode: int, flow: Vector) -> None:
    """Put the coefficients into the order of `evaluate_all`, those after four steps first."""
    o = IN_CONTACT if mode == 0 else OFF_BELT
    for t in range(TERMS):
        for n in range(4 * AHEAD):
            flow[o + 4 * AHEAD * t + (n + 4) % (4 * AHEAD)] = flow[_MAPS + TERMS * n + t]


@fused_kernel
def _add_monomials(flow: Vector, g: int, room: Vector) -> None:
    """The component of g at `flow[g:]`, of the polynomials x, y, xx, xy, yy in `room[:5]`, into `room[6]`."""
    for t in range(TERMS):
        room[6, t] = flow[g] * room[2, t] + flow[g + 1] * room[3, t] + flow[g + 2] * room[4, t]
    for n in range(2):
        # The cubic terms: (c_3 x + c_4 y) xx and (c_5 x + c_6 y) yy.
        for t in range(5):
            room[5, t] = flow[g + 3 + 2 * n] * room[0, t] + flow[g + 4 + 2 * n] * room[1, t]
        add_product_linear(room[5], room[2 + 2 * n], room[6])


@fused_kernel
def _exponential(h: float, share: int, flow: Vector) -> None:
    """e^{As} (16 numbers) and int_0^s e^{Au} b du (4), s that share of the step, A and b for the last one by size."""
    s, out = _SHARES[share] * h, _EXPONENTIALS + share * _EXPONENTIAL
    a, b, term = flow[_A:_B], flow[_B : _B + 4], flow[_TERM : _TERM + 32]
    for n in range(16):
        term[n] = 1.0 if n % 5 == 0 else 0.0
        flow[out + n] = term[n]
    for i in range(4):
        flow[out + 16 + i] = s * (abs(b[i]) if share == _BY_SIZE else b[i])
    for n in range(1, _TERMS + 1):
        # The next term of the series, A^n s^n/n!.
        for i in range(4):
            for j in range(4):
                value = 0.0
                for k in range(4):
                    value += (abs(a[4 * i + k]) if share == _BY_SIZE else a[4 * i + k]) * term[4 * k + j]
                term[16 + 4 * i + j] = value * s / n
        for i in range(4):
            for j in range(4):
                value = term[16 + 4 * i + j]
                term[4 * i + j] = value
                flow[out + 4 * i + j] += value
                flow[out + 16 + i] += value * (abs(b[j]) if share == _BY_SIZE else b[j]) * s / (n + 1)


@fused_kernel
def _limits(q: Vector, h: float, mode: int, flow: Vector) -> None:
    """Both limits of a step in a mode, from its A and b and `flow[NEAR]`.

    The bound of |y''| within a step that starts at z: |e^{As}| <= e^{|A|h} entry by entry, so nothing escapes it. The
    part of g is at most 2 sum k_i/m near^2/L_i; 5 % cover its own effect on the path.

    The tube is h^2/8 max|r''| of a step with both ends within `near`: with p = max|r''|, |r| <= near + h^2/8 p and
    |v| <= 2 near/h + h p in the step, so p <= k |r| + c |v| + |b| + |g| is an upper bound of p in terms of p itself;
    rate times step <= 0.25 keeps its factor below 0.26.
    """
    a, b, near = flow[_A:_B], flow[_B : _B + 4], flow[NEAR]
    whole = flow[_EXPONENTIALS + _BY_SIZE * _EXPONENTIAL : _EXPONENTIALS + _POWERS * _EXPONENTIAL]
    o = CONTACT_LIMITS if mode == 0 else OFF_BELT_LIMITS
    turned = 2.0 * (q[K1] / q[L1] + q[K2] / q[L2]) / q[MASS] * near * near
    bound = flow[o + BOUND : o + BOUND + 5]
    bound[0] = abs(b[3]) + turned
    for j in range(4):
        bound[1 + j] = 0.0
    for k in range(4):
        bound[0] += abs(a[12 + k]) * whole[16 + k]
        for j in range(4):
            bound[1 + j] += abs(a[12 + k]) * whole[4 * k + j]
    for j in range(5):
        bound[j] *= 1.05
    k = max(abs(a[8]) + abs(a[9]), abs(a[12]) + abs(a[13]))
    c = max(abs(a[10]), abs(a[15]))
    rest = max(abs(b[2]), abs(b[3])) + turned
    own = 0.125 * h * h * k + h * c
    tube = math.inf
    if own < 1.0:
        tube = 0.125 * h * h * 1.05 * ((k + 2.0 * c / h) * near + rest) / (1.0 - own)
    flow[o + TUBE] = tube
