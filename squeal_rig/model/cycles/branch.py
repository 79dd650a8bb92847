"""Branches of cycles in one parameter, and their folds in two."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from squeal_rig.errors import ModelError, ParameterError
from squeal_rig.model.core.layout import Vector
from squeal_rig.model.core.statics import equilibrium
from squeal_rig.model.cycles import flow
from squeal_rig.model.cycles.border import hard_branch, shooter_at
from squeal_rig.model.cycles.cycle import SquealCycle, cycle_of, squeal_cycle
from squeal_rig.model.cycles.path import PAD_STIFFNESS, Path, refuse_what_has_no_cycles
from squeal_rig.model.cycles.shooting import PARAMETER, PERIOD, Orbit, Shooter
from squeal_rig.model.cycles.tracing import CLOSED, FINE, FOLD, Trace, fold_near, trace
from squeal_rig.model.parameters import RigParameters

_POINTS = 1000
POINT = np.dtype(
    [
        ("parameter", np.float64),
        ("frequency", np.float64),
        ("peak_x", np.float64),
        ("peak_y", np.float64),
        ("off_belt_share", np.float64),
        ("largest_multiplier", np.float64),
        ("stable", np.bool_),
        ("state", np.float64, (4,)),
        ("multipliers", np.complex128, (4,)),
        ("flow_error", np.float64),
        ("volume_error", np.float64),
    ]
)


@dataclass(frozen=True)
class SpecialPoint:
    """A point at which the branch turns round or its stability changes: "fold", "period doubling" or
    "Neimark-Sacker"; at the parameter, with its frequency [Hz] and its multipliers, complex (4,).
    """

    kind: str
    parameter: float
    frequency: float
    multipliers: NDArray[np.complex128]
    state: Vector


@dataclass(frozen=True)
class BranchEnd:
    """How an end of a branch came about: "flutter threshold", "bound", "grazing", "lost" or "closed"; a sentence; and
    where: the parameter and the frequency [Hz].
    """

    how: str
    sentence: str
    parameter: float
    frequency: float


@dataclass(frozen=True)
class Branch:
    """A branch of cycles in one parameter.

    - points: records (dtype `POINT`) along the branch from its first end to its second: parameter, frequency [Hz],
      peak_x, peak_y [m] from the static equilibrium, off_belt_share, largest_multiplier (modulus, besides 1), stable,
      state on the section [m, m/s], multipliers, and the errors of `SquealCycle`
    - specials: folds, period doublings and Neimark-Sacker points on the way; `folds` alone
    - ends: of the branch, in the order of the points
    """

    field: str
    points: NDArray[np.void]
    specials: tuple[SpecialPoint, ...]
    ends: tuple[BranchEnd, BranchEnd]
    _path: Path = dataclasses.field(repr=False, compare=False)

    @property
    def folds(self) -> tuple[SpecialPoint, ...]:
        return tuple(special for special in self.specials if special.kind == FOLD)

    def cycles_at(self, value: float) -> list[SquealCycle]:
        """The cycles of the branch at a value of the parameter, in the order of the points."""
        found = []
        along = self.points["parameter"] - value
        # A point on the value itself counts once.
        for i in np.flatnonzero((along[:-1] * along[1:] < 0.0) | (along[:-1] == 0.0)):
            a, b = _unknowns(self.points[i]), _unknowns(self.points[i + 1])
            apart = b[PARAMETER] - a[PARAMETER]
            guess = a + ((value - a[PARAMETER]) / apart if apart != 0.0 else 0.0) * (b - a)
            orbit = shooter_at(self._path, value, guess[PERIOD], 1.0).close_at(guess, value)
            if orbit is not None:
                found.append(cycle_of(self._path, orbit))
        return found


def follow_cycle(
    p: RigParameters, cycle: SquealCycle, field: str, bounds: tuple[float, float] | None = None, points: int = _POINTS
) -> Branch:
    """Follow a cycle of a rig both ways along one of its parameters.

    Args:
        p: the rig of the cycle.
        cycle: where to begin; of `squeal_cycle`, `Branch.cycles_at` or `zone`.
        field: any numeric field of `RigParameters`, or "pad_stiffness": the mean of k1 and k2 at their ratio.
        bounds: of the field; its own, and mu >= 0, when None.
        points: at most, each way.

    Raises:
        ModelError: the rig is refused (friction that sees the slip, no damping), or the cycle is none of this rig.
        ParameterError: the field or the bounds are wrong.
    """
    refuse_what_has_no_cycles(p)
    path = Path(p, field)
    low, high = path.bounds(bounds)
    if not 2 <= points <= 1_000_000:
        raise ParameterError(f"points = {points} is out of bounds: it must be 2 to 1000000")
    if not cycle.found:
        raise ModelError(f"there is no cycle to follow: {cycle.sentence}")
    shooter, start, tangent = _started(path, cycle)
    forth = trace(shooter, start, tangent, low, high, points, FINE)
    back = Trace([start], [], CLOSED, forth.sentence)
    if forth.end != CLOSED:
        start.tangent = None
        back = trace(shooter, start, -tangent, low, high, points, FINE)
    return _branch_of(shooter, back, forth)


def _started(path: Path, cycle: SquealCycle) -> tuple[Shooter, Orbit, Vector]:
    """A shooter in the units of a cycle, its orbit, and the branch's direction towards larger values."""
    unknowns = np.array([*cycle.state, cycle.period, path.value])
    shooter = shooter_at(path, path.value, cycle.period, max(abs(path.value), 1e-30))
    orbit = shooter.close_at(unknowns, path.value)
    if orbit is None:
        raise ModelError(f"the cycle at {cycle.frequency:.6g} Hz is none of this rig: it does not close")
    up = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    tangent = shooter.tangent(orbit, up)
    if tangent is not None and (path.value == 0.0 or abs(tangent[PARAMETER]) < 1e-6):
        # A field at zero has no scale of its own: that change of it which changes the cycle by its own size.
        shooter = shooter_at(path, path.value, cycle.period, _own_span(shooter, tangent))
        orbit = shooter.close_at(unknowns, path.value)
        tangent = None if orbit is None else shooter.tangent(orbit, up)
    if orbit is None or tangent is None:
        raise ModelError(f"the cycle stands at a singular point in {path.field}: no direction to follow it in")
    orbit.tangent = tangent
    return shooter, orbit, tangent


def _own_span(shooter: Shooter, tangent: Vector) -> float:
    motion = float(np.linalg.norm(tangent[:PARAMETER]))
    return float(shooter.scale[PARAMETER] * abs(tangent[PARAMETER]) / motion) if motion > 0.0 else 1.0


def _branch_of(shooter: Shooter, back: Trace, forth: Trace) -> Branch:
    path, orbits = shooter.path, [*reversed(back.orbits[1:]), *forth.orbits]
    points = np.empty(len(orbits), dtype=POINT)
    for point, orbit in zip(points, orbits, strict=True):
        _fill(point, shooter, orbit)
    specials = [*reversed(back.specials), *forth.specials]
    ends = tuple(
        BranchEnd(part.end, part.sentence, part.orbits[-1].parameter, 1.0 / part.orbits[-1].period)
        for part in (back, forth)
    )
    return Branch(
        path.field,
        points,
        tuple(
            SpecialPoint(
                s.kind, s.orbit.parameter, 1.0 / s.orbit.period, s.orbit.multipliers, shooter.on_section(s.orbit).state
            )
            for s in specials
        ),
        (ends[0], ends[1]),
        path,
    )


def _fill(point: np.void, shooter: Shooter, orbit: Orbit) -> None:
    path = shooter.path
    point["parameter"], point["frequency"] = orbit.parameter, 1.0 / orbit.period
    point["peak_x"], point["peak_y"] = orbit.tally[flow.PEAK_X], orbit.tally[flow.PEAK_Y]
    point["off_belt_share"], point["largest_multiplier"] = orbit.off_belt_share, orbit.largest
    point["stable"], point["state"], point["multipliers"] = (
        orbit.stable,
        shooter.on_section(orbit).state,
        orbit.multipliers,
    )
    point["flow_error"], point["volume_error"] = orbit.flow_error, orbit.volume_error(path.packed(orbit.parameter))


def _unknowns(point: np.void) -> Vector:
    return np.array([*point["state"], 1.0 / point["frequency"], point["parameter"]])


@dataclass(frozen=True)
class FoldCurve:
    """The fold in one field at values of another: arrays (n,), nan where there is none; `reasons` by index."""

    field: str
    over: str
    values: Vector
    fold: Vector
    frequency: Vector
    reasons: dict[int, str]


def fold_curve(p: RigParameters, field: str, over: str, values: ArrayLike) -> FoldCurve:
    """The fold of the squeal cycle in one field over another: the border between quiet and bistable.

    The first value's fold is that of the branch from the flutter threshold ("mu0", "pad_stiffness"), in another field
    of the branch of `squeal_cycle` there; each further one is solved for from the last, by Newton's method and the
    secant method on closure and fold together, in shorter steps of `over` where that fails.

    Args:
        p: what both fields leave as it is.
        field, over: numeric fields of `RigParameters`, or "pad_stiffness".
        values: of `over`, (n,), in the order in which they are to be followed.

    Raises:
        ModelError: the rig is refused (friction that sees the slip, no damping).
        ParameterError: a field is unknown, both are the same, or a value is out of its bounds.
    """
    given = np.atleast_1d(np.asarray(values, dtype=np.float64))
    if given.ndim != 1 or given.size == 0 or not np.isfinite(given).all():
        raise ParameterError(f"values of {over} must be finite numbers, at least one, in one dimension")
    if field == over:
        raise ParameterError(f"the fold in {field} cannot be followed over {over}: they are the same")
    refuse_what_has_no_cycles(p)
    across = Path(p, over)
    Path(p, field)
    fold, frequency = np.full(given.size, math.nan), np.full(given.size, math.nan)
    reasons: dict[int, str] = {}
    last: tuple[Shooter, Orbit, float] | None = None
    for i, value in enumerate(given.tolist()):
        rig = across.rig(value)
        try:
            refuse_what_has_no_cycles(rig)
            equilibrium(rig)
            found = None if last is None else _carried(across, field, last, value, 12)
            if found is None:
                found, reasons[i] = _first_fold(Path(rig, field))
        except ModelError as error:
            found, reasons[i] = None, str(error)
        if found is None:
            last = None
            continue
        reasons.pop(i, None)
        last = (*found, value)
        fold[i], frequency[i] = found[1].parameter, 1.0 / found[1].period
    return FoldCurve(field, over, given, fold, frequency, reasons)


def _first_fold(path: Path) -> tuple[tuple[Shooter, Orbit] | None, str]:
    """The fold of the rig's branch in the path's field, with a shooter in its units; or why there is none."""
    if path.field in ("mu0", PAD_STIFFNESS):
        branch = hard_branch(path, path.lower, path.upper)
        if branch.fold_orbit is None:
            return None, branch.reason
        return (_shooter_of(path, branch.fold_orbit, abs(branch.threshold)), branch.fold_orbit), ""
    cycle = squeal_cycle(path.p)
    if not cycle.found:
        return None, f"no cycle to follow in {path.field}: {cycle.sentence}"
    shooter, start, tangent = _started(path, cycle)
    for way in (tangent, -tangent):
        found = trace(shooter, start, way, path.lower, path.upper, _POINTS, FINE, lambda t: bool(_folds(t)))
        for orbit in _folds(found):
            return (shooter, orbit), ""
    return None, f"the branch in {path.field} has no fold within its bounds"


def _folds(found: Trace) -> Sequence[Orbit]:
    return [special.orbit for special in found.specials if special.kind == FOLD]


def _shooter_of(path: Path, orbit: Orbit, span: float) -> Shooter:
    return shooter_at(path, orbit.parameter, orbit.period, span)


def _carried(
    across: Path, name: str, last: tuple[Shooter, Orbit, float], value: float, halvings: int
) -> tuple[Shooter, Orbit] | None:
    """The fold at another value of `across`, from the fold at the last one."""
    shooter, orbit, at = last
    path = Path(across.rig(value), name)
    # Close by, the motion scales with u about the place where the contact spring is at rest.
    new = _shooter_of(path, orbit, float(shooter.scale[PARAMETER]))
    found = fold_near(new, _rescaled(orbit, shooter, new))
    if found is not None:
        return new, found
    middle = 0.5 * (at + value)
    if halvings == 0 or middle in (at, value):
        return None
    half = _carried(across, name, last, middle, halvings - 1)
    return None if half is None else _carried(across, name, (*half, middle), value, halvings - 1)


def _rescaled(orbit: Orbit, shooter: Shooter, new: Shooter) -> Orbit:
    """The orbit moved to the new equilibrium and scaled by u: exact for linear arms where only u changes."""
    before = np.array([*_rest(shooter.path, orbit.parameter), 0.0, 0.0])
    after = np.array([*_rest(new.path, orbit.parameter), 0.0, 0.0])
    ratio = new.scale[:4] / shooter.scale[:4]
    moved = orbit.unknowns.copy()
    moved[:4] = after + (moved[:4] - before) * ratio
    return dataclasses.replace(orbit, unknowns=moved)


def _rest(path: Path, value: float) -> tuple[float, float]:
    return equilibrium(path.rig(value))
