"""Preload unit and belt drive against their closed forms."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from squeal_rig.instruments.actuators import Actuators, BeltMotor, PreloadUnit, piece_length
from squeal_rig.instruments.data_sheets import BeltDrive, DataSheets, Hydraulics, load_data_sheets
from squeal_rig.instruments.settings import RigSettings
from squeal_rig.model import RigParameters

RATE, RADIUS = 51200, 0.05
DT = 1.0 / RATE


# --- preload


@pytest.mark.parametrize("pieces", [10, 1000])
def test_preload_goes_at_its_slew_rate_then_with_its_lag(pieces):
    # At full rate until |F_set - F| = slew tau, then exponentially: exact, whatever the pieces.
    slew, tau, step, duration = 2000.0, 0.02, 250.0, 0.25
    unit = PreloadUnit(Hydraulics(slew_rate=slew, response_time=tau), 50.0)
    t = duration * np.arange(1, pieces + 1) / pieces
    for _ in t:
        unit.in_force(50.0 + step, duration / pieces)
    ramp = (step - slew * tau) / slew
    assert unit.preload == pytest.approx(50.0 + step - slew * tau * math.exp(-(duration - ramp) / tau), rel=1e-12)


def test_preload_by_an_independent_solver():
    sheet = Hydraulics(slew_rate=1500.0, response_time=0.05)
    unit, dt = PreloadUnit(sheet, 100.0), 0.00125
    commands = np.repeat([300.0, 0.0, 20.0], 160)
    found, state = [], 100.0
    for command in commands:
        unit.in_force(command, dt)
        found.append(unit.preload)
    for number, command in enumerate((300.0, 0.0, 20.0)):

        def rate(t, f, command=command):
            return np.clip((command - f) / 0.05, -1500.0, 1500.0)

        solution = solve_ivp(rate, (0.0, 0.2), [state], "DOP853", rtol=1e-10, atol=1e-9, max_step=1e-3)
        state = solution.y[0, -1]
        assert found[160 * number + 159] == pytest.approx(state, abs=1e-3)


def test_pump_ripple_has_its_amplitude_and_frequency():
    unit, dt, n = PreloadUnit(Hydraulics(ripple=0.02, ripple_frequency=150.0), 200.0), 0.00125, 1600  # 300 periods
    preload = np.array([unit.in_force(200.0, dt) for _ in range(n)])
    middle = (np.arange(n) + 0.5) * dt
    assert preload == pytest.approx(200.0 * (1.0 + 0.02 * np.sin(2.0 * np.pi * 150.0 * middle)), rel=1e-9)
    spectrum = np.abs(np.fft.rfft(preload - 200.0)) / (n / 2)
    assert np.argmax(spectrum) / (n * dt) == pytest.approx(150.0)
    assert spectrum.max() == pytest.approx(4.0, rel=1e-9)


def test_no_ripple_without_preload():
    unit = PreloadUnit(Hydraulics(ripple=0.4, ripple_frequency=33.0), 0.0)
    assert not any(unit.in_force(0.0, 0.001) for _ in range(100))


# --- belt drive


def motor(speed: float = 1.0, **fields: object) -> BeltMotor:
    sheet = BeltDrive.from_mapping({"inertia": 0.3, "control_bandwidth": 5.0, "control_damping": 0.7, **fields})
    return BeltMotor(sheet, RADIUS, DT, speed)


def turned(drive: BeltMotor, asked: float, force, piece: int = 64):
    """Angular speed after each piece [rad/s] and motor torque at each sample [N m]."""
    torque, speeds = np.empty(len(force)), []
    for first in range(0, len(force), piece):
        here = slice(first, min(first + piece, len(force)))
        drive.turn(asked, asked, np.ascontiguousarray(force[here]), torque[here])
        speeds.append(drive.state[0])
    return np.array(speeds), torque


def second_order(t, zeta: float, w0: float):
    """Impulse response of 1 / (s^2 + 2 zeta w0 s + w0^2), zeta < 1, and its derivative."""
    wd, decay = w0 * math.sqrt(1.0 - zeta**2), zeta * w0
    e = np.exp(-decay * t)
    return e * np.sin(wd * t) / wd, e * (np.cos(wd * t) - decay / wd * np.sin(wd * t))


def test_step_of_the_load_is_the_closed_form():
    # From rest in equilibrium, T_load -> T_load + D: dw(t) = -D/J h(t), h the impulse response of the closed loop.
    drive, n, force = motor(), RATE // 2, 100.0
    turned(drive, 1.0, np.full(64, force))  # settles
    speeds, torque = turned(drive, 1.0, np.full(n, force + 200.0))
    t = np.minimum(64 * np.arange(1, len(speeds) + 1), n) / RATE
    step = 200.0 * RADIUS
    h, slope = second_order(t, 0.7, 2.0 * math.pi * 5.0)
    assert speeds == pytest.approx(1.0 / RADIUS - step / 0.3 * h, rel=1e-9)
    # The motor's torque is the load and what turns the drum: T = T_load + J dw/dt.
    told = torque[64::64]
    assert told == pytest.approx(force * RADIUS + step - step * slope[: len(told)], rel=1e-9)


def test_step_of_the_set_speed_is_the_closed_form():
    # w / w_set = (2 zeta w0 s + w0^2) / (s^2 + 2 zeta w0 s + w0^2).
    drive, n, w0 = motor(speed=1.0), RATE // 2, 2.0 * math.pi * 5.0
    turned(drive, 1.0, np.zeros(64))
    speeds, _ = turned(drive, 1.5, np.zeros(n))
    t = np.minimum(64 * np.arange(1, len(speeds) + 1), n) / RATE
    _, slope = second_order(t, 0.7, w0)  # the error is s^2 / (...) times the step 1/s: h'
    assert speeds == pytest.approx((1.0 + 0.5 * (1.0 - slope)) / RADIUS, rel=1e-9)


def test_at_the_torque_limit_the_drum_speeds_up_evenly():
    # J dw/dt = limit - load until the control asks for less.
    drive, limit, load = motor(speed=0.0, torque_limit=40.0), 40.0, 100.0 * RADIUS
    turned(drive, 0.0, np.full(64, 100.0))
    n = RATE // 10
    speeds, torque = turned(drive, 5.0, np.full(n, 100.0))
    t = np.minimum(64 * np.arange(1, len(speeds) + 1), n) / RATE
    assert np.all(torque == limit)
    assert speeds == pytest.approx((limit - load) / 0.3 * t, rel=1e-6)


def test_a_load_beyond_the_limit_stalls_the_belt_and_does_not_drive_it_backward():
    drive = motor(speed=1.0, torque_limit=20.0)
    turned(drive, 1.0, np.full(64, 100.0))
    speeds, torque = turned(drive, 1.0, np.full(RATE, 800.0))
    assert speeds[-1] == 0.0
    assert np.all(speeds >= 0.0)
    assert torque.max() == 20.0
    # (load - limit) / J from w: at rest after J w / (load - limit), once the limit is reached.
    assert np.flatnonzero(speeds == 0.0)[0] * 64 / RATE == pytest.approx(0.3 * 20.0 / 20.0, rel=0.2)


def test_belt_drive_by_an_independent_solver():
    zeta, w0, inertia, limit = 0.7, 2.0 * math.pi * 5.0, 0.3, 35.0
    drive, n = motor(torque_limit=limit), RATE // 2
    t = np.arange(n) / RATE
    force = 300.0 + 250.0 * np.sin(2.0 * np.pi * 7.0 * t)
    turned(drive, 1.0, np.full(64, 300.0))
    speeds, torque = turned(drive, 1.2, force)
    assert torque.max() == limit
    gain, integral_gain = 2.0 * zeta * w0 * inertia, w0**2 * inertia

    def rate(time, state):
        w, integral = state
        wanted = gain * (1.2 / RADIUS - w) + integral
        given = min(max(wanted, -limit), limit)
        load = RADIUS * (300.0 + 250.0 * math.sin(2.0 * math.pi * 7.0 * time))
        return [(given - load) / inertia, integral_gain * (1.2 / RADIUS - w) if given == wanted else 0.0]

    start = [1.0 / RADIUS, 300.0 * RADIUS]
    solution = solve_ivp(rate, (0.0, 0.5), start, "RK45", rtol=1e-8, atol=1e-8, max_step=1e-3, dense_output=True)
    ends = np.minimum(64 * np.arange(1, len(speeds) + 1), n) / RATE
    assert speeds == pytest.approx(solution.sol(ends)[0], abs=2e-3)


def test_run_out_comes_once_per_turn_and_ripple_at_its_order():
    speed, run_out, order = 2.0 * math.pi * RADIUS * 4.0, 5e-4, 3  # 4 turns a second
    drive = motor(speed=speed, run_out=run_out, speed_ripple=0.004, ripple_order=order)
    seen = []
    for _ in range(800 * 2):
        seen.append(drive.belt_speed)
        drive.turn(speed, speed, np.zeros(64), np.empty(64))
    spectrum = np.abs(np.fft.rfft(np.array(seen) - speed)) / len(seen) * 2.0
    frequency = np.fft.rfftfreq(len(seen), 64 / RATE)
    strongest = sorted(frequency[np.argsort(spectrum)[-2:]])
    assert strongest == pytest.approx([4.0, 4.0 * order])
    assert spectrum[frequency == 4.0] == pytest.approx(speed * run_out / RADIUS, rel=1e-6)
    assert spectrum[frequency == 4.0 * order] == pytest.approx(speed * 0.004, rel=1e-6)


# --- both in a rig


def test_ideal_actuators_put_the_command_in_force_itself():
    p, settings = RigParameters(), RigSettings()
    ideal = load_data_sheets("ideal")
    assert piece_length(ideal, settings) == settings.block_size
    actuators = Actuators(ideal, p, settings, RATE)
    other = p.replace(preload=77.7, belt_speed=2.3)
    assert actuators.in_force(other, 0, 512, 512) is other
    assert actuators.torque(other, 0, 512, 512, np.ones(512)) is None


@pytest.mark.parametrize(("rate", "piece"), [(51200, 64), (1000, 1), (44100, 55), (2_000_000, 2500)])
def test_pieces_last_as_long_at_every_sample_rate(rate, piece):
    assert piece_length(load_data_sheets("typical"), RigSettings(sample_rate=rate)) == piece


def test_the_speed_asked_for_has_no_steps_between_blocks():
    p, settings = RigParameters(), RigSettings()
    sheets = DataSheets(belt_drive=BeltDrive(inertia=0.3, control_bandwidth=50.0))
    actuators = Actuators(sheets, p, settings, RATE)
    torques = []
    for block in range(40):  # 5 m/s^2, as slew rates let it: J a / R = 30 N m
        command = p.replace(belt_speed=1.0 + 0.05 * block)
        for first in range(0, 512, 64):
            torques.append(actuators.torque(command, first, first + 64, 512, np.zeros(64)))
    settled = np.concatenate(torques)[20 * 512 :]
    # Held over a sample, the error is told at its largest: by K_p a dt / 2 R = 0.18 N m. A step of 0.05 m/s: 190 N m.
    assert settled == pytest.approx(0.3 * 5.0 / RADIUS + 0.184, rel=1e-3)
