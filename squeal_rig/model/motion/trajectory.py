"""Trajectories of the nonlinear model, Eq. (2.3): one call, or block by block."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from squeal_rig.errors import ParameterError
from squeal_rig.model.core.forces import fill_forces
from squeal_rig.model.core.layout import SAMPLE_SIZE, STATE_SIZE, VX, Vector, pack, sample_room
from squeal_rig.model.core.statics import equilibrium
from squeal_rig.model.motion import columns, exact, propagator, rk4, stepping
from squeal_rig.model.parameters import RigParameters

ENGINES = ("exact", "rk4")
DEFAULT_ENGINE = "exact"
#: Longest step [s] of the Runge-Kutta engine unless one is asked for: about 1/1000 of a squeal period.
DEFAULT_STEP = 1e-6
#: Share of the shorter arm above which "displacements small against L" no longer holds.
LARGE_DISPLACEMENT = 0.01
_START_COMPRESSIONS = 0.1
_MAX_SAMPLES = 2**31
_LARGE_PAGE = 2**18  # numbers in 2 MB


@dataclass(frozen=True)
class Trajectory:
    """A sampled motion of the pad: float64 arrays (n,), x, y [m], vx, vy [m/s].

    `t` [s] and the forces on the pad [N] follow from these, and are computed when they are first asked for.
    """

    x: Vector
    y: Vector
    vx: Vector
    vy: Vector
    warnings: tuple[str, ...]
    parameters: RigParameters
    sample_rate: float
    first: int = 0  # number of the first sample, which is at first/sample_rate

    @cached_property
    def t(self) -> Vector:
        """Times of the samples [s], float64 (n,)."""
        return np.arange(self.first, self.first + len(self.x)) / self.sample_rate

    @property
    def normal_force(self) -> Vector:
        """Normal contact force N [N], float64 (n,)."""
        return self._forces[0]

    @property
    def tangential_force(self) -> Vector:
        """Friction force F_t on the pad, along the belt [N], float64 (n,)."""
        return self._forces[1]

    @cached_property
    def _forces(self) -> tuple[Vector, Vector]:
        normal, tangential = np.empty(len(self.x)), np.empty(len(self.x))
        fill_forces(self.y, self.vx, pack(self.parameters), normal, tangential)
        return normal, tangential


class Motion:
    """The pad in motion, resumable block by block; parameters may change between blocks.

    Args:
        p: parameters.
        sample_rate: samples per second [Hz].
        state: start (x, y, vx, vy) [m, m/s]; the equilibrium when None.
        engine: one of `ENGINES`.
        step: longest step [s]; when None `DEFAULT_STEP` for "rk4", no bound but its own for "exact".
        budget: of the "exact" engine: steps and pieces between events after which a block is given up; None: no bound.

    Raises:
        ParameterError: an argument is out of its bounds.
        ModelError: no state was given and there is no equilibrium in contact.
    """

    def __init__(
        self,
        p: RigParameters,
        sample_rate: float,
        state: ArrayLike | None = None,
        engine: str = DEFAULT_ENGINE,
        step: float | None = None,
        budget: int | None = None,
    ) -> None:
        if engine not in ENGINES:
            raise ParameterError(f"engine = {engine!r} is not known: it must be one of {', '.join(ENGINES)}")
        refuse_unless_positive(sample_rate=(sample_rate, "Hz"), step=(DEFAULT_STEP if step is None else step, "s"))
        self._engine = engine
        self.sample_rate = sample_rate
        self._interval = 1.0 / sample_rate
        self._longest_step = step
        self._flow, self._workspace = exact.empty_flow(), exact.workspace()
        self._tally, self._events = np.zeros(exact.TALLY_SIZE), np.empty((0, 2))
        self._tally[exact.BUDGET] = budget or 0
        self._state: Vector = resting_state(p) if state is None else checked_state(state)
        self.set_parameters(p)

    @property
    def state(self) -> Vector:
        """Copy of the state (x, y, vx, vy) [m, m/s] at the start of the next block."""
        return np.array(self._state)

    @property
    def packed(self) -> Vector:
        """The parameters (28,) as the kernels see them, not to be written to."""
        return self._packed

    def set_parameters(self, p: RigParameters) -> None:
        """Take new parameters from the next block on; the exact engine's propagators cost some 0.05 ms."""
        self.parameters = p
        self._packed = pack(p)
        if self._engine == "rk4":
            longest = DEFAULT_STEP if self._longest_step is None else self._longest_step
            self._substeps = max(1, math.ceil(self._interval / longest * (1.0 - 1e-12)))
            return
        longest = self._interval if self._longest_step is None else self._longest_step
        self._substeps = propagator.substeps_needed(self._packed, self._interval, longest)
        propagator.make_propagators(self._packed, self._interval / self._substeps, self._flow)

    def set_state(self, state: ArrayLike) -> None:
        """Put the pad into the state (x, y, vx, vy) [m, m/s]."""
        self._state = checked_state(state)

    def kick(self, dvx: float, dvy: float) -> None:
        """Change the pad's velocity [m/s] at once: an impact of mass times that change."""
        self._state[2] += dvx
        self._state[3] += dvy

    def advance(self, out: Vector) -> None:
        """Fill `out` (n, 6) with x, y, vx, vy, N, F_t at the next n samples, or (n, 4) with the first four of them.

        A contiguous block is filled by way of a `sample_room` of its size, any other directly.

        Raises:
            ParameterError: the block has neither 4 nor 6 columns.
            ModelError: the motion left every bound, or used up its budget; states are filled up to there, forces not.
        """
        if out.ndim != 2 or out.shape[1] not in (STATE_SIZE, SAMPLE_SIZE):
            raise ParameterError(
                f"a block of samples of shape {out.shape} must have {STATE_SIZE} or {SAMPLE_SIZE} columns"
            )
        if len(out) == 0:
            return
        room = sample_room(*out.shape) if out.flags.forc else out
        if self._engine == "exact":
            ended, filled = stepping.advance(*self._exact(), room)
        else:
            filled = rk4.advance(self._state, self._packed, self._interval, self._substeps, room)
            ended = exact.DONE if filled == len(out) else exact.NOT_FINITE
        if room is not out:
            out[:filled] = room[:filled]
        exact.refuse_unless_done(ended, filled * self._interval)

    def advance_columns(self, out: Vector) -> tuple[float, float]:
        """Fill `out` (4, n) with x, y, vx, vy at the next n samples, a row each.

        Returns the fastest vx [m/s] and the largest displacement [m] among them.

        Raises:
            ModelError: as `advance`; a budget is one for each 512 samples.
        """
        extremes = np.array([-math.inf, 0.0])
        if self._engine == "exact":
            ended, filled = columns.advance(*self._exact(), out, extremes)
            exact.refuse_unless_done(ended, filled * self._interval)
        else:
            self.advance(out.T)
            columns.widen(out, 0, out.shape[1], extremes)
        return float(extremes[0]), float(extremes[1])

    def _exact(self) -> tuple[Vector, Vector, Vector, int, Vector, Vector, Vector]:
        """What every call of the exact engine takes first."""
        return self._state, self._packed, self._flow, self._substeps, self._workspace, self._tally, self._events


def resting_state(p: RigParameters) -> Vector:
    """State (x, y, 0, 0) at the exact equilibrium."""
    x, y = equilibrium(p)
    return np.array([x, y, 0.0, 0.0])


def displaced_state(p: RigParameters, compressions: float) -> Vector:
    """At rest, displaced from the equilibrium towards the belt by a number of static compressions u = N*/k_c."""
    state = resting_state(p)
    state[1] -= compressions * (p.pretension_length - state[1])
    return state


def simulate(
    p: RigParameters,
    duration: float,
    sample_rate: float = 51200.0,
    initial_state: ArrayLike | None = None,
    engine: str = DEFAULT_ENGINE,
    step: float | None = None,
) -> Trajectory:
    """Integrate Eq. (2.3) from t = 0 and sample it.

    Args:
        p: parameters.
        duration: time simulated [s]; the last sample is at or just before it.
        sample_rate: samples per second [Hz].
        initial_state: (x, y, vx, vy) [m, m/s]; when None the pad starts at rest, 0.1 static compressions
            off the equilibrium, towards the belt.
        engine: "exact", exact linear flow between contact events located to rounding (`exact`), or
            "rk4", fixed steps straight through contact events, as in the paper.
        step: longest step [s]; when None 1e-6 for "rk4", no bound but its own for "exact".

    Raises:
        ParameterError: an argument is out of its bounds.
        ModelError: no equilibrium in contact to start from, or the motion left every bound.
    """
    refuse_unless_positive(duration=(duration, "s"))
    motion = Motion(p, sample_rate, _start(p, initial_state), engine, step)
    return _trajectory(motion, 0, _sample_count(duration, sample_rate))


def simulate_blocks(
    p: RigParameters,
    duration: float,
    sample_rate: float = 51200.0,
    initial_state: ArrayLike | None = None,
    engine: str = DEFAULT_ENGINE,
    step: float | None = None,
    block_size: int = 65536,
) -> Iterator[Trajectory]:
    """`simulate` block by block: the same samples to the bit, memory flat however long the run is.

    Args:
        p, duration, sample_rate, initial_state, engine, step: as in `simulate`.
        block_size: samples in each block; the last may be shorter.

    Returns:
        an iterator over trajectories that follow each other, each with the warnings of its own samples.

    Raises:
        ParameterError: an argument is out of its bounds.
        ModelError: no equilibrium in contact to start from; while iterating: the motion left every bound.
    """
    refuse_unless_positive(duration=(duration, "s"))
    if not 1 <= block_size < _MAX_SAMPLES:
        raise ParameterError(f"block_size = {block_size} is out of bounds: 1 to {_MAX_SAMPLES - 1} samples")
    motion = Motion(p, sample_rate, _start(p, initial_state), engine, step)
    samples = _sample_count(duration, sample_rate, at_most=2.0**53)
    return (_trajectory(motion, first, min(block_size, samples - first)) for first in range(0, samples, block_size))


def _start(p: RigParameters, initial_state: ArrayLike | None) -> ArrayLike:
    return displaced_state(p, _START_COMPRESSIONS) if initial_state is None else initial_state


def _sample_count(duration: float, sample_rate: float, at_most: float = _MAX_SAMPLES) -> int:
    samples = duration * sample_rate
    if samples >= at_most:
        raise ParameterError(
            f"duration times sample_rate = {samples:.4g} samples is out of bounds: at most {at_most:.0f}"
        )
    return int(samples * (1.0 + 1e-12)) + 1


def _trajectory(motion: Motion, first: int, samples: int) -> Trajectory:
    """The motion's next samples, of which the first has the number `first`."""
    states = _room(STATE_SIZE * samples).reshape(STATE_SIZE, samples)
    extremes = motion.advance_columns(states)
    p = motion.parameters
    x, y, vx, vy = states
    return Trajectory(x, y, vx, vy, tuple(_warnings(p, *extremes)), p, motion.sample_rate, first)


def _room(numbers: int) -> Vector:
    """An empty array; a long one begins where a large page of memory does, since small ones cost far more time."""
    if numbers < 2 * _LARGE_PAGE:
        return np.empty(numbers)
    room = np.empty(numbers + _LARGE_PAGE)
    before = -(room.ctypes.data // room.itemsize) % _LARGE_PAGE
    return room[before : before + numbers]


def validity_warnings(p: RigParameters, samples: Vector) -> list[str]:
    """Sentences where a block of samples (n, 6) left what the printed model assumes (the paper's section 3)."""
    fastest = float(np.max(samples[:, VX], initial=-math.inf))
    return _warnings(p, fastest, float(np.max(np.abs(samples[:, :VX]), initial=0.0)))


def _warnings(p: RigParameters, fastest: float, largest: float) -> list[str]:
    """The sentences for the fastest vx [m/s] and the largest displacement [m] of some samples."""
    warnings = []
    if p.friction_direction == "constant" and fastest > p.belt_speed:
        warnings.append(
            f"the pad's speed along the belt reached {fastest:.4g} m/s, above the belt speed {p.belt_speed:g} m/s:"
            " the printed direction of friction does not hold there"
        )
    arm = min(p.arm_length_1, p.arm_length_2)
    if largest > LARGE_DISPLACEMENT * arm:
        warnings.append(
            f"the pad's displacement reached {largest:.4g} m, above {LARGE_DISPLACEMENT:g} of the arm length {arm:g} m:"
            " not squeal, the model's small displacements do not hold there"
        )
    return warnings


def refuse_unless_positive(**arguments: tuple[float, str]) -> None:
    """Refuse arguments, each a value and its unit, that are not finite and above zero.

    Raises:
        ParameterError: naming the first of them.
    """
    for name, (value, unit) in arguments.items():
        if not (math.isfinite(value) and value > 0.0):
            raise ParameterError(f"{name} = {value} {unit} is out of bounds: it must be above 0 {unit}")


def checked_state(state: ArrayLike) -> Vector:
    """A state (x, y, vx, vy) [m, m/s] as a new array.

    Raises:
        ParameterError: it is not four finite numbers.
    """
    values = np.array(state, dtype=np.float64)
    if values.shape != (4,) or not np.isfinite(values).all():
        raise ParameterError(f"initial_state = {state!r} must be four finite numbers: x, y [m], vx, vy [m/s]")
    return values
