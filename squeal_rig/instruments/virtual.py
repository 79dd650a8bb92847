"""The virtual rig: the nonlinear model seen through ideal instruments."""

from __future__ import annotations

import numpy as np

from squeal_rig.errors import DriverError
from squeal_rig.instruments.channels import DAQ_RECORD, TRUTH_RECORD
from squeal_rig.instruments.driver import Reading
from squeal_rig.instruments.settings import RigSettings
from squeal_rig.model import rk4
from squeal_rig.model.dynamics import K1, K2, Vector, arm_extensions, friction_ratio, pack
from squeal_rig.model.kernel import kernel
from squeal_rig.model.parameters import RigParameters
from squeal_rig.model.trajectory import Motion, resting_state, validity_warnings


class VirtualRig:
    """Driver `virtual`: integrates Eq. (2.3) block by block; the DAQ channels carry the true values."""

    publishes_truth = True

    def __init__(self) -> None:
        self._motion: Motion | None = None

    def open(self, parameters: RigParameters, settings: RigSettings) -> None:
        """Put the pad at rest on the belt and load the compiled model."""
        self._settings = settings
        self._motion = Motion(parameters, settings.sample_rate)
        self._states = np.empty((settings.block_size, rk4.COLUMNS))
        self._derived = np.empty((settings.block_size, 3))
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
        if in_force != motion.parameters:
            motion.set_parameters(in_force)
        motion.advance(self._states)
        derive_channels(self._states, pack(in_force), self._derived)
        return Reading(self._daq(in_force), self._truth(), tuple(validity_warnings(in_force, self._states)))

    def _opened(self) -> Motion:
        if self._motion is None:
            raise DriverError("the driver is not open: open it before use")
        return self._motion

    def _daq(self, p: RigParameters) -> np.ndarray:
        states, daq = self._states, np.zeros(len(self._states), DAQ_RECORD)
        daq["x"], daq["y"] = states[:, rk4.X], states[:, rk4.Y]
        daq["arm_left"], daq["arm_right"] = self._derived[:, 0], self._derived[:, 1]
        # Clips lie along the belt on either side: moving along it stretches the left one and presses the right one.
        daq["clip_left"], daq["clip_right"] = -p.k3 * states[:, rk4.X], p.k4 * states[:, rk4.X]
        daq["motor_torque"] = states[:, rk4.TANGENTIAL] * self._settings.drum_radius
        daq["belt_speed"], daq["preload"] = p.belt_speed, p.preload
        return daq

    def _truth(self) -> np.ndarray:
        states, truth = self._states, np.zeros(len(self._states), TRUTH_RECORD)
        for name, column in (("x", rk4.X), ("y", rk4.Y), ("vx", rk4.VX), ("vy", rk4.VY)):
            truth[name] = states[:, column]
        truth["normal_force"], truth["tangential_force"] = states[:, rk4.NORMAL], states[:, rk4.TANGENTIAL]
        truth["mu"] = self._derived[:, 2]
        return truth


@kernel
def derive_channels(states: Vector, q: Vector, out: Vector) -> None:
    """Fill `out` (n, 3) with both arm forces k_i (L_i - l_i) [N] and the friction ratio at each state (n, 6)."""
    for i in range(len(states)):
        e1, e2 = arm_extensions(states[i, 0], states[i, 1], q)
        out[i, 0] = -q[K1] * e1
        out[i, 1] = -q[K2] * e2
        out[i, 2] = friction_ratio(states[i, 2], q)
