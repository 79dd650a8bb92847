"""Many operating points at once on all cores, each run summarised while it goes: memory stays flat however
many they are.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from squeal_rig.configuration.declared import declarations
from squeal_rig.errors import ParameterError
from squeal_rig.model.core.kernel import kernel, reduction_kernel
from squeal_rig.model.core.layout import (
    CACHE_LINE,
    L_PRE,
    PACKED_SIZE,
    SAMPLE_SIZE,
    STATE_SIZE,
    Vector,
    X,
    Y,
    checked_arrays,
    pack,
)
from squeal_rig.model.core.statics import FOUND, rest_position
from squeal_rig.model.motion.exact import CONTACT_TIME, DONE, SEPARATIONS, TALLY_SIZE
from squeal_rig.model.motion.propagator import FLOW_SIZE, propagators, substeps_needed
from squeal_rig.model.motion.series import MAX_ORDER, ROWS
from squeal_rig.model.motion.stepping import advance_any
from squeal_rig.model.motion.trajectory import refuse_unless_positive
from squeal_rig.model.parameters import RigParameters

#: Parameters that may vary: the numeric ones.
FIELDS = tuple(name for name, declaration in declarations(RigParameters).items() if declaration.kind is float)
#: What `status` of a run means; above 0 the run has no numbers (nan).
STATUS = (
    "done",
    "the motion left every bound",
    "the motion changes too fast to be followed",
    "the motion used up its budget of steps",
    "no equilibrium in contact to start from",
)
_NO_EQUILIBRIUM = 4
# Order of the columns the kernel fills.
_COLUMNS = (
    "peak_x",
    "peak_y",
    "rms_x",
    "rms_y",
    "squeal_frequency",
    "growth_rate",
    "contact_loss_time",
    "contact_share",
    "separations",
    "status",
)
SUMMARY = np.dtype([(name, np.int64 if name in ("separations", "status") else np.float64) for name in _COLUMNS])
_BLOCK = 512
_RUNS_PER_TASK = 8


@dataclass(frozen=True)
class Ensemble:
    """Result of `simulate_many`. `summaries`: one record (dtype `SUMMARY`) a run, in the shape of what varies; lengths
    [m], rates [1/s], times [s].

    - peak_x, peak_y, rms_x, rms_y: displacement from the static equilibrium, at the samples
    - squeal_frequency [Hz]: mean rate at which x passes its equilibrium upwards, from the first passage to the last
    - growth_rate [1/s]: slope of the logarithm of the RMS displacement of each 512 samples, by least squares; nan
      for fewer than two such blocks. Near zero on a limit cycle: what it says depends on the window
    - contact_loss_time [s], contact_share, separations: exact, from the contact events
    - status: index into `STATUS`
    `traces`, where asked for: float64 (..., samples, 6), x, y, vx, vy, N, F_t; nan from where a run failed.
    """

    summaries: NDArray[np.void]
    traces: Vector | None


def simulate_many(
    parameters: RigParameters | Sequence[RigParameters],
    duration: float,
    sample_rate: float = 51200.0,
    settle: float = 0.0,
    initial_compressions: ArrayLike = 0.1,
    threads: int | None = None,
    traces: bool = False,
    **varied: ArrayLike,
) -> Ensemble:
    """Simulate each set of parameters with the exact engine; the result does not depend on the number of threads.

    Args:
        parameters: what `varied` leaves as it is, switches included; or one set a run, and nothing varied.
        duration: time summarised of each run [s], after `settle`.
        sample_rate: samples per second [Hz].
        settle: time simulated first, without being summarised [s].
        initial_compressions: start at rest, displaced towards the belt by this many static compressions; one number
            or an array that broadcasts with what varies.
        threads: how many work at once; one a core when None.
        traces: keep every sample as well, 48 bytes each.
        varied: numeric fields of `RigParameters`, and `pad_stiffness` for k1 and k2 at once, that broadcast to one
            shape, the shape of the result. A set of parameters takes 0.2 kB.

    Raises:
        ParameterError: an argument is out of its bounds. A run that fails says so in its status.
    """
    refuse_unless_positive(duration=(duration, "s"), sample_rate=(sample_rate, "Hz"))
    if not (math.isfinite(settle) and settle >= 0.0):
        raise ParameterError(f"settle = {settle} s is out of bounds: it must be 0 s or more")
    if threads is not None and threads < 1:
        raise ParameterError(f"threads = {threads} is out of bounds: it must be 1 or more")
    packed, starts, shape = _many_sets(parameters, varied, np.asarray(initial_compressions, dtype=np.float64))
    runs = len(packed)
    samples = math.ceil(duration * sample_rate * (1.0 - 1e-12))
    settling = math.ceil(settle * sample_rate * (1.0 - 1e-12))
    table = np.full((runs, len(_COLUMNS)), np.nan)
    kept = np.full((runs, samples, SAMPLE_SIZE), np.nan) if traces else np.empty((0, samples, SAMPLE_SIZE))

    def work(first: int) -> None:
        rows = slice(first, first + _RUNS_PER_TASK)
        _summarise(packed[rows], starts[rows], 1.0 / sample_rate, settling, samples, table[rows], kept[rows])

    workers = os.cpu_count() or 1 if threads is None else threads
    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(work, range(0, runs, _RUNS_PER_TASK)))
    summaries = np.empty(runs, dtype=SUMMARY)
    for column, name in enumerate(_COLUMNS):
        values = table[:, column]
        summaries[name] = np.nan_to_num(values) if SUMMARY[name].kind == "i" else values
    return Ensemble(summaries.reshape(shape), kept.reshape((*shape, samples, SAMPLE_SIZE)) if traces else None)


def _many_sets(
    parameters: RigParameters | Sequence[RigParameters], varied: Mapping[str, ArrayLike], offsets: Vector
) -> tuple[Vector, Vector, tuple[int, ...]]:
    """Packed parameters (runs, 28), starts (runs,) and the shape of the result."""
    if isinstance(parameters, RigParameters):
        values, shape = checked_arrays(varied, FIELDS, "many runs")
        try:
            shape = np.broadcast_shapes(shape, offsets.shape)
        except ValueError:
            raise ParameterError(
                f"initial_compressions of shape {offsets.shape} does not broadcast with what varies, {shape}"
            ) from None
        base: Mapping[str, Any] = parameters.as_mapping()
    else:
        if varied:
            raise ParameterError(
                f"{next(iter(varied))!r} cannot vary over a list of parameters: give one set, and arrays"
            )
        shape = (len(parameters),)
        if offsets.shape not in ((), shape):
            raise ParameterError(
                f"initial_compressions of shape {offsets.shape} must be one finite number, or one for each of"
                f" {len(parameters)} runs"
            )
        base = {}
        values = {name: np.array([getattr(p, name) for p in parameters]) for name in declarations(RigParameters)}
    if not np.isfinite(offsets).all():
        raise ParameterError("initial_compressions must be finite numbers")
    packed = np.array(np.broadcast_to(pack({**base, **values}), (*shape, PACKED_SIZE)))
    return packed.reshape(-1, PACKED_SIZE), np.broadcast_to(offsets, shape).flatten(), shape


@kernel
def _summarise(
    packed: Vector,
    starts: Vector,
    interval: float,
    settling: int,
    samples: int,
    table: Vector,
    kept: Vector,
) -> None:
    """Run each row of `packed` and fill its row of `table`, and of `kept` (runs, samples, 6) where it has any."""
    flow, w = np.empty(FLOW_SIZE), np.zeros((ROWS, MAX_ORDER + 1))
    tally, events = np.zeros(TALLY_SIZE), np.empty((0, 2))
    # Transposed it is as a `sample_room`, which compiled code cannot make.
    columns = np.empty((SAMPLE_SIZE if kept.shape[0] > 0 else STATE_SIZE, _BLOCK + CACHE_LINE))
    state, sums = np.empty(STATE_SIZE), np.empty(_SUMS)
    # Not a 0 in the calls: for a constant numba would compile the engine once more.
    beginning = int(tally[CONTACT_TIME])
    for run in range(packed.shape[0]):
        q = packed[run]
        x, y, ending = rest_position(q)
        if ending != FOUND:
            table[run, _STATUS] = _NO_EQUILIBRIUM
            continue
        substeps = substeps_needed(q, interval, interval)
        propagators(q, interval / substeps, flow)
        state[0], state[1], state[2], state[3] = x, y - starts[run] * (q[L_PRE] - y), 0.0, 0.0
        ended = DONE
        for first in range(0, settling, _BLOCK):
            part = columns.T[: min(_BLOCK, settling - first)]
            ended, _ = advance_any(state, q, flow, substeps, w, tally, events, part, beginning)
            if ended != DONE:
                break
        tally[:] = 0.0
        sums[:] = 0.0
        sums[_FIRST_PASSAGE] = np.nan
        previous = x
        for first in range(0, samples, _BLOCK):
            if ended != DONE:
                break
            part = columns.T[: min(_BLOCK, samples - first)]
            ended, _ = advance_any(state, q, flow, substeps, w, tally, events, part, beginning)
            if kept.shape[0] > 0 and ended == DONE:
                kept[run, first : first + part.shape[0]] = part
            _add_block(columns[X, : len(part)], columns[Y, : len(part)], first, x, y, previous, sums)
            previous = columns[X, len(part) - 1]
        table[run, _STATUS] = ended
        if ended == DONE:
            _finish(sums, tally, samples, interval, table[run])


_STATUS = _COLUMNS.index("status")
# Running sums of one run: peaks and squares of x and y, passages of x, and the regression of the logarithm of each
# block's mean square: number, sums of its index i, of i^2, of the logarithm, and of their product.
_PEAK_X, _PEAK_Y, _SQUARE_X, _SQUARE_Y, _FIRST_PASSAGE, _LAST_PASSAGE, _PASSAGES = range(7)
_BLOCKS, _INDEX, _INDEX_2, _LOG, _INDEX_LOG = range(7, 12)
_SUMS = 12


@reduction_kernel
def _add_block(xs: Vector, ys: Vector, first: int, x0: float, y0: float, previous: float, sums: Vector) -> None:
    """Add one block of samples x, y (n,), the first of which has index `first`; `previous` is the x before it."""
    square_x, square_y = 0.0, 0.0
    peak_x, peak_y = sums[_PEAK_X], sums[_PEAK_Y]
    # As in `columns.widen`: most blocks have no new peak.
    beyond = 0
    for i in range(len(xs)):
        x, y = xs[i] - x0, ys[i] - y0
        square_x += x * x
        square_y += y * y
        beyond += int(abs(x) > peak_x) + int(abs(y) > peak_y)
    if beyond > 0:
        for i in range(len(xs)):
            peak_x, peak_y = max(peak_x, abs(xs[i] - x0)), max(peak_y, abs(ys[i] - y0))
        sums[_PEAK_X], sums[_PEAK_Y] = peak_x, peak_y
    before = previous - x0
    for i in range(len(xs)):
        x = xs[i] - x0
        if before < 0.0 <= x:
            sums[_LAST_PASSAGE] = first + i - x / (x - before)
            if sums[_PASSAGES] == 0.0:
                sums[_FIRST_PASSAGE] = sums[_LAST_PASSAGE]
            sums[_PASSAGES] += 1.0
        before = x
    sums[_SQUARE_X] += square_x
    sums[_SQUARE_Y] += square_y
    if len(xs) == _BLOCK and square_x + square_y > 0.0:
        index = first / _BLOCK
        logarithm = math.log(square_x + square_y)
        sums[_BLOCKS] += 1.0
        sums[_INDEX] += index
        sums[_INDEX_2] += index * index
        sums[_LOG] += logarithm
        sums[_INDEX_LOG] += index * logarithm


@kernel
def _finish(sums: Vector, tally: Vector, samples: int, interval: float, row: Vector) -> None:
    """One run's sums as its row of the table."""
    row[0], row[1] = sums[_PEAK_X], sums[_PEAK_Y]
    row[2], row[3] = math.sqrt(sums[_SQUARE_X] / samples), math.sqrt(sums[_SQUARE_Y] / samples)
    if sums[_PASSAGES] >= 2.0:
        row[4] = (sums[_PASSAGES] - 1.0) / ((sums[_LAST_PASSAGE] - sums[_FIRST_PASSAGE]) * interval)
    n = sums[_BLOCKS]
    spread = n * sums[_INDEX_2] - sums[_INDEX] ** 2
    if spread > 0.0:
        slope = (n * sums[_INDEX_LOG] - sums[_INDEX] * sums[_LOG]) / spread
        row[5] = 0.5 * slope / (_BLOCK * interval)
    row[6] = samples * interval - tally[CONTACT_TIME]
    row[7] = tally[CONTACT_TIME] / (samples * interval)
    row[8] = tally[SEPARATIONS]
