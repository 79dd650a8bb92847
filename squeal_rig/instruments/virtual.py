"""The virtual rig: the nonlinear model, moved by its actuators and seen through its instruments."""

from __future__ import annotations

import time

import numpy as np

from squeal_rig.errors import DriverError
from squeal_rig.instruments.actuators import Actuators, piece_length, safe_point, slewed
from squeal_rig.instruments.chain import Chain
from squeal_rig.instruments.channels import DAQ_RECORD, TRUTH_RECORD
from squeal_rig.instruments.data_sheets import DataSheets, load_data_sheets
from squeal_rig.instruments.driver import Capabilities, Reading, Samples
from squeal_rig.instruments.settings import BLOCKS_PER_SECOND, RigSettings
from squeal_rig.model.core.forces import arm_extensions, friction_ratio
from squeal_rig.model.core.kernel import kernel
from squeal_rig.model.core.layout import K1, K2, NORMAL, TANGENTIAL, VX, VY, Vector, X, Y, sample_room
from squeal_rig.model.motion.trajectory import Motion, resting_state, validity_warnings
from squeal_rig.model.parameters import RUN_TIME_PARAMETERS, RigParameters

# A block is computed in pieces of so many samples, and given up when a piece uses more steps of the engine than this
# (10 us each at worst), or the pieces after the first more time than this [s]: nobody is answered meanwhile.
_PIECE, _BUDGET, _LONGEST = 64, 100_000, 1.0


class VirtualRig:
    """Driver `virtual`: integrates Eq. (2.3) block by block, with what its data sheets make of set points and values.

    With ideal data sheets the DAQ channels carry the true values, bit for bit.

    Args:
        sheets: data sheets instead of those that the rig's settings name.
    """

    def __init__(self, sheets: DataSheets | None = None) -> None:
        self._given = sheets
        self._motion: Motion | None = None
        self._safe = False

    def capabilities(self, settings: RigSettings) -> Capabilities:
        """Everything that is no constant of the machine can be moved; the truth is known."""
        return Capabilities(RUN_TIME_PARAMETERS, knows_truth=True, can_hit=True)

    def open(self, parameters: RigParameters, settings: RigSettings) -> None:
        """Put the pad at rest on the belt, load the compiled model and take the instruments out of their box."""
        self._sheets = self._given if self._given is not None else load_data_sheets(settings.instruments)
        self._settings = settings
        self._states = sample_room(settings.block_size)
        self._piece = piece_length(self._sheets, settings)
        self._motion = None
        self._start(parameters)
        # Loading or compiling takes seconds the first time: here, not in the first timed block.
        self.read(parameters)
        self._start(parameters)
        self.reset()

    def _start(self, parameters: RigParameters) -> None:
        """Instruments and actuators as if just switched on."""
        settings = self._settings
        self._chain = Chain(self._sheets, settings.sample_rate, settings.instruments_seed)
        # A clock that runs fast samples more often than it says: the motion is what it samples.
        rate = settings.sample_rate * (1.0 + self._chain.clock_error)
        self._motion = self._motion or Motion(parameters, rate, budget=_BUDGET)
        self._actuators = Actuators(self._sheets, parameters, settings, rate)
        self._command = parameters
        self._take(parameters)

    def close(self) -> None:
        """Forget the motion."""
        self._motion = None

    def reset(self) -> None:
        """Bring the pad to rest at the equilibrium of the parameters in force; set points count again."""
        motion = self._opened()
        self._safe = False
        motion.set_state(resting_state(motion.parameters))

    def impact(self, impulse_x: float, impulse_y: float) -> None:
        """Change the pad's momentum by an impulse [N s]."""
        motion = self._opened()
        motion.kick(impulse_x / motion.parameters.mass, impulse_y / motion.parameters.mass)

    def read(self, in_force: RigParameters) -> Reading:
        """Integrate one block and read every channel."""
        motion = self._opened()
        if self._safe:
            in_force = slewed(self._command, safe_point(in_force), self._settings, 1.0 / BLOCKS_PER_SECOND)
        self._command = in_force
        n = len(self._states)
        daq, truth = np.zeros(n, DAQ_RECORD), np.zeros(n, TRUTH_RECORD)
        spent = -1.0
        for first in range(0, n, self._piece):
            last = min(first + self._piece, n)
            now = self._actuators.in_force(in_force, first, last, n)
            if now is not self._in_force:
                self._take(now)
            states = self._states[first:last]
            spent = self._advance(motion, states, spent)
            fill_channels(states, self._packed, self._instruments, daq[first:last], truth[first:last])
            torque = self._actuators.torque(in_force, first, last, n, states[:, TANGENTIAL])
            if torque is not None:
                daq["motor_torque"][first:last] = torque
        warnings = tuple(validity_warnings(self._in_force, self._states))
        self._chain.measure(daq)
        lost = self._chain.gaps.take(n)
        return Reading(daq[lost:], truth[lost:], warnings, lost=lost)

    def make_safe(self) -> None:
        """Let preload and belt speed fall to nothing as fast as hydraulics and motor let them."""
        self._safe = True

    def _advance(self, motion: Motion, states: Vector, spent: float) -> float:
        """Fill states of a block that has taken `spent` [s] of work so far, -1 where it is begun; returns the new sum.

        The first piece is not counted: it may compile the model.
        """
        for first in range(0, len(states), _PIECE):
            begun = time.thread_time()  # what the motion costs, however busy the machine is
            motion.advance(states[first : first + _PIECE])
            spent = 0.0 if spent < 0.0 else spent + time.thread_time() - begun
            if spent > _LONGEST:
                raise DriverError(
                    f"the motion changes too fast: a block of 10 ms takes more than {_LONGEST:g} s of work"
                )
        return spent

    def _take(self, p: RigParameters) -> None:
        motion = self._opened()
        if p != motion.parameters:
            motion.set_parameters(p)
        self._in_force, self._packed = p, motion.packed
        self._instruments = (p.k3, p.k4, self._settings.drum_radius, p.belt_speed, p.preload)

    def _opened(self) -> Motion:
        if self._motion is None:
            raise DriverError("the driver is not open: open it before use")
        return self._motion


@kernel
def fill_channels(
    states: Vector, q: Vector, instruments: tuple[float, float, float, float, float], daq: Samples, truth: Samples
) -> None:
    """Fill both records (n,), but for `t` and `seq`, from states (n, 6): in one pass, since memory is what costs.

    `instruments` are k3, k4 [N/m], drum radius [m], belt speed [m/s] and preload [N].
    """
    k3, k4, radius, speed, preload = instruments
    for i in range(len(states)):
        x, y, vx = states[i, X], states[i, Y], states[i, VX]
        e1, e2 = arm_extensions(x, y, q)
        seen, true = daq[i], truth[i]
        seen.x, seen.y = x, y
        seen.arm_left, seen.arm_right = -q[K1] * e1, -q[K2] * e2
        # Clips lie along the belt on either side: moving along it stretches the left one and presses the right one.
        seen.clip_left, seen.clip_right = -k3 * x, k4 * x
        seen.motor_torque = states[i, TANGENTIAL] * radius
        seen.belt_speed, seen.preload = speed, preload
        true.x, true.y, true.vx, true.vy = x, y, vx, states[i, VY]
        true.normal_force, true.tangential_force = states[i, NORMAL], states[i, TANGENTIAL]
        true.mu = friction_ratio(vx, q)
