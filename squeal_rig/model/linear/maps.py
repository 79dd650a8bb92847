"""Stability over grids of parameters, millions of points at a time.

The model is the linear one, Eqs. (3.1), (3.2): contact kept, geometry to first order about r = 0. Its stiffness
does not depend on where the equilibrium lies (with friction that sees the slip its damping does, through N at the
linear equilibrium), so nothing has to be solved by iteration. `eigenvalues(p)` without `linear=True` differs by the
arms' rotation at the exact equilibrium, 1e-5 to 1e-4 of lambda at the preset.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from squeal_rig.configuration.declared import declarations
from squeal_rig.model.core.kernel import kernel
from squeal_rig.model.core.layout import K1, K2, PACKED_SIZE, Vector, checked_arrays, packed_columns
from squeal_rig.model.linear.bounds import bound_at_rest, fill_linear_roots, fill_rest_roots, stability_bounds
from squeal_rig.model.linear.roots import Roots, leading_root
from squeal_rig.model.parameters import RigParameters

#: Parameters of a map: the numeric ones that have a part in the linear model.
FIELDS = tuple(
    name
    for name, declaration in declarations(RigParameters).items()
    if declaration.kind is float and not name.startswith("arm_length")
)
_CHUNK = 8192


@dataclass(frozen=True)
class StabilityMap:
    """Stability over a grid; arrays of the grid's shape, SI units.

    - growth_rate [1/s]: largest Re lambda
    - squeal_frequency [Hz]: |Im lambda|/2pi of that eigenvalue where any grows (Re lambda > 1e-6 |lambda|), else nan
    - critical_pad_stiffness, upper_pad_stiffness [N/m]: as `stability_band`, nan where no stiffness is unstable
    - margin: (k_cr - k)/k_cr with k = (k1 + k2)/2, nan where there is no k_cr
    - eigenvalues [rad/s]: one axis of 4 more, in no order; None unless asked for
    """

    growth_rate: Vector
    squeal_frequency: Vector
    critical_pad_stiffness: Vector
    upper_pad_stiffness: Vector
    margin: Vector
    eigenvalues: Roots | None


def stability_map(
    p: RigParameters,
    bands: bool = True,
    eigenvalues: bool = False,
    threads: int | None = None,
    **grids: ArrayLike,
) -> StabilityMap:
    """Stability of the linear model over a grid of parameters.

    Args:
        p: what the grids leave as it is, switches included.
        bands: fill k_cr, its upper bound and the margin. They are roots of quadratics except where friction sees
            the slip or only one direction is damped: there each point is a search of its own.
        eigenvalues: keep all four eigenvalues of each point.
        threads: how many work at once; one a core when None. The result does not depend on it.
        grids: numeric fields of `RigParameters`, and `pad_stiffness` for k1 and k2 at once, that broadcast to one
            shape.

    Raises:
        ParameterError: a field that is unknown or has no part in the linear model, a value out of its bounds, or
            shapes that do not broadcast.
    """
    arrays, _ = checked_arrays(grids, FIELDS, "a stability map")
    return map_points({**p.as_mapping(), **arrays}, bands, eigenvalues, threads)


def map_points(
    values: Mapping[str, Any],
    bands: bool = True,
    eigenvalues: bool = False,
    threads: int | None = None,
    at_rest: bool = False,
) -> StabilityMap:
    """`stability_map` of the values of all fields by name, numbers and arrays that broadcast; nothing is checked.

    With `at_rest` the model is linearised about the exact equilibrium of each point; nan where there is none, and no
    upper bound of the unstable range is known.
    """
    varied = {name: value for name, value in values.items() if np.ndim(value)}
    shape = np.broadcast_shapes(*(np.shape(value) for value in varied.values()))
    points = math.prod(shape)
    out = np.full((5, points), np.nan)
    kept = np.full((points if eigenvalues else 0, 4), np.nan, dtype=np.complex128)
    spread = {name: np.broadcast_to(value, shape) for name, value in varied.items()}

    def work(first: int) -> None:
        part = slice(first, min(first + _CHUNK, points))
        columns = packed_columns({**values, **{name: array.flat[part] for name, array in spread.items()}})
        base, changing = np.zeros(PACKED_SIZE), [column for column, value in columns.items() if np.ndim(value)]
        for column, value in columns.items():
            base[column] = 0.0 if np.ndim(value) else value
        rows = np.empty((len(changing), part.stop - part.start))
        for row, column in zip(rows, changing, strict=True):
            row[:] = columns[column]
        _fill_points(base, np.array(changing, dtype=np.int64), rows, at_rest, bands, out[:, part], kept[part])

    workers = min(os.cpu_count() or 1 if threads is None else threads, -(-points // _CHUNK))
    if workers <= 1:
        for first in range(0, points, _CHUNK):
            work(first)
    else:
        with ThreadPoolExecutor(workers) as pool:
            list(pool.map(work, range(0, points, _CHUNK)))
    growth, frequency, lower, upper, margin = (row.reshape(shape) for row in out)
    found = kept.reshape((*shape, 4)) if eigenvalues else None
    return StabilityMap(growth, frequency, lower, upper, margin, found)


@kernel
def _fill_points(
    base: Vector, changing: NDArray[np.int64], rows: Vector, at_rest: bool, bands: bool, out: Vector, kept: Roots
) -> None:
    """Fill `out` (5, n) with growth rate, frequency, k_cr, upper bound and margin, and `kept` (n or 0, 4) with
    eigenvalues, of packed parameters `base` with `rows` (v, n) in the columns `changing` (v,).
    """
    q, roots = base.copy(), np.empty(4, dtype=np.complex128)
    for i in range(out.shape[1]):
        for j in range(changing.shape[0]):
            q[changing[j]] = rows[j, i]
        found = True
        if at_rest:
            found = fill_rest_roots(q, roots)
        else:
            fill_linear_roots(q, roots)
        if found:
            growth, omega, grows = leading_root(roots)
            out[0, i], out[1, i] = growth, omega / (2.0 * math.pi) if grows else math.nan
            if kept.shape[0] > 0:
                kept[i] = roots
        if bands:
            if at_rest:
                out[2, i] = bound_at_rest(q, roots)
            else:
                out[2, i], out[3, i] = stability_bounds(q, roots)
            if out[2, i] > 0.0:
                out[4, i] = (out[2, i] - 0.5 * (q[K1] + q[K2])) / out[2, i]
