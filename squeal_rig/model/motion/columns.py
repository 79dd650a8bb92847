"""The states of a motion in columns, piece by piece: extremes of a piece are found while it is in the nearest cache.

Both loops are compiled, since a call from the interpreter costs a tenth of what such a piece does.
"""

from __future__ import annotations

from squeal_rig.model.core.kernel import fused_kernel, reduction_kernel
from squeal_rig.model.core.layout import VX, Vector, X, Y
from squeal_rig.model.motion import exact
from squeal_rig.model.motion.exact import BEYOND, DONE
from squeal_rig.model.motion.stepping import advance_any, is_plain

_PIECE = 512  # samples


def advance(
    state: Vector,
    q: Vector,
    flow: Vector,
    substeps: int,
    w: Vector,
    tally: Vector,
    events: Vector,
    out: Vector,
    extremes: Vector,
) -> tuple[int, int]:
    """As `stepping.advance`, into columns.

    Args:
        state, q, flow, substeps, w, tally, events: as in `exact.advance`.
        out: room (4, n) for x, y, vx, vy [m, m/s], a row each.
        extremes: widened by the samples: the fastest vx [m/s], the largest |x| or |y| [m].

    Returns:
        how the motion ended, and the number of samples filled.
    """
    filled = step = 0
    if is_plain(q, flow):
        ended, filled, step = _advance_plainly(state, q, flow, substeps, w, tally, events, out, extremes)
        if ended != BEYOND:
            return ended, filled + step
    return _advance_any(state, q, flow, substeps, w, tally, events, out, extremes, filled, step)


@fused_kernel
def _advance_plainly(
    state: Vector,
    q: Vector,
    flow: Vector,
    substeps: int,
    w: Vector,
    tally: Vector,
    events: Vector,
    out: Vector,
    extremes: Vector,
) -> tuple[int, int, int]:
    """Pieces of `exact.advance`: how they ended, the samples filled, and what the last, unfinished piece came to."""
    filled = 0
    while filled < out.shape[1]:
        part = out.T[filled : min(filled + _PIECE, out.shape[1])]
        ended, came_to = exact.advance(state, q, flow, substeps, w, tally, events, part)
        if ended != DONE:
            return ended, filled, came_to
        widen(out, filled, part.shape[0], extremes)
        filled += part.shape[0]
    return DONE, filled, 0


@fused_kernel
def _advance_any(
    state: Vector,
    q: Vector,
    flow: Vector,
    substeps: int,
    w: Vector,
    tally: Vector,
    events: Vector,
    out: Vector,
    extremes: Vector,
    filled: int,
    step: int,
) -> tuple[int, int]:
    """Pieces of `advance_any` from `filled` samples on, of which the first has come to `step`."""
    while filled < out.shape[1]:
        part = out.T[filled : min(filled + _PIECE, out.shape[1])]
        ended, came_to = advance_any(state, q, flow, substeps, w, tally, events, part, step)
        if ended != DONE:
            return ended, filled + came_to
        widen(out, filled, part.shape[0], extremes)
        filled, step = filled + part.shape[0], 0
    return DONE, filled


@reduction_kernel
def widen(out: Vector, first: int, samples: int, extremes: Vector) -> None:
    """Widen `extremes` by so many samples of `out` (4, n) from number `first` on."""
    x, y, vx = out[X, first : first + samples], out[Y, first : first + samples], out[VX, first : first + samples]
    fastest, largest = extremes[0], extremes[1]
    # numba counts in lanes, and takes the larger of two one by one; most pieces have nothing new.
    beyond = 0
    for i in range(samples):
        beyond += int(vx[i] > fastest) + int(abs(x[i]) > largest) + int(abs(y[i]) > largest)
    if beyond > 0:
        for i in range(samples):
            fastest, largest = max(fastest, vx[i]), max(largest, abs(x[i]), abs(y[i]))
        extremes[0], extremes[1] = fastest, largest
