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

import numpy as np
from numpy.typing import ArrayLike, NDArray

from squeal_rig.configuration.declared import checked, declarations
from squeal_rig.errors import ParameterError
from squeal_rig.model.core.dynamics import Vector
from squeal_rig.model.linear.point import FIELDS, fill_points
from squeal_rig.model.linear.roots import Roots
from squeal_rig.model.linear.stability import stability_band
from squeal_rig.model.parameters import RigParameters

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
            the slip or only one direction is damped: there `stability_band` searches point by point, some ms each.
        eigenvalues: keep all four eigenvalues of each point.
        threads: how many work at once; one a core when None. The result does not depend on it.
        grids: numeric fields of `RigParameters`, and `pad_stiffness` for k1 and k2 at once, that broadcast to one
            shape.

    Raises:
        ParameterError: a field that is unknown or has no part in the linear model, a value out of its bounds, or
            shapes that do not broadcast.
    """
    arrays = _checked_grids(grids)
    try:
        shape = np.broadcast_shapes(*(values.shape for values in arrays.values()))
    except ValueError:
        shapes = ", ".join(f"{name} {values.shape}" for name, values in arrays.items())
        raise ParameterError(f"these shapes do not broadcast to one grid: {shapes}") from None
    points = math.prod(shape)
    out = np.full((5, points), np.nan)
    values = np.empty((points if eigenvalues else 0, 4), dtype=np.complex128)
    base = np.array([getattr(p, name) for name in FIELDS])
    varied = np.array([FIELDS.index(name) for name in arrays], dtype=np.int64)
    switches = (p.friction_direction == "slip", p.friction_speed == "slip", p.preload_direction == "arms")
    spread = [np.broadcast_to(array, shape) for array in arrays.values()]

    def work(first: int) -> None:
        part = slice(first, min(first + _CHUNK, points))
        columns = np.empty((len(spread), part.stop - part.start))
        for row, array in zip(columns, spread, strict=True):
            row[:] = array.flat[part]
        fill_points(base, varied, columns, switches, bands, out[:, part], values[part])

    with ThreadPoolExecutor(os.cpu_count() or 1 if threads is None else threads) as pool:
        list(pool.map(work, range(0, points, _CHUNK)))
    if bands:
        _search_bands(p, arrays, shape, out)
    growth, frequency, lower, upper, margin = (row.reshape(shape) for row in out)
    kept = values.reshape((*shape, 4)) if eigenvalues else None
    return StabilityMap(growth, frequency, lower, upper, margin, kept)


def _checked_grids(grids: Mapping[str, ArrayLike]) -> dict[str, Vector]:
    """The grids as arrays by field name, every value within its declared bounds."""
    known = declarations(RigParameters)
    arrays: dict[str, Vector] = {}
    for name, given in grids.items():
        names = ("k1", "k2") if name == "pad_stiffness" else (name,)
        if names[0] not in FIELDS:
            raise ParameterError(
                f"{name!r} is not a parameter of a stability map: those are {', '.join((*FIELDS, 'pad_stiffness'))}"
            )
        try:
            array: NDArray[np.float64] = np.asarray(given, dtype=np.float64)
        except (TypeError, ValueError):
            raise ParameterError(f"{name} = {given!r} is not an array of numbers") from None
        bounds = known[names[0]]
        wrong = ~((array >= bounds.lower) & (array <= bounds.upper))
        if wrong.any():
            checked(bounds, float(array[wrong].flat[0]))
        arrays.update(dict.fromkeys(names, array))
    return arrays


def _search_bands(p: RigParameters, arrays: Mapping[str, Vector], shape: tuple[int, ...], out: Vector) -> None:
    """Fill the bounds that have no closed form."""
    spread = {name: np.broadcast_to(array, shape) for name, array in arrays.items()}
    for point in np.flatnonzero(out[2] == -1.0):
        here = p.replace(**{name: float(array.flat[point]) for name, array in spread.items()})
        lower, upper = stability_band(here)
        out[2, point], out[3, point] = lower, upper
        out[4, point] = (lower - 0.5 * (here.k1 + here.k2)) / lower if lower > 0.0 else np.nan
