"""The exact engine for every motion: friction that sees the slip, and motions beyond the near range.

Where friction is constant to rounding and the pad near, the maps of `exact` serve as they stand: off the belt, whatever
the friction law says, and on it where only the direction depends on the slip and V - vx stays above 19.1 V_reg, where
tanh is 1 to rounding. Elsewhere one Taylor series reaches up to four steps ahead (`slip` in the near range, else the
full equations of `series`). It is used only as far as its last terms are rounding, V - vx keeps its sign and its
distance from the poles of tanh, and each of its steps only where the series itself bounds y away from L_pre:
|y(s) - chord| <= h^2/8 max|y''|. Every other step is careful, piece by piece to the next contact event or zero of
V - vx, as in `exact`.

A path is followed to its end through all blocks, so blocks of any length give the bits of one run.
"""

from __future__ import annotations

import math

import numpy as np

from squeal_rig.model.core.forces import acceleration
from squeal_rig.model.core.kernel import fused_kernel, inlined_kernel
from squeal_rig.model.core.layout import L_PRE, SLIP_DIRECTION, SLIP_SPEED, SPEED, V_REG, Vector
from squeal_rig.model.motion import exact
from squeal_rig.model.motion.exact import (
    BEYOND,
    DONE,
    OVER_BUDGET,
    begin_block,
    count_event,
    end_block,
    first_not_passed,
    glide,
    is_in_contact,
    is_near,
    near_piece,
    pieces_allowed,
    step_ending,
)
from squeal_rig.model.motion.near import NEAR_ORDER, evaluate_near
from squeal_rig.model.motion.propagator import (
    AHEAD,
    ALL_PASSED,
    CONTACT_LIMITS,
    KIND,
    NEAR,
    PASSED,
    PATH,
    PATH_TUBE,
    SERIES,
    STEP,
    TUBE,
    place_in_path,
)
from squeal_rig.model.motion.series import (
    EVENT,
    X,
    Y,
    evaluate,
    expand,
    first_zero,
    rests_on_edge,
    share_before_tanh_turns,
    trusted_share,
)
from squeal_rig.model.motion.slip import AS_IT_IS, AS_ONE, LAST_TERM, SATURATED, expand_slip

# Of a piece within one step; rate times step is at most 0.25, faster changes shorten the step.
_ORDER, _ARM_ORDER = 14, 12
# Of a path of four steps: rate times step is at most 1.
_PATH_ORDER = 16
# A path is not looked for at a pad further out [m] or faster [m/s]: careful steps say that it is lost.
_FAR_M, _FAR_M_S = 1e5, 1e11


@fused_kernel
def _slip_sign(state: Vector, q: Vector) -> float:
    """Sign of V - vx just after a state; only friction that sees |V - vx| asks."""
    slip = q[SPEED] - state[2]
    if slip == 0.0:
        slip = -acceleration(state[0], state[1], state[2], state[3], q)[0]
    return 1.0 if slip >= 0.0 else -1.0


@inlined_kernel
def _fastest(q: Vector, flow: Vector, contact: bool) -> float:
    """Up to which vx at both ends of a step [m/s] friction is constant to rounding within it.

    Within the step vx is no further from that at the nearer end than h/2 max|x''|, which is 4 TUBE/h.
    """
    if not contact:
        return math.inf
    if q[SLIP_SPEED] > 0.0:
        return -math.inf
    if q[SLIP_DIRECTION] > 0.0:
        return float(q[SPEED] - SATURATED * q[V_REG] - 4.0 * flow[CONTACT_LIMITS + TUBE] / flow[STEP])
    return math.inf


@inlined_kernel
def _maps_serve(state: Vector, flow: Vector, fastest: float) -> bool:
    """Whether the maps are worth a try at a state."""
    near = flow[NEAR]
    return bool(abs(state[0]) <= near and abs(state[1]) <= near and state[2] < fastest)


@fused_kernel
def _expand(
    state: Vector, q: Vector, flow: Vector, contact: bool, near: bool, rest: float, order: int, arms: int, w: Vector
) -> tuple[float, int]:
    """Expand the path over `rest` [s] in the workspace by the shortest equations that hold.

    Returns the share of `rest` up to which the series is exact to rounding, V - vx is far from the poles of tanh and
    friction what it was taken for, but for a zero of V - vx; and the order reached.
    """
    sign = _slip_sign(state, q) if q[SLIP_SPEED] > 0.0 else 1.0
    if not (near and contact):
        expand(state, q, flow, contact, sign, rest, order, arms, w)
        if contact and q[SLIP_DIRECTION] > 0.0:
            return share_before_tanh_turns(w, order, trusted_share(w, order)), order
        return (1.0 if _ends_in_rounding(w, order) else trusted_share(w, order)), order
    order, taken = expand_slip(state, q, flow, sign, rest, order, w)
    if taken == AS_IT_IS:
        return share_before_tanh_turns(w, order, trusted_share(w, order)), order
    largest = max(abs(w[X, 0]), abs(w[Y, 0]), abs(w[X, 1]), abs(w[Y, 1]), abs(w[X, 2]), abs(w[Y, 2]))
    last = max(abs(w[X, order]), abs(w[Y, order]))
    share = 1.0
    if not last <= LAST_TERM * largest:
        share = (LAST_TERM * largest / last) ** (1.0 / order) if math.isfinite(last) else 0.0
    if taken == AS_ONE:
        allowed = abs(q[SPEED] - state[2]) - SATURATED * q[V_REG]
        movement = slip_movement(w, order, rest, share)
        if movement > allowed:
            share *= allowed / movement
    return share, order


@inlined_kernel
def _ends_in_rounding(w: Vector, order: int) -> bool:
    """Whether what a series leaves out is rounding: its last term is small, and a fraction of the one before."""
    largest = max(abs(w[X, 0]), abs(w[Y, 0]), abs(w[X, 1]), abs(w[Y, 1]), abs(w[X, 2]), abs(w[Y, 2]))
    last = max(abs(w[X, order]), abs(w[Y, order]))
    return bool(last <= LAST_TERM * largest and 8.0 * last <= max(abs(w[X, order - 1]), abs(w[Y, order - 1])))


@inlined_kernel
def slip_movement(w: Vector, order: int, rest: float, share: float) -> float:
    """A bound of |vx - vx(0)| [m/s] up to a share of `rest` [s]; it grows no slower than the share."""
    movement = 0.0
    for n in range(order, 1, -1):
        movement = (movement + n * abs(w[X, n])) * share
    return movement / rest


@inlined_kernel
def next_piece(state: Vector, q: Vector, flow: Vector, rest: float, w: Vector) -> tuple[float, int, int]:
    """Expand the path from `state` in the workspace `w` over `rest` [s].

    Returns how far it may be followed, as a share of `rest`; the order of the series; and what ends it there: 0 its
    accuracy or the end of the step, 1 a contact event, 2 V - vx = 0.
    """
    contact = is_in_contact(state, q)
    near = rest <= flow[STEP] and is_near(state, flow, rest)
    # From one end only: within the step vx moves twice as far from it as from the nearer of two.
    if not near or not state[2] + 4.0 * flow[CONTACT_LIMITS + TUBE] / flow[STEP] < _fastest(q, flow, contact):
        return _series_piece(state, q, flow, contact, near, rest, w)
    share, found = near_piece(state, q, flow, rest, w)
    return share, NEAR_ORDER, 1 if found else 0


@fused_kernel
def _series_piece(
    state: Vector, q: Vector, flow: Vector, contact: bool, near: bool, rest: float, w: Vector
) -> tuple[float, int, int]:
    """`next_piece` where friction sees the slip or the pad is not near."""
    share, order = _expand(state, q, flow, contact, near, rest, _ORDER, _ARM_ORDER, w)
    gap, what = state[1] - q[L_PRE], 0
    if not rests_on_edge(gap, state[1], w):
        w[Y, 0] = gap
        share, found = first_zero(w[Y, : order + 1], share)
        w[Y, 0] = state[1]
        what = 1 if found else 0
    slip = q[SPEED] - state[2]
    if q[SLIP_SPEED] > 0.0 and contact and not slip_movement(w, order, rest, share) < abs(slip):
        for n in range(order):
            w[EVENT, n] = -(n + 1) * w[X, n + 1] / rest
        w[EVENT, 0] = slip
        clear, found = first_zero(w[EVENT, :order], share)
        if clear < share:
            share, what = clear, 2 if found else 0
    return share, order, what


@inlined_kernel
def follow_piece(state: Vector, q: Vector, share: float, order: int, what: int, rest: float, w: Vector) -> None:
    """Carry `state` to the end of a piece, and onto the event that ends it: by rounding it may fall short of it."""
    if order == NEAR_ORDER:
        evaluate_near(w, share, rest, state)
    else:
        evaluate(w, order, share, rest, state)
    if what == 1:
        state[1] = q[L_PRE]
    elif what == 2:
        state[2] = q[SPEED]


@inlined_kernel
def _careful_step(
    state: Vector, q: Vector, flow: Vector, start: float, h: float, w: Vector, tally: Vector, events: Vector
) -> int:
    """Carry `state` over h [s] through every event on the way; `start` is the time in the block [s]."""
    rest = h
    allowed = pieces_allowed(tally)
    for _ in range(allowed):
        tally[exact.PIECES] += 1.0
        share, order, what = next_piece(state, q, flow, rest, w)
        if not share > 0.0:
            break
        follow_piece(state, q, share, order, what, rest, w)
        rest *= 1.0 - share
        if what == 1:
            count_event(state[3], start + (h - rest), tally, events)
        if rest <= 0.0:
            break
    return step_ending(state, rest, allowed)


@fused_kernel
def _fill_path(state: Vector, q: Vector, flow: Vector, contact: bool, w: Vector) -> int:
    """Put the states after the next four steps into the path by one Taylor series, or after as many as it is good for.

    Returns how many numbers of the path count as passed: those states are the last ones in it.
    """
    whole = AHEAD * flow[STEP]
    if not (abs(state[0]) + abs(state[1]) <= _FAR_M and abs(state[2]) + abs(state[3]) <= _FAR_M_S):
        return ALL_PASSED
    near = is_near(state, flow, whole)
    share, order = _expand(state, q, flow, contact, near, whole, _PATH_ORDER, _PATH_ORDER, w)
    steps = int(AHEAD * share)
    share = steps / AHEAD
    if contact and q[SLIP_SPEED] > 0.0 and not slip_movement(w, order, whole, share) < abs(q[SPEED] - state[2]):
        return ALL_PASSED
    bend, reach_x, reach_y = 0.0, abs(w[X, order]), abs(w[Y, order])
    for n in range(order, 1, -1):
        bend = bend * share + n * (n - 1) * abs(w[Y, n])
        reach_x, reach_y = reach_x * share + abs(w[X, n - 1]), reach_y * share + abs(w[Y, n - 1])
    if near and contact and max(reach_x * share + abs(state[0]), reach_y * share + abs(state[1])) > flow[NEAR]:
        return ALL_PASSED
    flow[PATH_TUBE] = bend / (8.0 * AHEAD * AHEAD)
    if steps == AHEAD:
        _evaluate_four(w, order, 1.0 / whole, flow[PATH:PASSED])
    else:
        for n in range(steps):
            k = PATH + place_in_path(ALL_PASSED - 4 * (steps - n))
            evaluate(w, order, (n + 1.0) / AHEAD, whole, flow[k : k + 4])
    return ALL_PASSED - 4 * steps


@inlined_kernel
def _evaluate_four(w: Vector, order: int, per_path: float, path: Vector) -> None:
    """Put the path at a quarter, a half, three quarters and the whole of its time into `path` (16,)."""
    x, y = w[X, order], w[Y, order]
    x1, x2, x3, x4, y1, y2, y3, y4 = x, x, x, x, y, y, y, y
    u1 = u2 = u3 = u4 = v1 = v2 = v3 = v4 = 0.0
    for n in range(order - 1, -1, -1):
        x, y = w[X, n], w[Y, n]
        u1, u2, u3, u4 = u1 * 0.25 + x1, u2 * 0.5 + x2, u3 * 0.75 + x3, u4 + x4
        v1, v2, v3, v4 = v1 * 0.25 + y1, v2 * 0.5 + y2, v3 * 0.75 + y3, v4 + y4
        x1, x2, x3, x4 = x1 * 0.25 + x, x2 * 0.5 + x, x3 * 0.75 + x, x4 + x
        y1, y2, y3, y4 = y1 * 0.25 + y, y2 * 0.5 + y, y3 * 0.75 + y, y4 + y
    path[0], path[1], path[2], path[3] = x4, y4, u4 * per_path, v4 * per_path
    path[4], path[5], path[6], path[7] = x1, y1, u1 * per_path, v1 * per_path
    path[8], path[9], path[10], path[11] = x2, y2, u2 * per_path, v2 * per_path
    path[12], path[13], path[14], path[15] = x3, y3, u3 * per_path, v3 * per_path


@fused_kernel
def _glide_by_series(
    state: Vector,
    q: Vector,
    flow: Vector,
    contact: bool,
    fastest: float,
    substeps: int,
    first: int,
    steps: int,
    w: Vector,
    out: Vector,
) -> tuple[int, bool]:
    """As `glide`, by series; ends where a path does and the maps serve again, which is the second answer."""
    edge = q[L_PRE]
    sample = first // substeps
    past_sample = first - sample * substeps
    k = first_not_passed(state, flow, SERIES)
    flow[PASSED], flow[KIND] = ALL_PASSED, SERIES
    for n in range(first, steps):
        if k == ALL_PASSED:
            if n > first and _maps_serve(state, flow, fastest):
                return n, True
            k = _fill_path(state, q, flow, contact, w)
        if past_sample == 0:
            for i in range(4):
                out[sample, i] = state[i]
        if k == ALL_PASSED:
            return n, False
        place = PATH + place_in_path(k)
        next_y, tube = flow[place + 1], flow[PATH_TUBE]
        room = min(edge - state[1], edge - next_y) if contact else min(state[1] - edge, next_y - edge)
        if not room > tube:
            return n, False
        for i in range(4):
            state[i] = flow[place + i]
        k, past_sample = k + 4, past_sample + 1
        if past_sample == substeps:
            sample, past_sample = sample + 1, 0
    flow[PASSED] = k
    return steps, False


@fused_kernel
def advance_any(
    state: Vector,
    q: Vector,
    flow: Vector,
    substeps: int,
    w: Vector,
    tally: Vector,
    events: Vector,
    out: Vector,
    first: int,
) -> tuple[int, int]:
    """`exact.advance` for every motion, from step `first` of the block on."""
    h = flow[STEP]
    contact = is_in_contact(state, q)
    steps, budget = out.shape[0] * substeps, tally[exact.BUDGET] if tally[exact.BUDGET] > 0.0 else np.inf
    if first == 0:
        begin_block(tally, out.shape[0], substeps)
    if steps > budget:
        return OVER_BUDGET, 0
    step = first
    fastest = _fastest(q, flow, contact)
    series = first_not_passed(state, flow, SERIES) < ALL_PASSED or not _maps_serve(state, flow, fastest)
    while True:
        if series:
            step, served = _glide_by_series(state, q, flow, contact, fastest, substeps, step, steps, w, out)
            if served:
                series = False
                continue
        else:
            step = glide(state, q, flow, contact, fastest, substeps, step, steps, out)
            if step < steps and not _maps_serve(state, flow, fastest):
                series = True
                continue
        if step == steps:
            break
        ended = _careful_step(state, q, flow, step * h, h, w, tally, events)
        step += 1
        if ended == DONE and steps + tally[exact.PIECES] > budget:
            ended = OVER_BUDGET
        if ended != DONE:
            return ended, (step - 1) // substeps + 1
        contact = is_in_contact(state, q)
        fastest = _fastest(q, flow, contact)
        series = not _maps_serve(state, flow, fastest)
    end_block(q, flow, tally, contact, steps, out)
    return DONE, out.shape[0]


def is_plain(q: Vector, flow: Vector) -> bool:
    """Whether `exact.advance` serves until it says otherwise: friction is constant, and no series is under way."""
    return not (q[SLIP_SPEED] or q[SLIP_DIRECTION] or flow[KIND] == SERIES)


def advance(
    state: Vector,
    q: Vector,
    flow: Vector,
    substeps: int,
    w: Vector,
    tally: Vector,
    events: Vector,
    out: Vector,
) -> tuple[int, int]:
    """`exact.advance` for every motion. What is rarely needed is compiled, or loaded, when it first is.

    Returns:
        how the block ended, and the number of samples filled.
    """
    step = 0
    if is_plain(q, flow):
        ended, step = exact.advance(state, q, flow, substeps, w, tally, events, out)
        if ended != BEYOND:
            return ended, step
    return advance_any(state, q, flow, substeps, w, tally, events, out, step)
