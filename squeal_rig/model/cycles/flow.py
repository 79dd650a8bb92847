"""The flow of Eq. (2.3) over a given time with its exact derivative, in compiled code.

Between contact events the path and its derivative by the start and by one parameter are Taylor series in time, the arms
exact: with p = L/l = (1 + w)^(-1/2) and d = (r - a)/L of each arm (`motion.series`) the tangent stiffness is

    K = sum k_i [p_i^3 d_i d_i^T - (p_i - 1) I] + clips,     p^3 = (1 + w)^(-3/2) by the recurrence of powers,

a series as well, and the derivative's coefficients follow from those of K by Cauchy's rule. N is continuous where the
pad leaves and meets the belt, so the derivative is carried across unchanged: the saltation matrix is the identity, also
for the derivative by a parameter that moves the edge (Leine and Nijmeijer, Dynamics and Bifurcations of Non-Smooth
Mechanical Systems, 2004, section 7).

Error: rate times step is at most 0.8 at order 18, so each step leaves out 0.8^18/18! = 3e-18 of the motion; of the
arms' rotation, itself r/L of their force, the orders above 12.
"""

from __future__ import annotations

import math

from squeal_rig.model.core.forces import acceleration
from squeal_rig.model.core.kernel import fused_kernel, inlined_kernel
from squeal_rig.model.core.layout import (
    A1X,
    A1Y,
    A2X,
    A2Y,
    C_X,
    C_Y,
    COS_1,
    COS_2,
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
    SIN_1,
    SIN_2,
    Vector,
)
from squeal_rig.model.motion.exact import is_in_contact
from squeal_rig.model.motion.series import first_zero, rests_on_edge

ORDER, _ARM_ORDER = 18, 12
RATE_TIMES_STEP = 0.8
#: Columns of the derivative: by x, y, vx, vy at the start, and by the parameter.
COLUMNS = 5
# Rows of the workspace: position (first, as `motion.series` has it), w, p - 1, p^3, d and p^3 d of each arm, K per
# mass, the parameter's force per mass, p^3 (da.r/L^2 + w dL/L) of each arm, a speed; then x and y of each column.
_X, _Y, _W1, _W2, _P1, _P2, _C1, _C2, _DX1, _DY1, _DX2, _DY2, _EX1, _EY1, _EX2, _EY2 = range(16)
_KXX, _KXY, _KYY, _FX, _FY, _S1, _S2, _SPEED = range(16, 24)
_VARIATION = 24
ROWS = _VARIATION + 2 * COLUMNS
# What is added up along the flow: time on the belt, events, largest |x - x0| and |y - y0|, largest vx, the largest and
# the least y; x0 and y0 are given.
ON_BELT, EVENTS, PEAK_X, PEAK_Y, FASTEST, HIGHEST, X0, Y0, LOWEST = range(9)
TALLY_SIZE = 9
_MAX_PIECES = 4000
_BEYOND_M = 1.0
_PROBES = 6


@inlined_kernel
def _product(w: Vector, a: int, b: int, n: int) -> float:
    value = 0.0
    for j in range(n + 1):
        value += w[a, j] * w[b, n - j]
    return value


@inlined_kernel
def _arm_orders(n: int, w: Vector, row_w: int, row_p: int, x: int, y: int, ax: float, ay: float, length: float) -> None:
    """Order n of w and of p - 1 of one arm."""
    square = _product(w, x, x, n) + _product(w, y, y, n)
    w[row_w, n] = (square - 2.0 * (ax * w[x, n] + ay * w[y, n])) / (length * length)
    if n == 0:
        s = 1.0 + w[row_w, 0]
        w[row_p, 0] = -w[row_w, 0] / (s + math.sqrt(s))
        return
    p = -0.5 * n * w[row_w, n]
    for j in range(1, n + 1):
        p += (0.5 * j - n) * w[row_w, j] * w[row_p, n - j]
    w[row_p, n] = p / (n * (1.0 + w[row_w, 0]))


@inlined_kernel
def _arm_tangent(n: int, w: Vector, arm: int, ax: float, ay: float, length: float) -> None:
    """Order n of p^3, d and p^3 d of one arm, 0 or 1."""
    row_w, row_c, dx, dy, ex, ey = _W1 + arm, _C1 + arm, _DX1 + 2 * arm, _DY1 + 2 * arm, _EX1 + 2 * arm, _EY1 + 2 * arm
    w[dx, n] = ((w[_X, 0] - ax) if n == 0 else w[_X, n]) / length
    w[dy, n] = ((w[_Y, 0] - ay) if n == 0 else w[_Y, n]) / length
    if n == 0:
        w[row_c, 0] = (1.0 + w[row_w, 0]) ** -1.5
    else:
        c = 0.0
        for j in range(1, n + 1):
            c -= (0.5 * j + n) * w[row_w, j] * w[row_c, n - j]
        w[row_c, n] = c / (n * (1.0 + w[row_w, 0]))
    w[ex, n] = _product(w, row_c, dx, n)
    w[ey, n] = _product(w, row_c, dy, n)


@inlined_kernel
def _stiffness_orders(n: int, q: Vector, w: Vector) -> None:
    """Order n of the tangent stiffness per mass."""
    m = q[MASS]
    k1, k2 = q[K1] / m, q[K2] / m
    turned = k1 * w[_P1, n] + k2 * w[_P2, n]
    clips = q[K34] / m if n == 0 else 0.0
    w[_KXX, n] = clips + k1 * _product(w, _EX1, _DX1, n) + k2 * _product(w, _EX2, _DX2, n) - turned
    w[_KXY, n] = k1 * _product(w, _EX1, _DY1, n) + k2 * _product(w, _EX2, _DY2, n)
    w[_KYY, n] = k1 * _product(w, _EY1, _DY1, n) + k2 * _product(w, _EY2, _DY2, n) - turned


@inlined_kernel
def _arm_parameter(n: int, w: Vector, arm: int, q: Vector, dq: Vector) -> tuple[float, float]:
    """Order n of the derivative of one arm's force by the parameter, at a fixed place.

    Of k (p - 1)(r - a): dk (p - 1)(r - a) + k p^3 (da.r/L^2 + w dL/L)(r - a) - k (p - 1) da.
    """
    stiffness, length, ax, ay = (K1, L1, A1X, A1Y) if arm == 0 else (K2, L2, A2X, A2Y)
    row_p, row_s, dx, dy = _P1 + arm, _S1 + arm, _DX1 + 2 * arm, _DY1 + 2 * arm
    k, size = q[stiffness], q[length]
    fx, fy = 0.0, 0.0
    if dq[stiffness] != 0.0:
        fx += dq[stiffness] * size * _product(w, row_p, dx, n)
        fy += dq[stiffness] * size * _product(w, row_p, dy, n)
    if dq[length] != 0.0 or dq[ax] != 0.0 or dq[ay] != 0.0:
        s = 0.0
        for j in range(n + 1):
            moved = (dq[ax] * w[_X, j] + dq[ay] * w[_Y, j]) / (size * size) + w[_W1 + arm, j] * dq[length] / size
            s += w[_C1 + arm, n - j] * moved
        w[row_s, n] = s
        fx += k * (size * _product(w, row_s, dx, n) - dq[ax] * w[row_p, n])
        fy += k * (size * _product(w, row_s, dy, n) - dq[ay] * w[row_p, n])
    return fx, fy


@fused_kernel
def expand_tangent(
    z: Vector, v: Vector, q: Vector, dq: Vector, contact: bool, h: float, tangent: bool, w: Vector
) -> None:
    """Fill the workspace `w` (ROWS, ORDER + 1) with the path from `z` (4,) over h [s], scaled by h; with `tangent`
    also the columns that start from `v` (4, 5). `q` is packed, `dq` its derivative by the parameter.
    """
    m = q[MASS]
    hh = h * h
    cx, cy = h * q[C_X] / m, h * q[C_Y] / m
    clips = q[K34] / m
    normal = q[K_C] / m if contact else 0.0
    mu = q[MU]
    k1, k2 = q[K1] / m, q[K2] / m
    # Beyond the arms' order they are linear, about r = 0.
    aa = k1 * q[COS_1] * q[COS_1] + k2 * q[COS_2] * q[COS_2] + clips
    ab = k1 * q[COS_1] * q[SIN_1] + k2 * q[COS_2] * q[SIN_2]
    bb = k1 * q[SIN_1] * q[SIN_1] + k2 * q[SIN_2] * q[SIN_2]
    w[_X, 0], w[_Y, 0], w[_X, 1], w[_Y, 1] = z[0], z[1], h * z[2], h * z[3]
    if tangent:
        for c in range(COLUMNS):
            row = _VARIATION + 2 * c
            w[row, 0], w[row + 1, 0], w[row, 1], w[row + 1, 1] = v[0, c], v[1, c], h * v[2, c], h * v[3, c]
    for n in range(ORDER - 1):
        pressed = normal * (q[L_PRE] - w[_Y, 0]) if n == 0 else -normal * w[_Y, n]
        if n <= _ARM_ORDER:
            _arm_orders(n, w, _W1, _P1, _X, _Y, q[A1X], q[A1Y], q[L1])
            _arm_orders(n, w, _W2, _P2, _X, _Y, q[A2X], q[A2Y], q[L2])
            ax, ay = -clips * w[_X, n], 0.0
            for j in range(n + 1):
                pull = k1 * w[_P1, j] + k2 * w[_P2, j]
                ax += pull * w[_X, n - j]
                ay += pull * w[_Y, n - j]
            ax -= k1 * q[A1X] * w[_P1, n] + k2 * q[A2X] * w[_P2, n]
            ay -= k1 * q[A1Y] * w[_P1, n] + k2 * q[A2Y] * w[_P2, n]
        else:
            ax, ay = -aa * w[_X, n] - ab * w[_Y, n], -ab * w[_X, n] - bb * w[_Y, n]
        ax += mu * pressed
        ay += pressed
        if n == 0:
            ax += q[LOAD_X] / m
            ay += q[LOAD_Y] / m
        share = 1.0 / ((n + 1.0) * (n + 2.0))
        x2 = hh * ax - cx * (n + 1) * w[_X, n + 1]
        y2 = hh * ay - cy * (n + 1) * w[_Y, n + 1]
        w[_X, n + 2], w[_Y, n + 2] = share * x2, share * y2
        if not tangent:
            continue
        # The parameter's force per mass at a fixed state, times h^2; x2 and y2 are the accelerations.
        px = -x2 * dq[MASS] / m - h * dq[C_X] / m * (n + 1) * w[_X, n + 1]
        py = -y2 * dq[MASS] / m - h * dq[C_Y] / m * (n + 1) * w[_Y, n + 1]
        fx, fy = -dq[K34] * w[_X, n], 0.0
        if contact:
            more = -dq[K_C] * w[_Y, n]
            if n == 0:
                more += dq[K_C] * q[L_PRE] + q[K_C] * dq[L_PRE]
            fx += mu * more + dq[MU] * m * pressed
            fy += more
        if n == 0:
            fx += dq[LOAD_X]
            fy += dq[LOAD_Y]
        top = min(n, _ARM_ORDER)
        if n <= _ARM_ORDER:
            _arm_tangent(n, w, 0, q[A1X], q[A1Y], q[L1])
            _arm_tangent(n, w, 1, q[A2X], q[A2Y], q[L2])
            _stiffness_orders(n, q, w)
            gx, gy = _arm_parameter(n, w, 0, q, dq)
            fx, fy = fx + gx, fy + gy
            gx, gy = _arm_parameter(n, w, 1, q, dq)
            fx, fy = fx + gx, fy + gy
        else:
            # As the path: linear arms. Their angles turn with (COS, SIN), which are packed beside the anchors.
            daa, dab, dbb = _linear_parameter(q, dq)
            fx -= daa * w[_X, n] + dab * w[_Y, n]
            fy -= dab * w[_X, n] + dbb * w[_Y, n]
        px, py = px + hh * fx / m, py + hh * fy / m
        for c in range(COLUMNS):
            row = _VARIATION + 2 * c
            sx, sy = 0.0, 0.0
            for j in range(top + 1):
                sx += w[_KXX, j] * w[row, n - j] + w[_KXY, j] * w[row + 1, n - j]
                sy += w[_KXY, j] * w[row, n - j] + w[_KYY, j] * w[row + 1, n - j]
            gap = normal * w[row + 1, n]
            sx, sy = (
                hh * (sx + mu * gap) + cx * (n + 1) * w[row, n + 1],
                hh * (sy + gap) + cy * (n + 1) * w[row + 1, n + 1],
            )
            if c == COLUMNS - 1:
                sx, sy = sx - px, sy - py
            w[row, n + 2], w[row + 1, n + 2] = -share * sx, -share * sy


@inlined_kernel
def _linear_parameter(q: Vector, dq: Vector) -> tuple[float, float, float]:
    """Derivative of the linear arms' stiffness by the parameter [N/m per unit]: aa, ab, bb, without the clips."""
    c1, s1, c2, s2 = q[COS_1], q[SIN_1], q[COS_2], q[SIN_2]
    aa = dq[K1] * c1 * c1 + dq[K2] * c2 * c2 + 2.0 * (q[K1] * c1 * dq[COS_1] + q[K2] * c2 * dq[COS_2])
    bb = dq[K1] * s1 * s1 + dq[K2] * s2 * s2 + 2.0 * (q[K1] * s1 * dq[SIN_1] + q[K2] * s2 * dq[SIN_2])
    ab = dq[K1] * c1 * s1 + dq[K2] * c2 * s2
    ab += q[K1] * (dq[COS_1] * s1 + c1 * dq[SIN_1]) + q[K2] * (dq[COS_2] * s2 + c2 * dq[SIN_2])
    return aa, ab, bb


@inlined_kernel
def _at(w: Vector, row: int, tau: float, h: float) -> tuple[float, float]:
    """Value and speed of a row's series at the share tau of the step h [s]."""
    value, slope = w[row, ORDER], 0.0
    for n in range(ORDER - 1, -1, -1):
        slope = slope * tau + value
        value = value * tau + w[row, n]
    return value, slope / h


@inlined_kernel
def _carry(w: Vector, tau: float, h: float, tangent: bool, z: Vector, v: Vector) -> None:
    """Put the series at tau into the state and its columns."""
    z[0], z[2] = _at(w, _X, tau, h)
    z[1], z[3] = _at(w, _Y, tau, h)
    if tangent:
        for c in range(COLUMNS):
            v[0, c], v[2, c] = _at(w, _VARIATION + 2 * c, tau, h)
            v[1, c], v[3, c] = _at(w, _VARIATION + 2 * c + 1, tau, h)


@inlined_kernel
def _edge_within(z: Vector, edge: float, w: Vector) -> tuple[float, bool]:
    """First share of the step at which y meets the edge, 1 where it does not, and whether it does."""
    gap, y = z[1] - edge, w[_Y, 0]
    if rests_on_edge(gap, y, w):
        return 1.0, False
    w[_Y, 0] = gap
    share, found = first_zero(w[_Y, : ORDER + 1], 1.0)
    w[_Y, 0] = y
    return share, found


@inlined_kernel
def _measure(w: Vector, share: float, h: float, tally: Vector) -> None:
    """Peaks within a piece: at its end, and where x or y turns on the way."""
    for row, peak in ((_X, PEAK_X), (_Y, PEAK_Y)):
        centre = tally[X0] if row == _X else tally[Y0]
        before_t, before = 0.0, w[row, 1]
        for i in range(1, _PROBES + 1):
            t = share * i / _PROBES
            value, speed = _at(w, row, t, h)
            if row == _X:
                tally[FASTEST] = max(tally[FASTEST], speed)
            turn = value
            if before * speed < 0.0:
                low, high, f_low, f_high = before_t, t, before / h if i == 1 else before, speed
                for _ in range(6):
                    middle = low - f_low * (high - low) / (f_high - f_low)
                    turn, slope = _at(w, row, middle, h)
                    if slope * f_low > 0.0:
                        low, f_low = middle, slope
                    else:
                        high, f_high = middle, slope
            tally[peak] = max(tally[peak], abs(value - centre), abs(turn - centre))
            if row == _Y:
                tally[HIGHEST] = max(tally[HIGHEST], value, turn)
                tally[LOWEST] = min(tally[LOWEST], value, turn)
            before_t, before = t, speed


@fused_kernel
def follow(
    z: Vector,
    v: Vector,
    q: Vector,
    dq: Vector,
    time: float,
    longest: float,
    tangent: bool,
    measure: bool,
    w: Vector,
    tally: Vector,
    path: Vector,
) -> bool:
    """Carry the state `z` (4,), with `tangent` also its derivative `v` (4, 5), over a time [s]; whether it could be.

    Args:
        longest: longest step [s].
        measure: fill the peaks of `tally` (9,); its times and events are always added up.
        path: room (n, 4) for the states at times i/n of the whole; n may be 0.
    """
    contact = is_in_contact(z, q)
    passed, filled = 0.0, 0
    samples = path.shape[0]
    for _ in range(_MAX_PIECES):
        h = min(longest, time - passed)
        expand_tangent(z, v, q, dq, contact, h, tangent, w)
        share, event = _edge_within(z, q[L_PRE], w)
        if not share > 0.0:
            return False
        if measure:
            _measure(w, share, h, tally)
        while filled < samples and filled * time / samples <= passed + share * h:
            tau = (filled * time / samples - passed) / h
            path[filled, 0], path[filled, 2] = _at(w, _X, tau, h)
            path[filled, 1], path[filled, 3] = _at(w, _Y, tau, h)
            filled += 1
        _carry(w, share, h, tangent, z, v)
        if contact:
            tally[ON_BELT] += share * h
        if not abs(z[0]) + abs(z[1]) <= _BEYOND_M:
            return False
        passed = passed + share * h if share < 1.0 or h == longest else time
        if event:
            z[1] = q[L_PRE]
            tally[EVENTS] += 1.0
            contact = is_in_contact(z, q)
        if passed >= time * (1.0 - 1e-15):
            return True
    return False


@fused_kernel
def to_section(z: Vector, v: Vector, q: Vector, longest: float, latest: float, w: Vector, tally: Vector) -> float:
    """Carry `z` to the next maximum of x (vx = 0, x'' < 0) and return the time it took [s]; nan where none comes
    before `latest` [s]. `v` and `w` are room to work in.
    """
    contact = is_in_contact(z, q)
    passed = 0.0
    for _ in range(_MAX_PIECES):
        h = longest
        expand_tangent(z, v, q, q, contact, h, False, w)
        share, event = _edge_within(z, q[L_PRE], w)
        if not share > 0.0:
            return math.nan
        for n in range(ORDER):
            w[_SPEED, n] = (n + 1) * w[_X, n + 1]
        turn, turns = first_zero(w[_SPEED, :ORDER], share)
        at_edge = event and not (turns and turn < share)
        share = min(share, turn)
        if not share > 0.0:
            return math.nan
        _carry(w, share, h, False, z, v)
        passed += share * h
        if contact:
            tally[ON_BELT] += share * h
        if at_edge:
            z[1] = q[L_PRE]
            tally[EVENTS] += 1.0
            contact = is_in_contact(z, q)
        if not (abs(z[0]) + abs(z[1]) <= _BEYOND_M and passed <= latest):
            return math.nan
        if turns and not at_edge:
            z[2] = 0.0
            if acceleration(z[0], z[1], 0.0, z[3], q)[0] < 0.0:
                return passed
    return math.nan
