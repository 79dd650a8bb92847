"""The branch of squeal cycles from its known end, the flutter threshold, over its fold, for one parameter."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from squeal_rig.model.core.layout import L_PRE
from squeal_rig.model.core.statics import FOUND, rest_position
from squeal_rig.model.cycles.path import PAD_STIFFNESS, Path
from squeal_rig.model.cycles.shooting import PERIOD, Orbit, Shooter
from squeal_rig.model.cycles.threshold import flutter_friction, flutter_stiffness, threshold_mode
from squeal_rig.model.cycles.tracing import COARSE, FOLD, Trace, trace

# Share of the touching amplitude at which a branch is begun.
_BEGIN = 0.97
_POINTS = 600
# In the pad stiffness the branch is followed down to this share of its flutter threshold.
_SOFTEST = 1e-3
# Share of the threshold that a branch may lie before it for its numbers alone.
_BACK = 1e-9


@dataclass
class HardBranch:
    """A branch from the flutter threshold on: `threshold` and `fold` in the parameter, nan where there is none; the
    orbits of the branch at the rig's own value, the last found of each kind; why something is missing.
    """

    threshold: float
    fold: float = math.nan
    fold_orbit: Orbit | None = None
    squeal: Orbit | None = None
    separatrix: Orbit | None = None
    reason: str = ""
    found: Trace | None = None

    @property
    def is_soft(self) -> bool:
        """Whether the branch goes from its threshold to larger values and was followed there: no squeal before it."""
        return self.found is not None and min(o.parameter for o in self.found.orbits) >= self.threshold * (1.0 - _BACK)


def shooter_at(path: Path, value: float, period: float, span: float) -> Shooter:
    """A shooter with the units of the path's rig at a value of its parameter."""
    q = path.packed(value)
    _, y, ending = rest_position(q)
    size = q[L_PRE] - y if ending == FOUND else q[L_PRE]
    return Shooter(path, float(size), 2.0 * math.pi / period, span)


def threshold_of(path: Path) -> float:
    """The flutter threshold in mu0 or in the pad stiffness that lies on the side of the path's rig; nan if none."""
    if path.field != PAD_STIFFNESS:
        return flutter_friction(path)
    low, high = flutter_stiffness(path)
    if math.isfinite(high) and (not math.isfinite(low) or path.value > 0.5 * (low + high)):
        return high
    return low


def hard_branch(path: Path, low: float, high: float) -> HardBranch:
    """The branch in mu0 or pad_stiffness from its flutter threshold, to the fold and up to the path's own value.

    `low` and `high` bound the parameter.
    """
    threshold = threshold_of(path)
    branch = HardBranch(threshold)
    if not math.isfinite(threshold):
        branch.reason = (
            f"no {path.field} within its bounds makes the equilibrium flutter: there is no end to start from"
        )
        return branch
    if not low <= threshold <= high:
        branch.reason = f"the flutter threshold {path.field} = {threshold:.6g} lies outside {low:.6g} to {high:.6g}"
        return branch
    if path.field == PAD_STIFFNESS:
        low = max(low, min(_SOFTEST * threshold, path.value))
    unknowns, mode = threshold_mode(path, threshold, _BEGIN)
    shooter = shooter_at(path, threshold, float(unknowns[PERIOD]), abs(threshold))
    tangent = mode / shooter.scale
    tangent /= np.linalg.norm(tangent)
    start, _ = shooter.close(unknowns, tangent)
    if start is None:
        branch.reason = f"no orbit closes at the flutter threshold {path.field} = {threshold:.6g}"
        return branch
    value = path.value

    def passed(found: Trace) -> bool:
        # Over the fold and back at the rig's own value: both cycles are known there.
        folds = [s.orbit for s in found.specials if s.kind == FOLD]
        before, after = found.orbits[-2], found.orbits[-1]
        # A fold between the last two points is a point of its own: both sides of it may lie within one step.
        fresh = folds[-1] if folds and folds[-1] is not seen[-1] else None
        stretches = [(before, after)] if fresh is None else [(fresh, before), (fresh, after)]
        seen.append(fresh or seen[-1])
        for near, far in stretches:
            orbit = _crossing(shooter, near, far, value, near is fresh)
            if orbit is None:
                continue
            # Past the fold it is the squeal cycle, also where that has become unstable in its turn.
            if orbit.stable or (folds and far is after):
                branch.squeal = orbit
            else:
                branch.separatrix = orbit
        if not folds:
            return branch.squeal is not None
        inside = (folds[0].parameter - value) * (threshold - folds[0].parameter) <= 0.0
        return branch.squeal is not None or not inside

    seen: list[Orbit | None] = [None]
    found = trace(shooter, start, tangent, low, high, _POINTS, COARSE, passed)
    branch.found = found
    if branch.squeal is not None:
        branch.squeal = shooter.on_section(branch.squeal)
    if branch.separatrix is not None:
        branch.separatrix = shooter.on_section(branch.separatrix)
    folds = [s.orbit for s in found.specials if s.kind == FOLD]
    if folds:
        branch.fold_orbit = folds[0]
        branch.fold = folds[0].parameter
    else:
        branch.reason = f"the branch from the flutter threshold has no fold: {found.sentence}"
    return branch


def _crossing(shooter: Shooter, near: Orbit, far: Orbit, value: float, from_fold: bool) -> Orbit | None:
    """The orbit at a value of the parameter between two neighbours on a branch, None where it is not between them.

    From a fold on, the motion goes with the square root of the parameter's distance.
    """
    apart = far.parameter - near.parameter
    share = (value - near.parameter) / apart if apart != 0.0 else -1.0
    if not (0.0 <= share <= 1.0 and far.separates):
        return None
    along = math.sqrt(share) if from_fold else share
    orbit = shooter.close_at(near.unknowns + along * (far.unknowns - near.unknowns), value)
    return orbit if orbit is not None and orbit.separates else None


def fold_below(path: Path, orbit: Orbit) -> float:
    """The fold that the branch through an orbit of the path's rig comes to towards smaller values; nan if none."""
    shooter = shooter_at(path, path.value, orbit.period, path.value or 1.0)
    start = shooter.close_at(orbit.unknowns, path.value)
    down = None if start is None else shooter.tangent(start, np.array([0.0, 0.0, 0.0, 0.0, 0.0, -1.0]))
    if start is None or down is None:
        return math.nan

    def folded(found: Trace) -> bool:
        return any(s.kind == FOLD for s in found.specials)

    low = max(path.lower, _SOFTEST * path.value)
    found = trace(shooter, start, down, low, path.upper, _POINTS, COARSE, folded)
    return next((s.orbit.parameter for s in found.specials if s.kind == FOLD), math.nan)
