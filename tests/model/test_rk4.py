"""The Runge-Kutta engine: order of convergence, an independent reference, energy."""

import numpy as np
import pytest

from squeal_rig.model import RigParameters, displaced_state, equilibrium, simulate

from . import reference

SQUEALING = RigParameters(preload=300.0, belt_speed=1.0)


def states(run):
    return np.vstack([run.x, run.y, run.vx, run.vy])


def smooth_pieces():
    """Motions of 2 ms or less without a contact event: on the belt, on it with slip-dependent friction, off it."""
    slipping = SQUEALING.replace(
        friction_direction="slip", friction_speed="slip", belt_speed=0.02, preload=100.0, damping_x=20.0
    )
    away = np.array([1e-4, 2e-4, 0.05, 0.05])
    return [
        pytest.param(SQUEALING, displaced_state(SQUEALING, 0.1), 2e-3, id="on the belt"),
        pytest.param(slipping, displaced_state(slipping, 0.3), 1e-3, id="on the belt, slip-dependent"),
        pytest.param(SQUEALING, away, 5e-4, id="off the belt"),
    ]


@pytest.mark.parametrize(("p", "start", "duration"), smooth_pieces())
def test_rk4_converges_with_order_four_between_contact_events(p, start, duration):
    expected, events = reference.solve(p, start, np.linspace(0.0, duration, 26))
    assert events.size == 0
    counts = 25 * 2 ** np.arange(5)
    errors = []
    for count in counts:
        run = simulate(
            p, duration, sample_rate=count / duration, initial_state=start, engine="rk4", step=duration / count
        )
        found = states(run)[:, :: count // 25]
        scale = np.ptp(expected, axis=1, keepdims=True)
        errors.append(np.abs((found - expected) / scale).max())
    # From 25 to 400 steps: the last errors, 1e-7 to 1e-10, are still well above the reference's own 1e-11.
    slopes = -np.diff(np.log(errors)) / np.log(2.0)
    assert -np.polyfit(np.log(counts), np.log(errors), 1)[0] == pytest.approx(4.0, abs=0.1)
    assert slopes[-1] == pytest.approx(4.0, abs=0.1)


RIGS = [
    pytest.param(SQUEALING.replace(pad_stiffness=k, damping_x=c, damping_y=c), id=f"k{k:g}-c{c:g}")
    for k, c in ((2e7, 0.0), (4e7, 0.0), (6e7, 0.0), (10e7, 0.0), (6e7, 20.0))
]
SAMPLE_RATE = 1e5


def solved(p, start, max_events):
    """Reference states at SAMPLE_RATE up to an event, and the events."""
    times = np.arange(4000) / SAMPLE_RATE
    expected, events = reference.solve(p, start, times, max_events=max_events)
    assert len(events) == max_events
    return expected, events


def largest_error(p, start, expected, step):
    duration = (expected.shape[1] - 1) / SAMPLE_RATE
    run = simulate(p, duration, SAMPLE_RATE, start, engine="rk4", step=step)
    assert len(run.t) == expected.shape[1]
    return np.abs((states(run) - expected) / np.ptp(expected, axis=1, keepdims=True)).max()


@pytest.mark.parametrize("p", RIGS)
def test_rk4_at_its_default_step_agrees_with_dop853_before_the_first_contact_event(p):
    # Step 1e-6 s. Required are 1e-6 of the amplitude; 1e-9 is what fourth order gives there: (omega h)^4/120 a radian.
    start = displaced_state(p, 0.1)
    expected, _ = solved(p, start, max_events=1)
    assert largest_error(p, start, expected, step=None) < 1e-9


@pytest.mark.parametrize("p", RIGS)
def test_rk4_at_5_nanoseconds_agrees_with_dop853_over_twenty_contact_events(p):
    # Steps go straight through the kink of an event, an error of order h^2 that the motion then magnifies: at the
    # default 1e-6 s it is 1e-4 to 2e-3 of the amplitude after 20 events, at 5e-9 s below the 1e-6 required.
    start = displaced_state(p, 0.1)
    expected, _ = solved(p, start, max_events=20)
    assert largest_error(p, start, expected, step=5e-9) < 1e-6


def test_the_reference_is_converged_over_twenty_contact_events(monkeypatch):
    p = SQUEALING.replace(pad_stiffness=6e7)
    start = displaced_state(p, 0.1)
    expected, events = solved(p, start, max_events=20)
    monkeypatch.setattr(reference, "RTOL", 1e-11)
    coarser, coarser_events = solved(p, start, max_events=20)
    np.testing.assert_allclose(coarser_events, events, rtol=1e-7)
    assert np.abs((coarser - expected) / np.ptp(expected, axis=1, keepdims=True)).max() < 1e-7


FRICTIONLESS = SQUEALING.replace(mu0=0.0, mu_speed=0.0, mu_preload=0.0, mu_speed_preload=0.0)


def energies_of_motion(duration, sample_rate, step):
    """Energy above that of the equilibrium [J] of a frictionless, undamped rig, in contact all the time."""
    p = FRICTIONLESS
    run = simulate(p, duration, sample_rate, displaced_state(p, 0.5), engine="rk4", step=step)
    assert run.normal_force.min() > 0.0
    at_rest = reference.energy(p, [*equilibrium(p), 0.0, 0.0])
    return np.array([reference.energy(p, state) for state in states(run).T]) - at_rest


def test_without_friction_and_damping_energy_is_conserved_to_1e_8_over_one_second_at_the_default_step():
    # Step 1e-6 s. RK4 loses (omega h)^6/72 of a mode's energy a step: 3e-9 over 1 s of the fastest, 7.7e3 rad/s.
    energies = energies_of_motion(duration=1.0, sample_rate=5000.0, step=1e-6)
    assert np.abs(energies / energies[0] - 1.0).max() < 1e-8


def test_rk4_dissipates_energy_with_the_fifth_power_of_its_step():
    losses = []
    for step in (2e-5, 1e-5):
        energies = energies_of_motion(duration=0.1, sample_rate=5000.0, step=step)
        losses.append(1.0 - energies[-1] / energies[0])
    assert losses[1] > 0.0
    assert np.log2(losses[0] / losses[1]) == pytest.approx(5.0, abs=0.1)
