"""One squeal cycle of a rig: found by Newton's method on the exact flow, or a sentence why there is none."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from squeal_rig.errors import ModelError
from squeal_rig.model.core.layout import SAMPLE_SIZE, STATE_SIZE, VX, Vector, sample_room
from squeal_rig.model.core.statics import equilibrium
from squeal_rig.model.cycles import flow
from squeal_rig.model.cycles.border import hard_branch, shooter_at
from squeal_rig.model.cycles.path import Path, refuse_what_has_no_cycles
from squeal_rig.model.cycles.shooting import PERIOD, UNKNOWNS, Orbit, Shooter
from squeal_rig.model.cycles.threshold import growth
from squeal_rig.model.cycles.verdict import LEFT, QUIET, judge
from squeal_rig.model.motion.propagator import fastest_rate
from squeal_rig.model.motion.trajectory import Motion, checked_state, displaced_state, validity_warnings
from squeal_rig.model.parameters import RigParameters

#: Endings of a search for a cycle.
FOUND = "found"
DIES_OUT = "dies out"
LONGER = "period longer than one"
QUASI_PERIODIC = "quasi-periodic"
LEFT_BOUNDS = "left every bound"

_STATES = 256
# Starts that are tried, in static compressions towards the belt: of a rig quiet at rest, and of one that is not.
_HARD_STARTS, _SOFT_START = (3.0, 1.0, 10.0), (0.1, 3.0)
# Newton's method is tried after so many periods, ever more; it is taken where it ends near the motion it began from.
_TRIES, _FIRST_TRY, _LATER = 12, 100, 1.7
_NEAR = 0.3
_LONGEST_PERIOD = 16
_RETURN = 1e-4
_SAMPLES_PER_PERIOD = 48


@dataclass(frozen=True)
class SquealCycle:
    """A cycle in which the pad leaves the belt, or the reason why there is none.

    - ending: one of "found", "dies out", "period longer than one", "quasi-periodic", "left every bound"; and a
      sentence. Without a cycle every number is nan and the arrays are empty.
    - period [s], frequency [Hz]; state (4,) x, y, vx, vy [m, m/s] at the maximum of x, where vx = 0
    - states (n, 4) at times (n,) [s] over one period, from that state on
    - multipliers: complex (4,), 1 and those of the return map, the largest first; stable where these are all below 1
    - off_belt_share: share of the period off the belt
    - peak_x, peak_y [m]: largest displacement from the static equilibrium
    - closing_error: |z(T) - z(0)| in units of u; flow_error: |M f - f|/|f|; volume_error: det M against Liouville's
      formula, relative. All three are zero in exact arithmetic.
    - warnings: what of the printed model does not hold on the cycle.
    """

    ending: str
    sentence: str
    period: float = math.nan
    frequency: float = math.nan
    state: Vector = field(default_factory=lambda: np.empty(0))
    states: Vector = field(default_factory=lambda: np.empty((0, 4)))
    times: Vector = field(default_factory=lambda: np.empty(0))
    multipliers: NDArray[np.complex128] = field(default_factory=lambda: np.empty(0, dtype=np.complex128))
    stable: bool = False
    off_belt_share: float = math.nan
    peak_x: float = math.nan
    peak_y: float = math.nan
    closing_error: float = math.nan
    flow_error: float = math.nan
    volume_error: float = math.nan
    warnings: tuple[str, ...] = ()

    @property
    def found(self) -> bool:
        return self.ending == FOUND


def squeal_cycle(p: RigParameters, start: SquealCycle | ArrayLike | None = None) -> SquealCycle:
    """The squeal cycle of a rig.

    Args:
        p: parameters; damped, with friction of constant direction and belt speed.
        start: a cycle or a state (x, y, vx, vy) [m, m/s] to begin from: Newton's method is tried there first, so a
            start near an unstable cycle finds that; else the motion from it is followed until it settles. None: the
            cycle on the branch that begins at the flutter threshold in mu0; where that has none that is stable, what
            the motion settles on from 0.1 to 10 static compressions towards the belt.

    Raises:
        ModelError: the rig is refused (friction that sees the slip, no damping), or has no equilibrium in contact.
        ParameterError: the start is no state.
    """
    refuse_what_has_no_cycles(p)
    path = Path(p, "mu0")
    if start is None:
        branch = hard_branch(path, path.lower, path.upper)
        if branch.squeal is not None and branch.squeal.stable:
            return cycle_of(path, branch.squeal)
        quiet = growth(path.packed(path.value)) < 0.0
        found = SquealCycle(DIES_OUT, "the motion dies out")
        for compressions in _HARD_STARTS if quiet else _SOFT_START:
            found = _settled(path, displaced_state(p, compressions))
            if found.ending not in (DIES_OUT, LEFT_BOUNDS):
                break
        return found
    if isinstance(start, SquealCycle):
        if not start.found:
            return squeal_cycle(p)
        guess = np.array([*start.state, start.period, path.value])
        orbit = shooter_at(path, path.value, start.period, 1.0).close_at(guess, path.value)
        if orbit is not None and orbit.separates:
            return cycle_of(path, orbit)
        return _settled(path, start.state)
    state = checked_state(start)
    shooter, guess = _passages(path, state, 2)
    if shooter is not None:
        orbit = _closed_near(shooter, guess[0], path.value)
        if orbit is not None and orbit.separates:
            return cycle_of(path, orbit)
    return _settled(path, state)


def cycle_of(path: Path, orbit: Orbit) -> SquealCycle:
    """The public record of a closed orbit, its states computed anew."""
    shooter = shooter_at(path, orbit.parameter, orbit.period, 1.0)
    states = np.empty((_STATES, 4))
    again = shooter.on_section(orbit, states)
    q = path.packed(orbit.parameter)
    period = orbit.period
    samples = np.zeros((_STATES, SAMPLE_SIZE))
    samples[:, :4] = states
    samples[0, VX] = again.tally[flow.FASTEST]
    kind = "stable" if again.stable else "unstable"
    return SquealCycle(
        FOUND,
        f"a {kind} cycle at {1.0 / period:.6g} Hz, off the belt for {100.0 * again.off_belt_share:.4g} % of its period",
        period,
        1.0 / period,
        np.array(again.state),
        states,
        np.arange(_STATES, dtype=np.float64) * (period / _STATES),
        again.multipliers,
        again.stable,
        again.off_belt_share,
        float(again.tally[flow.PEAK_X]),
        float(again.tally[flow.PEAK_Y]),
        float(np.abs(again.closing).max()),
        again.flow_error,
        again.volume_error(q),
        tuple(validity_warnings(path.rig(orbit.parameter), samples)),
    )


def _passages(path: Path, state: Vector, count: int) -> tuple[Shooter | None, Vector]:
    """A shooter in the units of the motion from a state, and its next passages of the section as unknowns
    (count, 6) with the time to the one after; None where it does not come round.
    """
    q = path.packed(path.value)
    rate = fastest_rate(q)
    z, v, w = state.copy(), np.zeros((4, flow.COLUMNS)), np.zeros((flow.ROWS, flow.ORDER + 1))
    rows, latest = np.empty((count, UNKNOWNS)), 100.0 / rate
    for i in range(count + 1):
        took = flow.to_section(z, v, q, flow.RATE_TIMES_STEP / rate, latest, w, np.zeros(flow.TALLY_SIZE))
        if not took <= latest:
            return None, rows
        if i > 0:
            rows[i - 1, PERIOD] = took
        if i < count:
            rows[i] = z[0], z[1], z[2], z[3], 0.0, path.value
    return shooter_at(path, path.value, float(rows[0, PERIOD]), 1.0), rows


def _closed_near(shooter: Shooter, guess: Vector, value: float) -> Orbit | None:
    """The closed orbit that Newton's method reaches from a guess without leaving its neighbourhood."""
    orbit = shooter.close_at(guess, value)
    if orbit is None:
        return None
    size = float(np.abs(guess[:4] / shooter.scale[:4]).max())
    moved = float(np.abs((orbit.unknowns - guess) / shooter.scale).max())
    return orbit if moved <= _NEAR * max(size, 1.0) else None


def _settled(path: Path, state: Vector) -> SquealCycle:
    """What the motion from a state settles on."""
    p = path.p
    judged = None
    if growth(path.packed(path.value)) < 0.0:
        judged = judge(p)
        verdict = int(judged.verdicts(state[None])[0][0])
        if verdict == QUIET:
            return SquealCycle(
                DIES_OUT, "the motion dies out: in contact, its coming maximum stays below the separation"
            )
        if verdict == LEFT:
            return SquealCycle(LEFT_BOUNDS, "the motion leaves the range of displacements in which the model holds")
    rate = fastest_rate(path.packed(path.value))
    sample_rate = _SAMPLES_PER_PERIOD * rate / (2.0 * math.pi)
    motion = Motion(p, sample_rate, state)
    far = 0.01 * min(p.arm_length_1, p.arm_length_2)
    periods = float(_FIRST_TRY)
    for _ in range(_TRIES):
        block = sample_room(int(periods) * _SAMPLES_PER_PERIOD, STATE_SIZE)
        try:
            motion.advance(block)
        except ModelError as error:
            return SquealCycle(LEFT_BOUNDS, str(error))
        state = motion.state
        if not float(np.abs(state[:2]).max()) <= far:
            return SquealCycle(LEFT_BOUNDS, "the motion leaves the range of displacements in which the model holds")
        shooter, passages = _passages(path, state, 2)
        if shooter is not None:
            # A cycle may have several maxima of x: as many passages as it takes are one period.
            for turns in (1, 2, 3):
                orbit = _closed_near(shooter, _joined(path, state, turns), path.value)
                if orbit is not None and orbit.stable and orbit.separates:
                    orbit = _shortest(shooter, orbit, turns)
                    several = orbit.period > 1.5 * float(passages[0, PERIOD])
                    if several and orbit.tally[flow.EVENTS] >= 2.0 * turns:
                        return SquealCycle(
                            LONGER, f"the motion repeats after {turns} turns, at {turns / orbit.period:.6g} Hz"
                        )
                    return cycle_of(path, orbit)
        periods *= _LATER
    return _irregular(path, state)


def _shortest(shooter: Shooter, orbit: Orbit, turns: int) -> Orbit:
    """The orbit of one turn, where one of several is that repeated."""
    once = orbit.unknowns.copy()
    once[PERIOD] /= turns
    single = shooter.orbit(once) if turns > 1 else None
    if single is not None and float(np.abs(single.closing).max()) < 1e-6:
        return shooter.close_at(once, orbit.parameter) or orbit
    return orbit


def _joined(path: Path, state: Vector, turns: int) -> Vector:
    """The next passage of the section as a guess of an orbit that takes a number of turns."""
    _, rows = _passages(path, state, turns + 1)
    guess = np.array(rows[0])
    guess[PERIOD] = rows[:turns, PERIOD].sum()
    return guess


def _irregular(path: Path, state: Vector) -> SquealCycle:
    """The ending of a motion that stays and on which no cycle of one period was found."""
    shooter, rows = _passages(path, state, 4 * _LONGEST_PERIOD)
    if shooter is None:
        x, y = equilibrium(path.p)
        return SquealCycle(DIES_OUT, f"the motion no longer turns about ({x:.4g}, {y:.4g}) m")
    points = rows[:, :4] / shooter.scale[:4]
    size = max(1.0, float(np.ptp(points, axis=0).max()))
    for turns in range(2, _LONGEST_PERIOD + 1):
        if float(np.abs(points[turns:] - points[:-turns]).max()) <= _RETURN * size:
            mean = turns / float(rows[:turns, PERIOD].sum())
            return SquealCycle(LONGER, f"the motion repeats after {turns} turns, at {mean:.6g} Hz each")
    return SquealCycle(
        QUASI_PERIODIC,
        f"the motion stays and does not repeat within {_LONGEST_PERIOD} turns: a torus, an irregular motion, or a"
        " transient too slow to wait for",
    )
