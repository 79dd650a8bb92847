"""The exact engine: polynomial maps between samples, contact events to rounding.

Plain steps (`glide`) are the maps of `propagator`, four at a time. A step is taken only where it is
proven:
- the arms' rotation lies in its small range (|x|, |y| <= NEAR at both ends; NaN fails this too);
- the pad cannot meet or leave the belt within the step: |y(s) - chord| <= h^2/8 max|y''|, so a start and an end
  further than that from L_pre exclude any crossing, double ones included. A bound of max|y''| for the whole small range
  decides nearly always; one for the state at hand decides where the pad is close to the edge.
Every other step is careful (`careful_step`): a Taylor series (`near`) to the first zero of y - L_pre, from there in the
other mode, and so on to the end of the step. A pad beyond the small range, and friction that sees the slip, are left to
`stepping`: slower, never wrong.

The maps are evaluated anew at each fourth step, counted on through all blocks, and after each event. So blocks of any
length give the bits of one run, and so does a state of which a new run starts after a multiple of four steps; after
another number the same to rounding.
"""

from __future__ import annotations

import numpy as np

from squeal_rig.errors import ModelError
from squeal_rig.model.core.forces import acceleration, add_forces
from squeal_rig.model.core.kernel import fused_kernel, inlined_kernel
from squeal_rig.model.core.layout import CACHE_LINE, L_PRE, VX, VY, Vector, X, Y
from squeal_rig.model.motion.cubic import evaluate_all
from squeal_rig.model.motion.near import evaluate_near, expand_near, first_zero_near
from squeal_rig.model.motion.propagator import (
    AHEAD,
    ALL_PASSED,
    BOUND,
    CONTACT_LIMITS,
    FLOW_SIZE,
    GX,
    KIND,
    MAPS,
    NEAR,
    OFF_BELT,
    OFF_BELT_LIMITS,
    PASSED,
    PATH,
    STEP,
    STEPS,
    TUBE,
    place_in_path,
)
from squeal_rig.model.motion.series import MAX_ORDER, ROWS

#: Columns of a recorded event: time from the start of the block [s], vy [m/s] (above 0: the pad leaves the belt).
EVENT_TIME, EVENT_SPEED = 0, 1
# What is counted over a block.
CONTACT_TIME, SEPARATIONS, EVENTS, SINCE, PIECES, BUDGET = range(6)
TALLY_SIZE = 6
#: How a block ended.
DONE, NOT_FINITE, STUCK, OVER_BUDGET, BEYOND = range(5)

MAX_PIECES = 100_000
# Where a diverging motion is given up: long before its numbers overflow.
_BEYOND_M, _BEYOND_M_S = 1e6, 1e12


def workspace() -> Vector:
    """Room for the Taylor series of one motion."""
    return np.zeros((ROWS, MAX_ORDER + 1))


def empty_flow() -> Vector:
    """Room for the propagators of one set of parameters, from the start of a cache line on: vector loads are faster."""
    room = np.zeros(FLOW_SIZE + CACHE_LINE)
    first = -(room.ctypes.data // room.itemsize) % CACHE_LINE
    return room[first : first + FLOW_SIZE]


def refuse_unless_done(ended: int, time: float) -> None:
    """The status of a block as an error sentence; `time` [s] is how far into the block it came.

    Raises:
        ModelError: the motion left every bound, or changes too fast to be followed.
    """
    if ended == NOT_FINITE:
        raise ModelError(f"the motion left every bound {time:.4g} s into the block: no state to go on from")
    if ended == OVER_BUDGET:
        raise ModelError(f"the motion changes too fast: it used up its budget of steps {time:.4g} s into the block")
    if ended == STUCK:
        raise ModelError(
            f"the motion cannot be followed {time:.4g} s into the block:"
            f" a step would need more than {MAX_PIECES} pieces"
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


@inlined_kernel
def careful_step(
    state: Vector, q: Vector, flow: Vector, start: float, h: float, w: Vector, tally: Vector, events: Vector
) -> int:
    """Carry `state` over h [s] through every contact event on the way; `start` is the time in the block [s].

    Where the near range does not hold for all of it, nothing is changed and the answer is `BEYOND`.
    """
    x, y, vx, vy = state[0], state[1], state[2], state[3]
    before, since, separations = tally[CONTACT_TIME], tally[SINCE], tally[SEPARATIONS]
    count = tally[EVENTS]
    rest = h
    allowed = pieces_allowed(tally)
    for _ in range(allowed):
        if not is_near(state, flow, rest):
            state[0], state[1], state[2], state[3] = x, y, vx, vy
            tally[CONTACT_TIME], tally[SINCE], tally[SEPARATIONS] = before, since, separations
            tally[EVENTS] = count
            return BEYOND
        tally[PIECES] += 1.0
        share, found = near_piece(state, q, flow, rest, w)
        if not share > 0.0:
            break
        evaluate_near(w, share, rest, state)
        rest *= 1.0 - share
        if found:
            state[1] = q[L_PRE]  # by rounding it may fall short of it
            count_event(state[3], start + (h - rest), tally, events)
        if rest <= 0.0:
            break
    return step_ending(state, rest, allowed)


@inlined_kernel
def is_near(state: Vector, flow: Vector, rest: float) -> bool:
    """Whether the pad is in the near range, and at its speed still is after `rest` [s]; NaN is not."""
    reach = max(abs(state[0]) + rest * abs(state[2]), abs(state[1]) + rest * abs(state[3]))
    return bool(reach <= flow[NEAR])


@inlined_kernel
def near_piece(state: Vector, q: Vector, flow: Vector, rest: float, w: Vector) -> tuple[float, bool]:
    """Expand the path in the near range from `state` in the workspace `w` over `rest` [s], friction being constant.

    Returns how far it may be followed, as a share of `rest`, and whether a contact event ends it there.
    """
    gap = state[1] - q[L_PRE]
    contact = gap < 0.0 or (gap == 0.0 and (state[3] < 0.0 or (state[3] == 0.0 and is_in_contact(state, q))))
    size, slope, end = expand_near(state, q, flow, contact, rest, w)
    return first_zero_near(w, gap, size, slope, end)


@inlined_kernel
def pieces_allowed(tally: Vector) -> int:
    """Pieces that the next step may have."""
    return MAX_PIECES if tally[BUDGET] == 0.0 else int(min(MAX_PIECES, max(1.0, tally[BUDGET] - tally[PIECES])))


@inlined_kernel
def step_ending(state: Vector, rest: float, allowed: int) -> int:
    """How a careful step ended that left `rest` [s]."""
    # NaN fails this too.
    if not (abs(state[0]) + abs(state[1]) <= _BEYOND_M and abs(state[2]) + abs(state[3]) <= _BEYOND_M_S):
        return NOT_FINITE
    if rest <= 0.0:
        return DONE
    return STUCK if allowed == MAX_PIECES else OVER_BUDGET


@inlined_kernel
def count_event(vy: float, time: float, tally: Vector, events: Vector) -> None:
    """Count one contact event, and record it while there is room."""
    if vy > 0.0:
        tally[CONTACT_TIME] += time - tally[SINCE]
        tally[SEPARATIONS] += 1.0
    tally[SINCE] = time
    n = int(tally[EVENTS])
    if n < events.shape[0]:
        events[n, EVENT_TIME], events[n, EVENT_SPEED] = time, vy
    tally[EVENTS] += 1.0


@inlined_kernel
def _cannot_cross(
    x: float, y: float, vx: float, vy: float, next_y: float, edge: float, contact: bool, h: float, limits: Vector
) -> bool:
    """Whether both ends of a step are on the mode's side of the edge, further than y can be from its chord."""
    bound = limits[BOUND] + limits[BOUND + 1] * abs(x) + limits[BOUND + 2] * abs(y)
    bound += limits[BOUND + 3] * abs(vx) + limits[BOUND + 4] * abs(vy)
    room = min(abs(y - edge), abs(next_y - edge))
    return bool(room > 0.125 * h * h * bound and (next_y < edge) == contact)


@inlined_kernel
def first_not_passed(state: Vector, flow: Vector, kind: float) -> int:
    """How many numbers of the path kept from the last block are passed; all where it does not lead on."""
    k = int(flow[PASSED])
    for i in range(4):
        # A state that somebody changed meanwhile is on no path. At 0 there is nothing to compare with.
        if k < 4 or flow[KIND] != kind or flow[PATH + place_in_path(k - 4) + i] != state[i]:
            return ALL_PASSED
    return k


@inlined_kernel
def _is_clear(path: Vector, low: float, high: float, near: float, fastest: float) -> bool:
    """Whether all states of a path are far enough from the edge, near, and slow enough for constant friction."""
    lowest = min(path[1], path[5], path[9], path[13])
    highest = max(path[1], path[5], path[9], path[13])
    widest = max(abs(path[0]), abs(path[4]), abs(path[8]), abs(path[12]))
    speed = max(path[2], path[6], path[10], path[14])
    return bool(low < lowest and highest < high and widest < near and speed < fastest)


@inlined_kernel
def _write_sample(out: Vector, n: int, x: float, y: float, vx: float, vy: float) -> None:
    """Put a state into row n; its forces are added when the block is full."""
    out[n, X], out[n, Y], out[n, VX], out[n, VY] = x, y, vx, vy


@fused_kernel
def glide(
    state: Vector,
    q: Vector,
    flow: Vector,
    contact: bool,
    fastest: float,
    substeps: int,
    first: int,
    steps: int,
    out: Vector,
) -> int:
    """Plain steps from number `first` on, up to `steps` or the first that is not proven; states on the way to `out`.

    Friction is constant as long as vx < `fastest` at both ends of a step [m/s].
    Returns the number of the step not taken; `state` is its start, and already in `out` where it is a sample.
    """
    path, m = flow[PATH:PASSED], flow[:OFF_BELT] if contact else flow[OFF_BELT:CONTACT_LIMITS]
    limits = flow[CONTACT_LIMITS:OFF_BELT_LIMITS] if contact else flow[OFF_BELT_LIMITS:GX]
    edge, h, tube, near = q[L_PRE], flow[STEP], limits[TUBE], flow[NEAR]
    low, high = (-near, min(near, edge - tube)) if contact else (max(-near, edge + tube), near)
    x, y, vx, vy = state[0], state[1], state[2], state[3]
    clear = low < y < high and abs(x) < near and vx < fastest
    sample = first // substeps
    past_sample = first - sample * substeps
    before = int(flow[STEPS])
    k = first_not_passed(state, flow, MAPS)
    flow[PASSED], flow[KIND] = ALL_PASSED, MAPS
    n = first
    while n < steps:
        whole = (n + before) & (AHEAD - 1) == 0
        if k == ALL_PASSED or whole:
            evaluate_all(m, x, y, vx, vy, path)
            k = 0
            # All of it at once, where nothing has to be looked at more closely: what is done nearly always.
            if whole and clear and substeps == 1 and n + AHEAD <= steps and _is_clear(path, low, high, near, fastest):
                _write_sample(out, n, x, y, vx, vy)
                for i in range(1, AHEAD):
                    o = 4 * i
                    _write_sample(out, n + i, path[o], path[o + 1], path[o + 2], path[o + 3])
                x, y, vx, vy = path[0], path[1], path[2], path[3]
                n, sample, k = n + AHEAD, sample + AHEAD, ALL_PASSED
                continue
        if past_sample == 0:
            _write_sample(out, sample, x, y, vx, vy)
        place = place_in_path(k)
        next_x, next_y, next_vx = path[place], path[place + 1], path[place + 2]
        next_clear = low < next_y < high and abs(next_x) < near and next_vx < fastest
        if not (clear and next_clear):
            reach = max(abs(x), abs(y), abs(next_x), abs(next_y))
            proven = reach <= near and vx < fastest and next_vx < fastest
            if not (proven and _cannot_cross(x, y, vx, vy, next_y, edge, contact, h, limits)):
                state[0], state[1], state[2], state[3] = x, y, vx, vy
                return n
        clear = next_clear
        x, y, vx, vy = next_x, next_y, next_vx, path[place + 3]
        n, k, past_sample = n + 1, k + 4, past_sample + 1
        if past_sample == substeps:
            sample, past_sample = sample + 1, 0
    state[0], state[1], state[2], state[3] = x, y, vx, vy
    flow[PASSED] = k
    return steps


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
    """Fill `out` (n, 4) or (n, 6) with samples x, y, vx, vy and, where it has room, N, F_t from `state` (4,) on, which
    ends one interval after the last; friction is constant, and the pad in the near range.

    Args:
        state: x, y, vx, vy [m, m/s].
        q: packed parameters.
        flow: their propagators.
        substeps: steps per output interval.
        w: workspace.
        tally: contact time [s], separations and events are added up in it; event times in a block start at 0. With a
            `BUDGET` above 0 the block is given up after so many steps and pieces.
        events: room (m, 2) for the first m events of the block.
        out: room for the samples, of the layout of `sample_room`.

    Returns:
        how the block ended, and the number of samples filled; after `BEYOND`, which only `stepping` knows how to go on
        from, the number of steps taken.
    """
    h = flow[STEP]
    contact = is_in_contact(state, q)
    # Not step = 0: for a constant numba would compile what takes it once more.
    step, steps, budget = begin_block(tally, out.shape[0], substeps)
    if steps > budget:
        return OVER_BUDGET, 0
    while True:
        step = glide(state, q, flow, contact, np.inf, substeps, step, steps, out)
        if step == steps:
            break
        ended = careful_step(state, q, flow, step * h, h, w, tally, events)
        if ended == BEYOND:
            return BEYOND, step
        step += 1
        if ended == DONE and steps + tally[PIECES] > budget:
            ended = OVER_BUDGET
        if ended != DONE:
            return ended, (step - 1) // substeps + 1
        contact = is_in_contact(state, q)
    end_block(q, flow, tally, contact, steps, out)
    return DONE, out.shape[0]


@inlined_kernel
def begin_block(tally: Vector, samples: int, substeps: int) -> tuple[int, int, float]:
    """Set back what is counted by the block; its first step, its steps, and how many steps and pieces it may take."""
    tally[SINCE], tally[EVENTS], tally[PIECES] = 0.0, 0.0, 0.0
    return int(tally[EVENTS]), samples * substeps, tally[BUDGET] if tally[BUDGET] > 0.0 else np.inf


@inlined_kernel
def end_block(q: Vector, flow: Vector, tally: Vector, contact: bool, steps: int, out: Vector) -> None:
    """Count what the last event left open, and the steps; the samples' forces where `out` has room for them."""
    add_forces(out, q)
    flow[STEPS] = (int(flow[STEPS]) + steps) % AHEAD
    if contact:
        tally[CONTACT_TIME] += steps * flow[STEP] - tally[SINCE]
