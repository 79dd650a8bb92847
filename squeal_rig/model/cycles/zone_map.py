"""Zones and smallest hits over grids of parameters, by interpolating both borders in what they hardly depend on.

With the arms linear, every motion scales with u and the borders in mu depend on the machine alone. What the arms'
rotation adds, r/L of their force, makes both borders smooth functions of the preload: each is computed at a few
Chebyshev nodes of the preload for each machine, interpolated by the polynomial through them, and held against a value
in between. Likewise the smallest hit over m omega u is a function of the machine and of mu, between both borders.
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

from squeal_rig.errors import ModelError, ParameterError
from squeal_rig.model.core.kernel import kernel
from squeal_rig.model.core.law import COEFFICIENTS, friction_law
from squeal_rig.model.core.layout import L_PRE, PACKED_SIZE, Vector, checked_arrays, packed_columns
from squeal_rig.model.core.statics import FOUND, rest_position
from squeal_rig.model.cycles.border import HardBranch, hard_branch
from squeal_rig.model.cycles.hits import smallest_hit
from squeal_rig.model.cycles.path import Path, refuse_what_has_no_cycles
from squeal_rig.model.cycles.zones import zone
from squeal_rig.model.linear.maps import FIELDS
from squeal_rig.model.parameters import RigParameters

#: Codes of a map of zones.
UNKNOWN, NOT_IN_CONTACT, QUIET, BISTABLE, SQUEAL = -2, -1, 0, 1, 2
NAMES = {
    UNKNOWN: "not known",
    NOT_IN_CONTACT: "no equilibrium in contact",
    QUIET: "quiet",
    BISTABLE: "bistable",
    SQUEAL: "squeal",
}
# Fields that move mu and u but not the machine.
_OPERATING = (*COEFFICIENTS, "preload", "belt_speed")
_NODES, _HIT_NODES = 3, 17
_MOST_MACHINES = 100_000


@dataclass(frozen=True)
class ZoneMap:
    """Zones over a grid; arrays of the grid's shape.

    - zone: -1 no equilibrium in contact, 0 quiet, 1 bistable, 2 squeal (`NAMES`); -2 where a border was not found,
      for one of `reasons`, and `zone` says different things over the range of mu
    - mu, fold_mu, flutter_mu: friction coefficient, and both borders in it; nan where there is none
    - smallest_hit [N s]: of the best direction; 0 where the rig squeals, nan where no hit does it, or
      where a border is not known; None unless asked for
    - border_error: largest difference, in mu, of an interpolated border from one solved for; hit_error: of a hit from
      one searched for, as a share
    - reasons: why a border is missing, with how many machines it is so for
    """

    zone: NDArray[np.int8]
    mu: Vector
    fold_mu: Vector
    flutter_mu: Vector
    smallest_hit: Vector | None
    border_error: float
    hit_error: float
    reasons: dict[str, int]


@dataclass
class _Machine:
    """Both borders of one machine in mu, at the nodes of the preload; the scaled hit over the share between them."""

    fold: Vector
    flutter: Vector
    elsewhere: int  # zone of points that neither border tells
    border_error: float
    shares: Vector
    hit: Vector
    hit_error: float
    reason: str


def zone_map(p: RigParameters, hits: bool = False, threads: int | None = None, **grids: ArrayLike) -> ZoneMap:
    """Zones over a grid of parameters.

    Args:
        p: what the grids leave as it is.
        hits: the smallest hit of each point as well, in the best direction; about a second more for each machine.
        threads: how many machines are worked on at once; one a core when None. The result does not depend on it.
        grids: numeric fields of the linear model, and `pad_stiffness` for k1 and k2 at once, that broadcast to one
            shape. Each combination of values other than of the friction law, preload and speed is a new machine and
            costs some 80 ms.

    Raises:
        ModelError: the rig is refused (friction that sees the slip, no damping).
        ParameterError: a field, a value or the shapes are wrong.
    """
    refuse_what_has_no_cycles(p)
    arrays, shape = checked_arrays(grids, FIELDS, "a zone map")
    spread = {name: np.broadcast_to(values, shape).ravel() for name, values in arrays.items()}
    points = math.prod(shape)
    values: dict[str, Any] = {**p.as_mapping(), **spread}
    mu = np.broadcast_to(friction_law(values, values["belt_speed"], values["preload"]), points).astype(np.float64)
    preload = np.broadcast_to(values["preload"], points)
    names = [name for name in spread if name not in _OPERATING]
    table = np.column_stack([spread[name] for name in names]) if names else np.zeros((points, 0))
    unique, which = (
        np.unique(table, axis=0, return_inverse=True) if names else (np.zeros((1, 0)), np.zeros(points, int))
    )
    which = np.ravel(which)
    if len(unique) > _MOST_MACHINES:
        raise ParameterError(f"{len(unique)} machines are out of bounds: at most {_MOST_MACHINES} in one map")
    low, high = float(preload.min()), float(preload.max())
    rigs = [p.replace(**dict(zip(names, row.tolist(), strict=True))) for row in unique]
    with ThreadPoolExecutor(threads or os.cpu_count() or 1) as pool:
        ranges = [(float(mu[which == i].min()), float(mu[which == i].max())) for i in range(len(rigs))]
        machines = list(pool.map(lambda rig, span: _machine(rig, low, high, hits, span), rigs, ranges))
    fold, flutter = np.full(points, math.nan), np.full(points, math.nan)
    scaled, elsewhere = np.full(points, math.nan), np.full(points, QUIET, dtype=np.int8)
    for i, machine in enumerate(machines):
        mine = which == i
        fold[mine] = _polynomial(machine.fold, low, high, preload[mine])
        flutter[mine] = _polynomial(machine.flutter, low, high, preload[mine])
        elsewhere[mine] = machine.elsewhere
        if hits and len(machine.shares):
            share = (mu[mine] - fold[mine]) / (flutter[mine] - fold[mine])
            scaled[mine] = _monotone(machine.shares, machine.hit, share)
    compression = _compressions(values, points)
    zones = _between(mu, fold, flutter, elsewhere)
    zones[~np.isfinite(compression)] = NOT_IN_CONTACT
    smallest = None
    if hits:
        smallest = np.where(zones == SQUEAL, 0.0, np.where(zones == BISTABLE, scaled * compression, math.nan)).reshape(
            shape
        )
    reasons: dict[str, int] = {}
    for machine in machines:
        if machine.reason:
            reasons[machine.reason] = reasons.get(machine.reason, 0) + 1
    return ZoneMap(
        zones.reshape(shape),
        mu.reshape(shape),
        fold.reshape(shape),
        flutter.reshape(shape),
        smallest,
        max((m.border_error for m in machines), default=0.0),
        max((m.hit_error for m in machines), default=0.0),
        reasons,
    )


def _between(mu: Vector, fold: Vector, flutter: Vector, elsewhere: NDArray[np.int8]) -> NDArray[np.int8]:
    """Zone of each point (n,) between its borders; `elsewhere` where one of them is not known, up to flutter."""
    zones = np.full(len(mu), QUIET, dtype=np.int8)
    zones[mu >= fold] = BISTABLE
    unbounded = ~np.isfinite(fold) | ~np.isfinite(flutter)
    zones[unbounded] = elsewhere[unbounded]
    zones[mu >= flutter] = SQUEAL
    return zones


def _machine(rig: RigParameters, low: float, high: float, hits: bool, span: tuple[float, float]) -> _Machine:
    """Both borders at the nodes of the preload, held against the middle between two; `span` is the range of mu."""
    nodes = _chebyshev(low, high)
    branches = [_branch(rig, preload) for preload in nodes.tolist()]
    fold, flutter = (np.array([getattr(b, name) for b in branches]) for name in ("fold", "threshold"))
    reason = next((b.reason for b in branches if b.reason), "")
    error = 0.0
    if len(nodes) > 1:
        between = 0.5 * (nodes[0] + nodes[1])
        held = _branch(rig, between)
        for values, value in ((fold, held.fold), (flutter, held.threshold)):
            off = abs(float(_polynomial(values, low, high, np.array([between]))[0]) - value)
            error = max(error, off if math.isfinite(off) else 0.0)
    shares, hit, hit_error = np.empty(0), np.empty(0), 0.0
    middle = branches[len(branches) // 2]
    if hits and math.isfinite(middle.fold) and middle.fold < middle.threshold:
        preload = float(nodes[len(nodes) // 2])
        # Closer together towards both borders, where the hit changes fastest.
        shares = 0.5 - 0.5 * np.cos(np.pi * (np.arange(_HIT_NODES) + 0.5) / _HIT_NODES)
        hit = np.array([_scaled_hit(rig, preload, middle, s) for s in shares.tolist()])
        seen = np.isfinite(hit)
        shares, hit = shares[seen], hit[seen]
        if len(shares) >= 4:
            for i in (0, len(shares) // 2, len(shares) - 2):
                between = 0.5 * (shares[i] + shares[i + 1])
                guess = float(_monotone(shares, hit, np.array([between]))[0])
                hit_error = max(hit_error, abs(guess / _scaled_hit(rig, preload, middle, float(between)) - 1.0))
        shares, hit = np.append(shares, 1.0), np.append(hit, 0.0)
    elsewhere = QUIET
    if not (np.isfinite(fold).all() and np.isfinite(flutter).all()) and not all(b.is_soft for b in branches):
        # Beyond flutter the border itself tells.
        end = float(np.nanmin(flutter)) if np.isfinite(flutter).any() else math.inf
        elsewhere = _zone_over(rig, 0.5 * (low + high), (span[0], min(span[1], max(span[0], end * (1.0 - 1e-6)))))
    return _Machine(fold, flutter, elsewhere, error, shares, hit, hit_error, reason)


def _at(rig: RigParameters, preload: float) -> Path:
    """The rig with the friction law replaced by mu0 alone, so that the path's parameter is mu itself."""
    return Path(rig.replace(**{**dict.fromkeys(COEFFICIENTS, 0.0), "preload": preload}), "mu0")


def _branch(rig: RigParameters, preload: float) -> HardBranch:
    path = _at(rig, preload)
    try:
        return hard_branch(path, path.lower, path.upper)
    except ModelError as error:
        return HardBranch(math.nan, reason=str(error))


def _zone_over(rig: RigParameters, preload: float, span: tuple[float, float]) -> int:
    """Zone of a machine over a range of mu where `zone` says the same of both ends and the middle, else `UNKNOWN`."""
    codes = {name: code for code, name in NAMES.items()}
    try:
        found = {zone(_at(rig, preload).rig(mu)).name for mu in np.linspace(*span, 3).tolist()}
    except (ModelError, ParameterError):  # a mu beyond the bounds of mu0
        return UNKNOWN
    return codes[found.pop()] if len(found) == 1 else UNKNOWN


def _scaled_hit(rig: RigParameters, preload: float, branch: HardBranch, share: float) -> float:
    """Smallest hit over u [N s/m] at a share of the way from the fold to the flutter threshold."""
    mu = branch.fold + share * (branch.threshold - branch.fold)
    at = _at(rig, preload).rig(mu)
    found = smallest_hit(at, beyond=1.0)
    compression = _compressions(vars(at), 1)[0]
    return found.impulse / float(compression) if found.found else math.nan


def _chebyshev(low: float, high: float) -> Vector:
    if low == high:
        return np.array([low])
    nodes = np.cos(np.pi * (2.0 * np.arange(_NODES) + 1.0) / (2.0 * _NODES))
    return np.asarray(0.5 * (low + high) + 0.5 * (high - low) * nodes)


def _polynomial(values: Vector, low: float, high: float, at: Vector) -> Vector:
    """The polynomial through values at the nodes, at preloads (n,)."""
    nodes = _chebyshev(low, high)
    result = np.zeros(len(at))
    for i, value in enumerate(values):
        weight = np.full(len(at), float(value))
        for j, node in enumerate(nodes):
            if j != i:
                weight *= (at - node) / (nodes[i] - node)
        result += weight
    return result


def _monotone(at: Vector, values: Vector, wanted: Vector) -> Vector:
    """Monotone cubic interpolation (Fritsch and Carlson, SIAM J. Numer. Anal. 17, 1980); nan outside."""
    from scipy.interpolate import PchipInterpolator

    return np.asarray(PchipInterpolator(at, values, extrapolate=False)(wanted))


def _compressions(values: Mapping[str, Any], points: int) -> Vector:
    """u = N*/k_c [m] of each point; nan without an equilibrium in contact."""
    packed = np.empty((points, PACKED_SIZE))
    for column, value in packed_columns(values).items():
        packed[:, column] = value
    found = np.empty(points)
    _fill_compressions(packed, found)
    return found


@kernel
def _fill_compressions(packed: Vector, found: Vector) -> None:
    for i in range(found.shape[0]):
        _, y, ending = rest_position(packed[i])
        found[i] = packed[i, L_PRE] - y if ending == FOUND else math.nan
