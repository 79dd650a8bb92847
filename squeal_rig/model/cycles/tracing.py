"""A branch of closed orbits point by point: pseudo-arclength steps, folds and other bifurcations, how it ends."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from squeal_rig.model.core.layout import L_PRE, Vector
from squeal_rig.model.cycles import flow
from squeal_rig.model.cycles.shooting import PARAMETER, Orbit, Shooter
from squeal_rig.model.cycles.threshold import growth

#: How an end of a branch comes about.
FLUTTER, BOUND, GRAZING, LOST, CLOSED = "flutter threshold", "bound", "grazing", "lost", "closed"
#: Kinds of special points.
FOLD, PERIOD_DOUBLING, NEIMARK_SACKER = "fold", "period doubling", "Neimark-Sacker"
_FIRST_STEP, _SHORTEST = 0.05, 1e-6
#: Longest step of a branch that is to be shown: wiggles of its own size are not stepped over. And of one whose border
#: alone is asked for.
FINE, COARSE = 0.2, 0.5
# Share of the longest step that is taken at a fold, and of the steepest slope along the parameter below which steps
# get shorter.
_SLOWEST, _STEEP = 0.4, 0.3
# Across a special point no step is longer than this.
_CROSSING = 0.15
# Of the angle between two tangents the cosine may not fall below this: else the step is halved.
_STRAIGHT = 0.9
_REFINEMENTS = 30
# Threshold and branch are the same value of the parameter within this share.
_SAME_THRESHOLD = 1e-4
# A fold is one where the tangent's part along the parameter is below this; how often a search for one doubles its step.
_AT_FOLD, _SEARCH = 1e-10, 6


@dataclass
class Special:
    """A fold or another bifurcation on a branch."""

    kind: str
    orbit: Orbit


@dataclass
class Trace:
    """Points of a branch from its start in one direction, what lies on it, and how it ended."""

    orbits: list[Orbit]
    specials: list[Special] = field(default_factory=list)
    end: str = LOST
    sentence: str = ""


def trace(
    shooter: Shooter,
    start: Orbit,
    tangent: Vector,
    low: float,
    high: float,
    points: int,
    longest: float,
    until: Callable[[Trace], bool] | None = None,
) -> Trace:
    """Follow the branch from a closed orbit along a tangent (6,) in scaled units.

    Args:
        low, high: bounds of the parameter; the branch ends on them.
        points: at most.
        longest: step, in scaled units.
        until: asked after each point; True ends the branch there.
    """
    start.tangent = tangent
    found = Trace([start])
    step, before = _FIRST_STEP, 0.0
    left = start.separates
    origin, away, steepest = _shape(start, shooter), False, abs(fold_test(start))
    while len(found.orbits) < points:
        last = found.orbits[-1]
        row = last.tangent
        assert row is not None
        # Slower where the branch is about to turn round: two folds close together are not stepped over.
        steepest = max(steepest, abs(fold_test(last)))
        if steepest > 0.0:
            step = min(step, longest * max(_SLOWEST, min(1.0, abs(fold_test(last)) / (_STEEP * steepest))))
        ahead = step * row
        if before > 0.0:
            bend = row - _tangent_of(found.orbits[-2])
            ahead = ahead + 0.5 * step * (step / before) * bend
        orbit, iterations = shooter.close(last.unknowns + ahead * shooter.scale, row)
        new = shooter.tangent(orbit, row) if orbit is not None else None
        if orbit is None or new is None or not float(new @ row) > _STRAIGHT:
            step *= 0.5
            if step < _SHORTEST:
                found.sentence = (
                    f"Newton's method finds no next orbit within {_SHORTEST:g} of the one at"
                    f" {shooter.path.field} = {last.parameter:.6g}"
                )
                return found
            continue
        orbit.tangent = new
        chord = float(np.linalg.norm((orbit.unknowns - last.unknowns) / shooter.scale))
        if chord > _CROSSING and step > _CROSSING and _crosses(last, orbit):
            step = _CROSSING
            continue
        if not low <= orbit.parameter <= high:
            bound = low if orbit.parameter < low else high
            at_bound = shooter.close_at(_between(last, orbit, bound), bound)
            if at_bound is not None:
                at_bound.tangent = shooter.tangent(at_bound, row)
                if at_bound.tangent is not None:
                    _add(found, at_bound, shooter)
            found.end, found.sentence = BOUND, f"the branch reaches {shooter.path.field} = {bound:.6g}, its bound"
            return found
        if left and not orbit.separates and not _nearly_touches(orbit, shooter) and step > _SHORTEST:
            step *= 0.5  # it fell through to a smaller motion, or to rest
            continue
        _add(found, orbit, shooter)
        before = chord
        left = left or orbit.separates
        if left and not orbit.separates:
            found.end, found.sentence = _linear_end(shooter, orbit)
            return found
        here = _shape(orbit, shooter)
        distance = float(np.linalg.norm(here - origin))
        away = away or distance > 3.0 * longest
        onward = (here - _shape(last, shooter)) @ (_shape(found.orbits[1], shooter) - origin)
        if away and distance < 0.6 * step and onward > 0.0:
            found.end, found.sentence = CLOSED, "the branch comes back to where it began"
            return found
        if until is not None and until(found):
            found.sentence = "the branch was followed as far as was asked"
            return found
        if iterations <= 3:
            step = min(1.8 * step, longest)
        elif iterations >= 5:
            step *= 0.6
    found.sentence = f"the branch goes on after {points} points"
    return found


def _shape(orbit: Orbit, shooter: Shooter) -> Vector:
    """What an orbit is whatever state of it is taken: peaks, period and parameter, in scaled units."""
    peaks = orbit.tally[[flow.PEAK_X, flow.PEAK_Y]] / shooter.scale[0]
    return np.concatenate([peaks, orbit.unknowns[4:] / shooter.scale[4:]])


def _tangent_of(orbit: Orbit) -> Vector:
    assert orbit.tangent is not None
    return orbit.tangent


def _nearly_touches(orbit: Orbit, shooter: Shooter) -> bool:
    """Whether a motion that stays on the belt comes more than half way to leaving it."""
    edge, rest = shooter.path.packed(orbit.parameter)[L_PRE], orbit.tally[flow.Y0]
    return bool(orbit.tally[flow.HIGHEST] - rest > 0.5 * (edge - rest))


def _between(first: Orbit, second: Orbit, value: float) -> Vector:
    """Unknowns on the straight line between two orbits at a value of the parameter."""
    share = (value - first.parameter) / (second.parameter - first.parameter)
    return np.asarray(first.unknowns + share * (second.unknowns - first.unknowns))


def _linear_end(shooter: Shooter, orbit: Orbit) -> tuple[str, str]:
    """How a branch ends that no longer leaves the belt: in the linear mode where an eigenvalue stands on the axis."""
    rate, omega = growth(shooter.path.packed(orbit.parameter)), 2.0 * math.pi / orbit.period
    where = f"{shooter.path.field} = {orbit.parameter:.8g}"
    if abs(rate) <= _SAME_THRESHOLD * omega:
        return FLUTTER, f"at {where} the motion no longer leaves the belt: it is the linear mode at its threshold"
    return GRAZING, f"at {where} the motion no longer leaves the belt, and no eigenvalue stands on the imaginary axis"


def _add(found: Trace, orbit: Orbit, shooter: Shooter) -> None:
    """Add a point, and what lies between it and the last one."""
    last = found.orbits[-1]
    for kind in _crosses(last, orbit):
        test = _TESTS[kind]
        special = locate(shooter, last, orbit, test, test(last), test(orbit))
        if special is not None:
            found.specials.append(Special(kind, special))
    found.orbits.append(orbit)


def _crosses(first: Orbit, second: Orbit) -> list[str]:
    """Kinds of special points between two neighbours."""
    if not (first.separates and second.separates):
        return []
    return [kind for kind, test in _TESTS.items() if test(first) * test(second) < 0.0]


def fold_test(orbit: Orbit) -> float:
    """The tangent's part along the parameter: zero where the branch turns round."""
    assert orbit.tangent is not None
    return float(orbit.tangent[PARAMETER])


def _doubling_test(orbit: Orbit) -> float:
    """det(P + I), zero at a multiplier -1."""
    return float(np.prod(1.0 + orbit.multipliers[1:]).real)


def _torus_test(orbit: Orbit) -> float:
    """|mu|^2 - 1 of the complex pair; nan where there is none."""
    pair = [m for m in orbit.multipliers[1:] if abs(m.imag) > 1e-7]
    return abs(pair[0]) ** 2 - 1.0 if pair else math.nan


_TESTS: dict[str, Callable[[Orbit], float]] = {
    FOLD: fold_test,
    PERIOD_DOUBLING: _doubling_test,
    NEIMARK_SACKER: _torus_test,
}


def locate(
    shooter: Shooter, first: Orbit, second: Orbit, test: Callable[[Orbit], float], before: float, after: float
) -> Orbit | None:
    """The orbit between two at which a test function is zero: the secant method along the branch, kept within.

    Each trial is a closed orbit on a plane across the first one's tangent, so the zero is one of the extended system
    of closure and test.
    """
    row = first.tangent
    assert row is not None
    start = first.unknowns / shooter.scale
    low, high = 0.0, float(row @ (second.unknowns / shooter.scale - start))
    f_low, f_high = before, after
    known = [first, second]
    best: Orbit | None = None
    side = 0
    for _ in range(_REFINEMENTS):
        along = low - f_low * (high - low) / (f_high - f_low)
        a, b = known[0].unknowns, known[1].unknowns
        share = (along - low) / (high - low)
        orbit, _ = shooter.close(a + share * (b - a), row, float(row @ start) + along)
        if orbit is None:  # from the nearer end, then
            near = known[0] if share < 0.5 else known[1]
            orbit, _ = shooter.close(near.unknowns, row, float(row @ start) + along)
        if orbit is None:
            return best
        orbit.tangent = shooter.tangent(orbit, row)
        if orbit.tangent is None:
            return best
        best, f = orbit, test(orbit)
        if not math.isfinite(f) or abs(f) <= 1e-11:
            break
        # Illinois: an end that stays has its value halved, so both close in.
        if f * f_low > 0.0:
            low, f_low, known[0] = along, f, orbit
            f_high = 0.5 * f_high if side == 1 else f_high
            side = 1
        else:
            high, f_high, known[1] = along, f, orbit
            f_low = 0.5 * f_low if side == -1 else f_low
            side = -1
        if abs(high - low) <= 1e-10:
            break
    return best


def fold_near(shooter: Shooter, guess: Orbit) -> Orbit | None:
    """The fold near an orbit that was one of another rig; None where there is none near."""
    row = guess.tangent
    if row is None:
        return None
    first, _ = shooter.close(guess.unknowns, row)
    if first is None or not first.separates:
        return None
    first.tangent = shooter.tangent(first, row)
    if first.tangent is None:
        return None
    if abs(fold_test(first)) <= _AT_FOLD:
        return first
    # The tangent's part along the parameter changes by about its own size per unit of the way.
    step = _FIRST_STEP
    for way in (1.0, -1.0):
        before = first
        for n in range(_SEARCH):
            assert before.tangent is not None
            length = way * step * 2.0**n
            second, _ = shooter.close(before.unknowns + length * before.tangent * shooter.scale, before.tangent)
            tangent = None if second is None else shooter.tangent(second, before.tangent)
            if second is None or tangent is None or not second.separates:
                break
            second.tangent = tangent
            if fold_test(before) * fold_test(second) <= 0.0:
                return locate(shooter, before, second, fold_test, fold_test(before), fold_test(second))
            if abs(fold_test(second)) > abs(fold_test(before)) and n > 0:
                break
            before = second
    return None
