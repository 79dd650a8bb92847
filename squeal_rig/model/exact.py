"""The exact engine: linear part by matrix exponentials, arm rotation by quadrature, contact events to rounding.

A plain step (`advance`) is equation (P) of squeal_rig.model.propagator. It is taken only where it is proven:
- the arms' rotation lies in its small range (|x|, |y| <= NEAR at both ends; NaN fails this too);
- the pad cannot meet or leave the belt within the step: |y(s) - chord| <= h^2/8 max|y''|, and a bound of |y''|
  comes with the propagators, so a start and an end further than that from L_pre exclude any crossing, double ones
  included.
Every other step is careful (`careful_step`): Taylor series of the full nonlinear equations, to the first zero of
y - L_pre (or of V - vx where friction sees |V - vx|), from there in the other mode, and so on to the end of the
step, in pieces no longer than the series is exact to rounding. So far motions and slip friction are slower, never
wrong.
"""

from __future__ import annotations

import numpy as np

from squeal_rig.errors import ModelError
from squeal_rig.model.dynamics import (
    K_C,
    L_PRE,
    MU,
    SLIP_DIRECTION,
    SLIP_SPEED,
    SPEED,
    Vector,
    acceleration,
    friction_ratio,
)
from squeal_rig.model.kernel import fused_kernel, inlined_kernel
from squeal_rig.model.near import NEAR_ORDER, evaluate_near, expand_near, first_zero_near
from squeal_rig.model.propagator import (
    BOUND,
    DRIFT,
    FLOW_SIZE,
    GX,
    GY,
    IN_CONTACT,
    NEAR,
    NODES,
    OFF_BELT,
    STEP,
    TUBE,
)
from squeal_rig.model.series import (
    EVENT,
    MAX_ORDER,
    ROWS,
    X,
    Y,
    evaluate,
    expand,
    first_zero,
    rests_on_edge,
    share_before_tanh_turns,
    trusted_share,
)

#: Columns of a recorded event: time from the start of the block [s], vy [m/s] (above 0: the pad leaves the belt).
EVENT_TIME, EVENT_SPEED = 0, 1
# What is counted over a block.
CONTACT_TIME, SEPARATIONS, EVENTS, SINCE = range(4)
TALLY_SIZE = 4
#: How a block ended.
DONE, NOT_FINITE, STUCK = 0, 1, 2

# Beyond the near range; rate times step is at most 0.25, faster changes shorten the step.
_FULL_ORDER, _FULL_ARM_ORDER = 14, 12
_MAX_PIECES = 100_000
# Where a diverging motion is given up: long before its numbers overflow.
_BEYOND_M, _BEYOND_M_S = 1e6, 1e12


def workspace() -> Vector:
    """Room for the Taylor series of one motion."""
    return np.zeros((ROWS, MAX_ORDER + 1))


def empty_flow() -> Vector:
    """Room for the propagators of one set of parameters."""
    return np.zeros(FLOW_SIZE)


def refuse_unless_done(ended: int, time: float) -> None:
    """The status of a block as an error sentence; `time` [s] is how far into the block it came.

    Raises:
        ModelError: the motion left every bound, or changes too fast to be followed.
    """
    if ended == NOT_FINITE:
        raise ModelError(f"the motion left every bound {time:.4g} s into the block: no state to go on from")
    if ended == STUCK:
        raise ModelError(
            f"the motion cannot be followed {time:.4g} s into the block:"
            f" a step would need more than {_MAX_PIECES} pieces"
        )


@fused_kernel
def is_in_contact(state: Vector, q: Vector) -> bool:
    """Whether the contact spring acts just after a state: by y, at y = L_pre by vy, then by the acceleration."""
    gap = state[1] - q[L_PRE]
    if gap == 0.0:
        gap = state[3]
    if gap == 0.0:
        gap = acceleration(state[0], state[1], state[2], state[3], q)[1]
    return bool(gap <= 0.0)


@fused_kernel
def _slip_sign(state: Vector, q: Vector) -> float:
    """Sign of V - vx just after a state; only friction that sees |V - vx| asks."""
    slip = q[SPEED] - state[2]
    if slip == 0.0:
        slip = -acceleration(state[0], state[1], state[2], state[3], q)[0]
    return 1.0 if slip >= 0.0 else -1.0


@inlined_kernel
def next_piece(state: Vector, q: Vector, flow: Vector, rest: float, w: Vector) -> tuple[float, int, int]:
    """Expand the path from `state` in the workspace `w` over `rest` [s].

    Returns how far it may be followed, as a share of `rest`; the order of the series; and what ends it there: 0 its
    accuracy or the end of the step, 1 a contact event, 2 V - vx = 0.
    """
    slips = q[SLIP_SPEED] > 0.0 or q[SLIP_DIRECTION] > 0.0
    if slips or rest > flow[STEP] or not max(abs(state[0]), abs(state[1])) <= flow[NEAR]:
        return _far_piece(state, q, flow, rest, w)
    gap = state[1] - q[L_PRE]
    contact = gap < 0.0 or (gap == 0.0 and (state[3] < 0.0 or (state[3] == 0.0 and is_in_contact(state, q))))
    size, slope, end = expand_near(state, q, flow, contact, rest, w)
    share, found = first_zero_near(w, gap, size, slope, end)
    return share, NEAR_ORDER, 1 if found else 0


@fused_kernel
def _far_piece(state: Vector, q: Vector, flow: Vector, rest: float, w: Vector) -> tuple[float, int, int]:
    """`next_piece` by the full nonlinear equations."""
    contact = is_in_contact(state, q)
    kinked = q[SLIP_SPEED] > 0.0
    gap = state[1] - q[L_PRE]
    order, what = _FULL_ORDER, 0
    expand(state, q, flow, contact, _slip_sign(state, q), rest, _FULL_ORDER, _FULL_ARM_ORDER, w)
    share = trusted_share(w, order)
    if contact and q[SLIP_DIRECTION] > 0.0:
        share = share_before_tanh_turns(w, order, share)
    if not rests_on_edge(gap, state[1], w):
        w[Y, 0] = gap
        share, found = first_zero(w[Y, : order + 1], share)
        w[Y, 0] = state[1]
        what = 1 if found else 0
    if kinked:
        for n in range(order):
            w[EVENT, n] = -(n + 1) * w[X, n + 1] / rest
        w[EVENT, 0] = q[SPEED] - state[2]
        clear, found = first_zero(w[EVENT, :order], share)
        if clear < share:
            share, what = clear, 2 if found else 0
    return share, order, what


@inlined_kernel
def careful_step(
    state: Vector, q: Vector, flow: Vector, start: float, h: float, w: Vector, tally: Vector, events: Vector
) -> int:
    """Carry `state` over h [s] through every event on the way; `start` is the time in the block [s]."""
    rest = h
    for _ in range(_MAX_PIECES):
        share, order, what = next_piece(state, q, flow, rest, w)
        if not share > 0.0:
            break
        if order == NEAR_ORDER:
            evaluate_near(w, share, rest, state)
        else:
            evaluate(w, order, share, rest, state)
        rest *= 1.0 - share
        if what == 1:
            state[1] = q[L_PRE]
            _count_event(state[3], start + (h - rest), tally, events)
        elif what == 2:
            state[2] = q[SPEED]
        if rest <= 0.0:
            break
    # NaN fails this too.
    if not (abs(state[0]) + abs(state[1]) <= _BEYOND_M and abs(state[2]) + abs(state[3]) <= _BEYOND_M_S):
        return NOT_FINITE
    return DONE if rest <= 0.0 else STUCK


@inlined_kernel
def _count_event(vy: float, time: float, tally: Vector, events: Vector) -> None:
    """Count one contact event, and record it while there is room."""
    if vy > 0.0:
        tally[CONTACT_TIME] += time - tally[SINCE]
        tally[SEPARATIONS] += 1.0
    tally[SINCE] = time
    n = int(tally[EVENTS])
    if n < events.shape[0]:
        events[n, EVENT_TIME], events[n, EVENT_SPEED] = time, vy
    tally[EVENTS] += 1.0


@fused_kernel
def _glide(
    state: Vector, q: Vector, flow: Vector, contact: bool, substeps: int, first: int, steps: int, out: Vector
) -> int:
    """Plain steps from number `first` on, as long as they are proven and up to `steps`; samples on the way go to `out`.

    Returns the number of the step not taken; `state` is its start, and already in `out` where it is a sample.
    """
    m = flow[IN_CONTACT:OFF_BELT] if contact else flow[OFF_BELT:GX]
    stiffness, edge, mu = q[K_C], q[L_PRE], q[MU]
    slips = q[SLIP_SPEED] > 0.0 or q[SLIP_DIRECTION] > 0.0
    near = -1.0 if slips else flow[NEAR]
    low, high = (-near, min(near, edge - m[TUBE])) if contact else (max(-near, edge + m[TUBE]), near)
    h = flow[STEP]
    g0, g1, g2, g3, g4, g5, g6 = (
        flow[GX],
        flow[GX + 1],
        flow[GX + 2],
        flow[GX + 3],
        flow[GX + 4],
        flow[GX + 5],
        flow[GX + 6],
    )
    k0, k1, k2, k3, k4, k5, k6 = (
        flow[GY],
        flow[GY + 1],
        flow[GY + 2],
        flow[GY + 3],
        flow[GY + 4],
        flow[GY + 5],
        flow[GY + 6],
    )
    x, y, vx, vy = state[0], state[1], state[2], state[3]
    clear = low < y < high and abs(x) < near
    i = first // substeps
    j = first - i * substeps
    n = first
    while n < steps:
        if j == 0:
            normal = stiffness * max(0.0, edge - y)
            out[i, 0], out[i, 1], out[i, 2], out[i, 3] = x, y, vx, vy
            out[i, 4], out[i, 5] = normal, (friction_ratio(vx, q) if slips else mu) * normal
        x_1 = m[NODES] + m[NODES + 2] * x + m[NODES + 3] * y + (m[NODES + 4] * vx + m[NODES + 5] * vy)
        y_1 = m[NODES + 1] + m[NODES + 6] * x + m[NODES + 7] * y + (m[NODES + 8] * vx + m[NODES + 9] * vy)
        x_2 = m[NODES + 10] + m[NODES + 12] * x + m[NODES + 13] * y + (m[NODES + 14] * vx + m[NODES + 15] * vy)
        y_2 = m[NODES + 11] + m[NODES + 16] * x + m[NODES + 17] * y + (m[NODES + 18] * vx + m[NODES + 19] * vy)
        x_3 = m[NODES + 20] + m[NODES + 22] * x + m[NODES + 23] * y + (m[NODES + 24] * vx + m[NODES + 25] * vy)
        y_3 = m[NODES + 21] + m[NODES + 26] * x + m[NODES + 27] * y + (m[NODES + 28] * vx + m[NODES + 29] * vy)
        xx, xy, yy = x_1 * x_1, x_1 * y_1, y_1 * y_1
        gx_1 = xx * (g0 + g3 * x_1 + g4 * y_1) + xy * g1 + yy * (g2 + g5 * x_1 + g6 * y_1)
        gy_1 = xx * (k0 + k3 * x_1 + k4 * y_1) + xy * k1 + yy * (k2 + k5 * x_1 + k6 * y_1)
        xx, xy, yy = x_2 * x_2, x_2 * y_2, y_2 * y_2
        gx_2 = xx * (g0 + g3 * x_2 + g4 * y_2) + xy * g1 + yy * (g2 + g5 * x_2 + g6 * y_2)
        gy_2 = xx * (k0 + k3 * x_2 + k4 * y_2) + xy * k1 + yy * (k2 + k5 * x_2 + k6 * y_2)
        xx, xy, yy = x_3 * x_3, x_3 * y_3, y_3 * y_3
        gx_3 = xx * (g0 + g3 * x_3 + g4 * y_3) + xy * g1 + yy * (g2 + g5 * x_3 + g6 * y_3)
        gy_3 = xx * (k0 + k3 * x_3 + k4 * y_3) + xy * k1 + yy * (k2 + k5 * x_3 + k6 * y_3)
        x_4 = m[DRIFT] + m[4] * x + m[5] * y + (m[6] * vx + m[7] * vy)
        y_4 = m[DRIFT + 1] + m[8] * x + m[9] * y + (m[10] * vx + m[11] * vy)
        vx_4 = m[DRIFT + 2] + m[12] * x + m[13] * y + (m[14] * vx + m[15] * vy)
        vy_4 = m[DRIFT + 3] + m[16] * x + m[17] * y + (m[18] * vx + m[19] * vy)
        x_4 += (m[50] * gx_1 + m[51] * gy_1 + m[58] * gx_2) + (m[59] * gy_2 + m[66] * gx_3 + m[67] * gy_3)
        y_4 += (m[52] * gx_1 + m[53] * gy_1 + m[60] * gx_2) + (m[61] * gy_2 + m[68] * gx_3 + m[69] * gy_3)
        vx_4 += (m[54] * gx_1 + m[55] * gy_1 + m[62] * gx_2) + (m[63] * gy_2 + m[70] * gx_3 + m[71] * gy_3)
        vy_4 += (m[56] * gx_1 + m[57] * gy_1 + m[64] * gx_2) + (m[65] * gy_2 + m[72] * gx_3 + m[73] * gy_3)
        clear_4 = low < y_4 < high and abs(x_4) < near
        if not (clear and clear_4):
            bound = (
                m[BOUND]
                + m[BOUND + 1] * abs(x)
                + m[BOUND + 2] * abs(y)
                + m[BOUND + 3] * abs(vx)
                + m[BOUND + 4] * abs(vy)
            )
            room = min(abs(y - edge), abs(y_4 - edge))
            reach = max(abs(x), abs(y), abs(x_4), abs(y_4))
            if not (room > 0.125 * h * h * bound and reach <= near and (y_4 < edge) == contact):
                break
        clear = clear_4
        x, y, vx, vy = x_4, y_4, vx_4, vy_4
        n += 1
        j += 1
        if j == substeps:
            i, j = i + 1, 0
    state[0], state[1], state[2], state[3] = x, y, vx, vy
    return n


@fused_kernel
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
    """Fill `out` (n, 6) with samples x, y, vx, vy, N, F_t from `state` (4,) on, which ends one interval after the
    last.

    Args:
        state: x, y, vx, vy [m, m/s].
        q: packed parameters.
        flow: their propagators over one step.
        substeps: steps per output interval.
        w: workspace.
        tally: contact time [s], separations and events are added up in it; event times in a block start at 0.
        events: room (m, 2) for the first m events of the block.
        out: room for the samples.

    Returns:
        how the block ended, and the number of samples filled.
    """
    h = flow[STEP]
    contact = is_in_contact(state, q)
    tally[SINCE], tally[EVENTS] = 0.0, 0.0
    steps = out.shape[0] * substeps
    step = 0
    while True:
        step = _glide(state, q, flow, contact, substeps, step, steps, out)
        if step == steps:
            break
        ended = careful_step(state, q, flow, step * h, h, w, tally, events)
        step += 1
        if ended != DONE:
            return ended, (step - 1) // substeps + 1
        contact = is_in_contact(state, q)
    if contact:
        tally[CONTACT_TIME] += steps * h - tally[SINCE]
    return DONE, out.shape[0]
