"""The virtual rig: the nonlinear model seen through ideal instruments."""

from __future__ import annotations

import time

import numpy as np

from squeal_rig.errors import DriverError
from squeal_rig.instruments.channels import DAQ_RECORD, TRUTH_RECORD
from squeal_rig.instruments.driver import Reading, Samples
from squeal_rig.instruments.settings import RigSettings
from squeal_rig.model.core.forces import arm_extensions, friction_ratio
from squeal_rig.model.core.kernel import kernel
from squeal_rig.model.core.layout import K1, K2, NORMAL, SAMPLE_SIZE, TANGENTIAL, VX, VY, Vector, X, Y, pack
from squeal_rig.model.motion.trajectory import Motion, resting_state, validity_warnings
from squeal_rig.model.parameters import RigParameters

# A block is computed in pieces of so many samples, and given up when a piece uses more steps of the engine than this
# (10 us each at worst), or the pieces after the first more time than this [s]: nobody is answered meanwhile.
_PIECE, _BUDGET, _LONGEST = 64, 100_000, 1.0


class VirtualRig:
    """Driver `virtual`: integrates Eq. (2.3) block by block; the DAQ channels carry the true values."""

    publishes_truth = True

    def __init__(self) -> None:
        self._motion: Motion | None = None

    def open(self, parameters: RigParameters, settings: RigSettings) -> None:
        """Put the pad at rest on the belt and load the compiled model."""
        self._settings = settings
        self._motion = Motion(parameters, settings.sample_rate, budget=_BUDGET)
        self._states = np.empty((settings.block_size, SAMPLE_SIZE))
        self._take(parameters)
        # Loading or compiling takes seconds the first time: here, not in the first timed block.
        self.read(parameters)
        self.reset()

    def close(self) -> None:
        """Forget the motion."""
        self._motion = None

    def reset(self) -> None:
        """Bring the pad to rest at the equilibrium of the parameters in force."""
        motion = self._opened()
        motion.set_state(resting_state(motion.parameters))

    def impact(self, impulse_x: float, impulse_y: float) -> None:
        """Change the pad's momentum by an impulse [N s]."""
        motion = self._opened()
        motion.kick(impulse_x / motion.parameters.mass, impulse_y / motion.parameters.mass)

    def read(self, in_force: RigParameters) -> Reading:
        """Integrate one block and read every channel."""
        motion = self._opened()
        if in_force is not self._in_force:
            self._take(in_force)
        self._advance(motion)
        daq, truth = np.zeros(len(self._states), DAQ_RECORD), np.zeros(len(self._states), TRUTH_RECORD)
        fill_channels(self._states, self._packed, self._instruments, daq, truth)
        return Reading(daq, truth, tuple(validity_warnings(in_force, self._states)))

    def _advance(self, motion: Motion) -> None:
        begun = 0.0
        for first in range(0, len(self._states), _PIECE):
            motion.advance(self._states[first : first + _PIECE])
            now = time.monotonic()
            begun = begun or now  # the very first piece may have compiled the model
            if now - begun > _LONGEST:
                raise DriverError(f"the motion changes too fast: a block of 10 ms takes more than {_LONGEST:g} s")

    def _take(self, p: RigParameters) -> None:
        motion = self._opened()
        if p != motion.parameters:
            motion.set_parameters(p)
        self._in_force, self._packed = p, pack(p)
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
