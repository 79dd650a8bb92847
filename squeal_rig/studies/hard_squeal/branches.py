"""The branch of squeal cycles of one rig along one of its parameters, with all that a diagram of it shows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from squeal_rig.errors import ModelError, ParameterError
from squeal_rig.model.core.law import friction_refusal
from squeal_rig.model.core.layout import K_C, L_PRE, pack
from squeal_rig.model.core.statics import equilibrium
from squeal_rig.model.cycles.branch import Branch, follow_cycle
from squeal_rig.model.cycles.cycle import SquealCycle, squeal_cycle
from squeal_rig.model.cycles.path import PAD_STIFFNESS, Path
from squeal_rig.model.cycles.threshold import growth
from squeal_rig.model.cycles.tracing import BOUND, LOST
from squeal_rig.model.cycles.zone_map import BISTABLE, NOT_IN_CONTACT, QUIET, SQUEAL
from squeal_rig.model.cycles.zones import Zone, zone
from squeal_rig.model.parameters import RigParameters

Values = NDArray[np.float64]

# Without a range: so far beyond the flutter threshold, and in other fields so many times less and more.
_BEYOND, _TIMES = 1.25, 4.0
_GRID = 801


@dataclass(frozen=True)
class Diagram:
    """A branch, and what stands beside it.

    - rig, zone: the rig that was asked for and its zone; `begun_at` is the value of the field at which the branch was
      begun: the rig's own, or one between both borders where the rig itself has no cycle
    - branches: that of the squeal cycle, and that of the separatrix where both do not meet within the range
    - cycles: those at `begun_at`
    - values (n,), zones (n,): zone codes of `zone_map` over the part of the field that the branch tells of
    """

    rig: RigParameters
    zone: Zone
    field: str
    branches: tuple[Branch, ...]
    begun_at: float
    cycles: list[SquealCycle]
    values: Values
    zones: NDArray[np.int64]

    @property
    def rig_of_cycles(self) -> RigParameters:
        """The rig at `begun_at`."""
        return self.rig_at(self.begun_at)

    def rig_at(self, value: float) -> RigParameters:
        """The rig at a value of the field."""
        return Path(self.rig, self.field).rig(value)

    def kind_of(self, cycle: SquealCycle) -> str:
        """What one of `cycles` is: "squeal", the "separatrix" beside it, or another "unstable" one."""
        if cycle.stable:
            return "squeal"
        code = self.zones[int(np.argmin(np.abs(self.values - self.begun_at)))]
        return "separatrix" if code == BISTABLE else "unstable"


def branch_diagram(p: RigParameters, field: str, bounds: tuple[float, float] | None = None) -> Diagram:
    """Follow the squeal cycle of a rig along a field, both ways.

    Args:
        p: the rig.
        field: numeric field of `RigParameters`, or "pad_stiffness".
        bounds: of the field, with the rig's own value between them; None: up to a quarter beyond the flutter threshold
            or the rig's value in mu0 and pad_stiffness, from a quarter to four times the rig's value in other fields.

    Raises:
        ModelError: the rig is refused (friction that sees the slip, no damping), or there is no cycle to follow.
        ParameterError: the field or the bounds are wrong, or the friction law gives a negative coefficient.
    """
    path = Path(p, field)
    path.bounds(bounds)
    refusal = friction_refusal(p)
    if refusal:
        raise ParameterError(refusal)
    at_rig = zone(p)
    begun = _begun(path, at_rig)
    cycle = at_rig.squeal if begun is path and at_rig.squeal is not None else squeal_cycle(begun.p)
    if not cycle.found:
        why = "; ".join((cycle.sentence, *at_rig.reasons))
        raise ModelError(f"there is no squeal cycle to follow in {field}: {why}")
    chosen = bounds or _default_bounds(begun, at_rig, path.value)
    branches = [follow_cycle(begun.p, cycle, field, chosen)]
    cycles = branches[0].cycles_at(begun.value)
    separatrix = at_rig.separatrix if begun is path else None
    if separatrix is not None and not any(_same(separatrix, known) for known in cycles):
        branches.append(follow_cycle(p, separatrix, field, chosen))
        cycles += [new for new in branches[1].cycles_at(begun.value) if not any(_same(new, known) for known in cycles)]
    values, zones = _zones_along(path, branches)
    return Diagram(p, at_rig, field, tuple(branches), begun.value, cycles, values, zones)


def _same(one: SquealCycle, other: SquealCycle) -> bool:
    return abs(one.frequency / other.frequency - 1.0) < 1e-7 and abs(one.peak_x / other.peak_x - 1.0) < 1e-6


def _begun(path: Path, at_rig: Zone) -> Path:
    """The path's rig where it has a squeal cycle, else, in a field whose borders are known, half way between them."""
    if at_rig.squeal is not None:
        return path
    if path.field == "mu0":
        half_way = 0.5 * (at_rig.fold_mu + at_rig.flutter_mu) - at_rig.mu + path.value
    elif path.field == PAD_STIFFNESS:
        half_way = 0.5 * (at_rig.fold_pad_stiffness + at_rig.flutter_pad_stiffness)
    else:
        return path
    return Path(path.rig(half_way), path.field) if math.isfinite(half_way) else path


def _default_bounds(path: Path, at_rig: Zone, own: float) -> tuple[float, float]:
    if path.field == "mu0":
        shift = own - at_rig.mu
        highest = np.nanmax([at_rig.flutter_mu, at_rig.mu, path.value - shift])
        return path.lower, min(path.upper, _BEYOND * float(highest) + shift)
    if path.field == PAD_STIFFNESS:
        highest = np.nanmax([at_rig.flutter_pad_stiffness, own, path.value])
        return path.lower, min(path.upper, _BEYOND * float(highest))
    if own == 0.0:
        return path.lower, path.upper
    ends = sorted((own / _TIMES, own * _TIMES))
    return max(path.lower, ends[0]), min(path.upper, ends[1])


def _zones_along(path: Path, branches: Sequence[Branch]) -> tuple[Values, NDArray[np.int64]]:
    """Zone codes over the field: of the equilibrium's growth, and of whether a stable cycle of a branch is there.

    Where the branches stop at a bound or are lost, nothing is known beyond.
    """
    reached = np.concatenate([branch.points["parameter"] for branch in branches])
    low, high = float(reached.min()), float(reached.max())
    room = 0.1 * (high - low)
    open_ends = [end.parameter for branch in branches for end in branch.ends if end.how in (BOUND, LOST)]
    if low not in open_ends:
        low = max(path.lower, min(low, path.value) - room)
    if high not in open_ends:
        high = min(path.upper, max(high, path.value) + room)
    values = np.linspace(low, high, _GRID)
    covered = np.zeros(_GRID, dtype=np.bool_)
    for branch in branches:
        at, stable = branch.points["parameter"], branch.points["stable"]
        for a, b, both in zip(at[:-1], at[1:], stable[:-1] & stable[1:], strict=True):
            if both:
                covered |= (values >= min(a, b)) & (values <= max(a, b))
    rates = np.array([growth(path.packed(value)) for value in values.tolist()])
    zones = np.where(covered, BISTABLE, QUIET)
    zones[rates > 0.0] = SQUEAL
    zones[~np.isfinite(rates)] = NOT_IN_CONTACT
    return values, zones


def normal_force(p: RigParameters, states: Values) -> Values:
    """Contact force [N] (n,) of states (n, 4): k_c (L_pre - y), nothing where the pad is off the belt."""
    q = pack(p)
    return np.asarray(np.maximum(q[K_C] * (q[L_PRE] - states[:, 1]), 0.0))


def from_rest(p: RigParameters, states: Values) -> Values:
    """Displacements (n, 2) [m] of states (n, 4) from the static equilibrium."""
    return np.asarray(states[:, :2] - np.array(equilibrium(p)))
