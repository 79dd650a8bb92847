"""How set points come into force: slew rates, hydraulics, belt drive; the state a rig falls to when it is stopped."""

from __future__ import annotations

import copy
import dataclasses
import math

import numpy as np
import scipy  # its parts load when they are used
from numpy.typing import NDArray

from squeal_rig.instruments.data_sheets import BeltDrive, DataSheets, Hydraulics
from squeal_rig.instruments.settings import RigSettings
from squeal_rig.model.core.kernel import kernel
from squeal_rig.model.parameters import RigParameters

Values = NDArray[np.float64]

#: Pieces of 64 samples at 51.2 kHz: what is in force is held over each.
PIECES_PER_SECOND = 800


def slewed(in_force: RigParameters, set_point: RigParameters, settings: RigSettings, dt: float) -> RigParameters:
    """Parameters in force one block of `dt` [s] later: slewed quantities move at most their rate times dt.

    All other parameters take their set points at once.
    """
    if in_force is set_point:
        return in_force
    rates = {
        "preload": settings.preload_slew_rate,
        "belt_speed": settings.belt_acceleration,
        "k1": settings.stiffness_slew_rate,
        "k2": settings.stiffness_slew_rate,
    }
    moved = {}
    for name, rate in rates.items():
        now, goal = getattr(in_force, name), getattr(set_point, name)
        moved[name] = goal if abs(goal - now) <= rate * dt else now + math.copysign(rate * dt, goal - now)
    arrived = all(getattr(set_point, name) == value for name, value in moved.items())
    return set_point if arrived else dataclasses.replace(set_point, **moved)


def safe_point(p: RigParameters) -> RigParameters:
    """The same rig with no preload on it and its belt at rest."""
    return p.replace(preload=0.0, belt_speed=0.0)


class PreloadUnit:
    """Preload by hydraulics: a first-order lag with a limited rate, and the pump's ripple in proportion to it.

    tau dF/dt = F_set - F, |dF/dt| <= slew; in force is F (1 + ripple sin(2 pi f t)).
    """

    def __init__(self, sheet: Hydraulics, preload: float) -> None:
        self._sheet, self.preload, self._time = sheet, preload, 0.0

    def in_force(self, command: float, dt: float) -> float:
        """Preload in force in the middle of the next piece of `dt` [s], under a command [N] that holds over it."""
        self._follow(command, 0.5 * dt)
        middle = self._time + 0.5 * dt
        swing = self._sheet.ripple * math.sin(2.0 * math.pi * self._sheet.ripple_frequency * middle)
        preload = self.preload * (1.0 + swing)
        self._follow(command, 0.5 * dt)
        self._time += dt
        return preload

    def _follow(self, command: float, dt: float) -> None:
        """Exact over `dt` [s]: at the full rate until the lag asks for less, then exponentially."""
        slew, tau = self._sheet.slew_rate, self._sheet.response_time
        distance = abs(command - self.preload)
        if slew:
            moving = min(dt, max(0.0, distance / slew - tau))
            self.preload += math.copysign(slew * moving, command - self.preload) if moving else 0.0
            dt -= moving
        if dt > 0.0:
            self.preload = command + (self.preload - command) * math.exp(-dt / tau) if tau else command


class BeltMotor:
    """The belt's drive: a drum with inertia J, turned by a motor with PI speed control and a torque limit.

        J dw/dt = T - T_load,   T = K_p (w_set - w) + integral of K_i (w_set - w),   |T| <= limit

    with K_p = 2 zeta w0 J, K_i = w0^2 J: w0 and zeta are those of the closed loop s^2 + 2 zeta w0 s + w0^2 (Franklin,
    Powell and Emami-Naeini, Feedback Control of Dynamic Systems, PI control of a first-order plant). At the limit the
    integral rests. Friction does not drive the belt backward: w >= 0. The belt runs at w R (1 + e/R sin phi + r sin n
    phi), phi being the angle that the drum has turned by, e its eccentricity, r and n ripple and order; the load's
    lever changes likewise, so that the power is the same on both sides.

    Args:
        sheet: the data sheet, its inertia above 0.
        radius: of the drum [m].
        interval: between samples [s].
        speed: of the belt at the start [m/s].
    """

    def __init__(self, sheet: BeltDrive, radius: float, interval: float, speed: float) -> None:
        self._sheet, self._radius, self._interval = sheet, radius, interval
        w0 = 2.0 * math.pi * sheet.control_bandwidth
        self.gain = 2.0 * sheet.control_damping * w0 * sheet.inertia
        integral_gain = w0**2 * sheet.inertia
        # State (w, integral), input (load, set speed), over one sample of held input, exactly: expm of the augmented
        # matrix holds both the state's and the input's share (Van Loan, IEEE Trans. Automatic Control 23, 1978).
        system = np.zeros((4, 4))
        system[0] = np.array([-self.gain, 1.0, -1.0, self.gain]) / sheet.inertia
        system[1] = [-integral_gain, 0.0, 0.0, integral_gain]
        self._step = np.ascontiguousarray(scipy.linalg.expm(system * interval)[:2])
        limit = sheet.torque_limit or math.inf
        self._constants = np.array([self.gain, interval / sheet.inertia, limit])
        #: Angular speed [rad/s], the control's integral [N m], angle turned [rad].
        self.state = np.array([speed / radius, 0.0, 0.0])
        self._settled = False

    @property
    def lever(self) -> float:
        """Belt speed over angular speed at the drum's angle now [m]."""
        sheet, angle = self._sheet, float(self.state[2])
        wave = sheet.speed_ripple * math.sin(sheet.ripple_order * angle)
        return self._radius * (1.0 + wave) + sheet.run_out * math.sin(angle)

    @property
    def belt_speed(self) -> float:
        """Speed of the belt now [m/s]."""
        return float(self.state[0]) * self.lever

    def turn(self, begin: float, end: float, tangential: Values, torque: Values) -> None:
        """Go on by as many samples as `tangential` [N] (n,) has; fills the motor's torque [N m] (n,) at each.

        The belt speed that is asked for goes from `begin` to `end` [m/s] over them.
        """
        load = tangential * self.lever
        if not self._settled:  # the motor has carried the load for long
            self.state[1] = min(max(load[0], -self._constants[2]), self._constants[2])
            self._settled = True
        asked = (begin + (end - begin) * (np.arange(len(load)) + 0.5) / len(load)) / self._radius
        turn_drum(self._step, self._constants, self._interval, asked, load, self.state, torque)


@kernel
def turn_drum(
    step: Values, constants: Values, interval: float, asked: Values, load: Values, state: Values, torque: Values
) -> None:
    """Go on by n samples of held set speed [rad/s] and load [N m], (n,) each; `state` and `torque` (n,) are written.

    `step` (2, 4) maps state and input over a sample within the limit, `constants` are K_p, dt/J and the limit.
    """
    gain, mobility, limit = constants[0], constants[1], constants[2]
    for i in range(len(load)):
        w, integral = state[0], state[1]
        wanted = gain * (asked[i] - w) + integral
        given = min(max(wanted, -limit), limit)
        torque[i] = given
        if given == wanted:
            state[0] = step[0, 0] * w + step[0, 1] * integral + step[0, 2] * load[i] + step[0, 3] * asked[i]
            state[1] = step[1, 0] * w + step[1, 1] * integral + step[1, 2] * load[i] + step[1, 3] * asked[i]
        else:
            state[0] = w + mobility * (given - load[i])
        state[0] = max(state[0], 0.0)
        state[2] += 0.5 * interval * (w + state[0])


class Actuators:
    """Preload unit and belt drive of a rig: what is really in force, piece by piece.

    Args:
        sheets: data sheets.
        p: parameters in force at the start.
        settings: of the rig: drum radius.
        sample_rate: samples per second, really [Hz].
    """

    def __init__(self, sheets: DataSheets, p: RigParameters, settings: RigSettings, sample_rate: float) -> None:
        self._hydraulics, self._drive = sheets.hydraulics, sheets.belt_drive
        self._interval, self._radius = 1.0 / sample_rate, settings.drum_radius
        self._unit = PreloadUnit(self._hydraulics, p.preload)
        self._motor = None
        if self._drive.inertia:
            self._motor = BeltMotor(self._drive, self._radius, self._interval, p.belt_speed)
        self._asked = self._last = p.belt_speed

    def in_force(self, command: RigParameters, first: int, last: int, n: int) -> RigParameters:
        """Parameters in force over samples `first` to `last` of a block of n, under a command that holds over it."""
        preload = self._unit.in_force(command.preload, (last - first) * self._interval)
        speed = self._motor.belt_speed if self._motor is not None else command.belt_speed
        if preload == command.preload and speed == command.belt_speed:
            return command
        # Not `replace`: its check of every field would cost as much as the motion, and a ripple may pass a bound.
        p = copy.copy(command)
        object.__setattr__(p, "preload", preload)
        object.__setattr__(p, "belt_speed", speed)
        return p

    def torque(self, command: RigParameters, first: int, last: int, n: int, tangential: Values) -> Values | None:
        """The motor's torque [N m] over the same samples, against the contact force [N] (m,) that they had.

        None where the drum has no inertia: then it is the contact force's own.
        """
        if self._motor is None:
            return None
        if first == 0:  # the speed asked for goes from one block's command to the next one's, without steps
            self._last, self._asked = self._asked, command.belt_speed
        slope = (self._asked - self._last) / n
        torque = np.empty(last - first)
        self._motor.turn(self._last + slope * first, self._last + slope * last, tangential, torque)
        return torque


def piece_length(sheets: DataSheets, settings: RigSettings) -> int:
    """Samples over which what is in force is held: 1.25 ms where actuators move it by themselves, else a block."""
    moving = sheets.hydraulics != Hydraulics(ripple_frequency=sheets.hydraulics.ripple_frequency)
    if not (moving or sheets.belt_drive.inertia):
        return settings.block_size
    return max(1, settings.sample_rate // PIECES_PER_SECOND)
