"""The three zones: quiet whatever happens, quiet until hit, squeal by itself; and how far their borders are."""

from __future__ import annotations

import math
from dataclasses import dataclass

from squeal_rig.model.core.law import friction_coefficient
from squeal_rig.model.core.statics import equilibrium
from squeal_rig.model.cycles.border import HardBranch, fold_below, hard_branch
from squeal_rig.model.cycles.cycle import FOUND, LONGER, QUASI_PERIODIC, SquealCycle, cycle_of, squeal_cycle
from squeal_rig.model.cycles.path import PAD_STIFFNESS, Path, refuse_what_has_no_cycles
from squeal_rig.model.cycles.shooting import Orbit
from squeal_rig.model.cycles.threshold import growth
from squeal_rig.model.parameters import RigParameters

QUIET, BISTABLE, SQUEAL = "quiet", "bistable", "squeal"


@dataclass(frozen=True)
class Zone:
    """Zone of an operating point, and both borders in the friction coefficient and in the mean arm stiffness [N/m].

    - name: "quiet" (no hit starts squeal that lasts), "bistable" (quiet until hit), "squeal" (by itself)
    - fold_*: border between quiet and bistable; flutter_*: between bistable and squeal, as the eigenvalues have it; nan
      where there is none, which `reasons` tell
    - to_*: from the border to the operating point; positive beyond it. In k where flutter ends at the border, not
      begins, beyond it is below it: then the sign is that of the zone.
    - squeal, separatrix: the cycles there, of which the second divides quiet from squeal; None where they are not.
    """

    name: str
    mu: float
    fold_mu: float
    flutter_mu: float
    pad_stiffness: float
    fold_pad_stiffness: float
    flutter_pad_stiffness: float
    squeal: SquealCycle | None
    separatrix: SquealCycle | None
    reasons: tuple[str, ...]

    @property
    def to_fold_mu(self) -> float:
        return self.mu - self.fold_mu

    @property
    def to_flutter_mu(self) -> float:
        return self.mu - self.flutter_mu

    @property
    def to_fold_pad_stiffness(self) -> float:
        return self._towards * (self.pad_stiffness - self.fold_pad_stiffness)

    @property
    def to_flutter_pad_stiffness(self) -> float:
        return self._towards * (self.pad_stiffness - self.flutter_pad_stiffness)

    @property
    def _towards(self) -> float:
        return -1.0 if self.fold_pad_stiffness > self.flutter_pad_stiffness else 1.0

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True, repr=False)
class Located:
    """A zone and the closed orbits it rests on."""

    zone: Zone
    squeal: Orbit | None
    separatrix: Orbit | None


def zone(p: RigParameters) -> Zone:
    """Zone of an operating point with the distances to both borders.

    The flutter border is where an eigenvalue at the exact equilibrium begins to grow. The other one is the fold of
    the branch of cycles that begins there, followed in mu0 and in the pad stiffness (k1 and k2 at their ratio, down
    to a thousandth of the flutter threshold). Where no friction within its bounds makes the rig flutter, the branch
    in the pad stiffness decides, and without one motions from 1 to 10 static compressions. Squeal on branches that
    no flutter threshold belongs to is not excluded by "quiet".

    Raises:
        ModelError: the rig is refused (friction that sees the slip, no damping), or has no equilibrium in contact.
    """
    return located(p).zone


def cycles_of(p: RigParameters) -> tuple[Orbit | None, Orbit | None]:
    """Squeal cycle and separatrix at an operating point, of the branch in mu0, or in the pad stiffness without one."""
    path = Path(p, "mu0")
    branch = hard_branch(path, path.lower, path.upper)
    if not _tells(branch):
        path = Path(p, PAD_STIFFNESS)
        branch = hard_branch(path, path.lower, path.upper)
    return branch.squeal, branch.separatrix


def _tells(in_mu: HardBranch) -> bool:
    """Whether the branch in mu0 tells the zone; without a flutter threshold it is that in the pad stiffness."""
    return in_mu.squeal is not None or math.isfinite(in_mu.threshold)


def located(p: RigParameters) -> Located:
    """`zone` with its orbits."""
    refuse_what_has_no_cycles(p)
    equilibrium(p)
    in_mu, in_k = Path(p, "mu0"), Path(p, PAD_STIFFNESS)
    mu = hard_branch(in_mu, in_mu.lower, in_mu.upper)
    k = hard_branch(in_k, in_k.lower, in_k.upper)
    reasons = [f"in {name}: {branch.reason}" for name, branch in (("mu", mu), ("k", k)) if branch.reason]
    fold_in_k = k.fold
    if mu.squeal is not None and not math.isfinite(k.fold):
        # No flutter threshold at this friction, yet squeal: its branch in k has a fold all the same.
        fold_in_k = fold_below(in_k, mu.squeal)
    unstable = growth(in_mu.packed(in_mu.value)) > 0.0
    path, branch = (in_mu, mu) if _tells(mu) else (in_k, k)
    cycle = None if branch.squeal is None else cycle_of(path, branch.squeal)
    endless = False
    if (not cycle.stable) if cycle is not None else unstable or not math.isfinite(branch.threshold):
        settled = squeal_cycle(p)
        if settled.ending != FOUND:
            reasons.append(f"no stable cycle: {settled.sentence}")
        endless = settled.ending in (LONGER, QUASI_PERIODIC)
        if settled.found:
            cycle = settled
        elif not endless:
            cycle = None
    name = SQUEAL if unstable else BISTABLE if cycle is not None or endless else QUIET
    separatrix = branch.separatrix if name == BISTABLE else None
    friction = friction_coefficient(p)
    offset = friction - in_mu.value
    found = Zone(
        name,
        friction,
        mu.fold + offset,
        mu.threshold + offset,
        in_k.value,
        fold_in_k,
        k.threshold,
        cycle,
        None if separatrix is None else cycle_of(path, separatrix),
        tuple(reasons),
    )
    return Located(found, branch.squeal, separatrix)
