"""Many runs at once: the numbers of single runs, whatever the number of threads."""

import numpy as np
import pytest

from squeal_rig.errors import ParameterError
from squeal_rig.model import (
    RigParameters,
    contact_events,
    displaced_state,
    eigenvalues,
    energy_balance,
    equilibrium,
    simulate,
    simulate_many,
)
from squeal_rig.model.motion.ensemble import STATUS

RATE = 51200.0
SQUEALING = RigParameters().replace(preload=300.0, belt_speed=1.0, pad_stiffness=6e7, damping_x=20.0, damping_y=20.0)


def grid():
    return [
        SQUEALING.replace(preload=preload, pad_stiffness=stiffness)
        for preload in (50.0, 150.0, 300.0)
        for stiffness in np.linspace(2e7, 1e8, 7)
    ]


def test_summaries_are_those_of_the_single_runs():
    rigs = grid()[::4]
    found = simulate_many(rigs, 0.1, settle=0.02, initial_compressions=2.0, traces=True)
    settled = round(0.02 * RATE)
    for p, row, trace in zip(rigs, found.summaries, found.traces, strict=True):
        run = simulate(p, 0.12, initial_state=displaced_state(p, 2.0))
        kept = np.column_stack([run.x, run.y, run.vx, run.vy, run.normal_force, run.tangential_force])
        np.testing.assert_allclose(trace, kept[settled : settled + len(trace)], rtol=1e-6, atol=1e-12)
        x0, y0 = equilibrium(p)
        assert row["peak_x"] == pytest.approx(np.max(np.abs(trace[:, 0] - x0)), rel=1e-9)
        assert row["peak_y"] == pytest.approx(np.max(np.abs(trace[:, 1] - y0)), rel=1e-9)
        assert row["rms_x"] == pytest.approx(np.sqrt(np.mean((trace[:, 0] - x0) ** 2)), rel=1e-9)
        assert row["contact_share"] * 0.1 + row["contact_loss_time"] == pytest.approx(0.1)
        # The share of samples without contact differs from the exact one by a sample at each of some 200 events.
        assert row["contact_loss_time"] == pytest.approx(np.mean(trace[:, 4] == 0.0) * 0.1, abs=2e-4)


def test_time_off_the_belt_and_separations_are_exact():
    events = contact_events(SQUEALING, 0.1, RATE, displaced_state(SQUEALING, 3.0))
    row = simulate_many([SQUEALING], 0.1, initial_compressions=3.0).summaries[0]
    assert row["separations"] == events.leaves.sum()
    assert row["contact_loss_time"] == pytest.approx(events.duration - events.contact_time, rel=1e-9)
    # On the belt from the start, so it is off it from each odd event to the next.
    ends = np.append(events.time, events.duration)
    off = np.sum(ends[1::2]) - np.sum(ends[0 : 2 * len(ends[1::2]) : 2])
    assert events.duration - events.contact_time == pytest.approx(off, rel=1e-9)


def test_results_do_not_depend_on_the_number_of_threads():
    one = simulate_many(grid(), 0.05, initial_compressions=3.0, threads=1).summaries
    for threads in (2, 5):
        assert (
            simulate_many(grid(), 0.05, initial_compressions=3.0, threads=threads).summaries.tobytes() == one.tobytes()
        )


def test_the_limit_cycle_is_the_published_one_of_a_slower_simulator():
    # Shares off the belt and frequencies at c = 20...200 N s/m, k = 2...10e7, three digits (docs/physics.md, 5).
    rigs = [SQUEALING.replace(pad_stiffness=k, damping_x=60.0, damping_y=60.0) for k in (2e7, 4e7, 6e7, 8e7, 1e8)]
    rows = simulate_many(rigs, 0.5, settle=1.0).summaries
    np.testing.assert_allclose(1.0 - rows["contact_share"], [0.545, 0.570, 0.582, 0.587, 0.589], atol=2e-3)
    np.testing.assert_allclose(rows["squeal_frequency"], [959.0, 961.0, 974.0, 991.0, 1011.0], atol=1.0)


def test_growth_and_frequency_of_a_small_motion_are_those_of_the_eigenvalue():
    p = SQUEALING.replace(damping_x=5.0, damping_y=5.0, preload=60.0)
    value = eigenvalues(p)[0]
    assert value.real > 0.0
    row = simulate_many([p], 0.04, settle=0.02, initial_compressions=1e-9).summaries[0]
    assert row["separations"] == 0
    # Blocks of 10 ms hold no whole number of periods.
    assert row["growth_rate"] == pytest.approx(value.real, rel=5e-3)
    assert row["squeal_frequency"] == pytest.approx(abs(value.imag) / (2.0 * np.pi), rel=1e-4)


def test_a_run_without_equilibrium_says_so_and_leaves_the_others_alone():
    lifted = SQUEALING.replace(pretension_length=0.0, preload=0.0, arm_angle_1=-2.0, arm_angle_2=-2.0)
    rows = simulate_many([SQUEALING, lifted, SQUEALING], 0.02).summaries
    assert STATUS[rows["status"][1]] == "no equilibrium in contact to start from"
    assert np.isnan(rows["peak_y"][1])
    assert rows[0].tobytes() == rows[2].tobytes()
    assert rows["status"][0] == 0


def test_one_set_and_arrays_give_the_bits_of_a_list():
    preloads, stiffnesses = np.array([[50.0], [150.0], [300.0]]), np.linspace(2e7, 1e8, 7)
    found = simulate_many(
        SQUEALING, 0.02, initial_compressions=3.0, traces=True, preload=preloads, pad_stiffness=stiffnesses
    )
    expected = simulate_many(grid(), 0.02, initial_compressions=3.0, traces=True)
    assert found.summaries.shape == (3, 7)
    assert found.traces.shape == (3, 7, 1024, 6)
    assert found.summaries.tobytes() == expected.summaries.tobytes()
    assert found.traces.tobytes() == expected.traces.tobytes()


def test_the_start_alone_can_vary_and_switches_are_those_of_the_one_set():
    slips = SQUEALING.replace(friction_direction="slip", belt_speed=0.05)
    starts = np.array([0.5, 3.0])
    rows = simulate_many(slips, 0.02, initial_compressions=starts).summaries
    for compressions, row in zip(starts, rows, strict=True):
        run = simulate(slips, 1023 / RATE, initial_state=displaced_state(slips, compressions))
        assert row["peak_y"] == pytest.approx(np.max(np.abs(run.y - equilibrium(slips)[1])), rel=1e-9)
    assert simulate_many(slips, 0.02).summaries.shape == ()


@pytest.mark.parametrize("friction", [{"friction_direction": "slip"}, {"friction_speed": "slip", "mu_speed": 0.01}])
def test_summaries_with_friction_that_sees_the_slip_do_not_depend_on_the_threads(friction):
    p = SQUEALING.replace(belt_speed=0.1, mu0=0.3, **friction)
    preloads = np.linspace(50.0, 300.0, 20)
    one, two = (
        simulate_many(p, 0.02, initial_compressions=3.0, threads=threads, preload=preloads).summaries
        for threads in (1, 2)
    )
    assert one.tobytes() == two.tobytes()
    assert (one["status"] == 0).all()


@pytest.mark.parametrize(
    ("varied", "sentence"),
    [
        ({"preload": [1.0, -1.0]}, "preload"),
        ({"friction_speed": ["slip"]}, "'friction_speed' is not a parameter of many runs"),
        ({"preload": [1.0, 2.0], "mass": [1.0, 2.0, 3.0]}, "do not broadcast to one grid"),
        ({"preload": [1.0, 2.0], "initial_compressions": [1.0, 2.0, 3.0]}, "does not broadcast with what varies"),
    ],
)
def test_what_cannot_vary_is_refused_with_a_sentence(varied, sentence):
    with pytest.raises(ParameterError, match=sentence):
        simulate_many(SQUEALING, 0.01, **varied)


def test_nothing_varies_over_a_list():
    with pytest.raises(ParameterError, match="'preload' cannot vary over a list of parameters"):
        simulate_many([SQUEALING], 0.01, preload=[1.0])


def test_no_runs_give_no_summaries():
    assert simulate_many([], 0.1).summaries.shape == (0,)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"duration": 0.0}, "duration = 0.0 s is out of bounds"),
        ({"duration": 0.1, "settle": -1.0}, "settle = -1.0 s is out of bounds"),
        ({"duration": 0.1, "threads": 0}, "threads = 0 is out of bounds"),
        ({"duration": 0.1, "initial_compressions": [1.0, 2.0]}, "one for each of 1 runs"),
    ],
)
def test_bad_arguments_are_refused_with_a_sentence(arguments, sentence):
    with pytest.raises(ParameterError, match=sentence):
        simulate_many([SQUEALING], **arguments)


def test_a_run_that_fails_leaves_no_samples_of_another_run():
    # Friction that falls with the slip without end, and a pad that hardly anything holds.
    lost = RigParameters().replace(pad_stiffness=0.0, k3=1.0, k4=1.0, friction_speed="slip", mu_speed=-10.0)
    ensemble = simulate_many([lost], 3.0, sample_rate=8192.0, traces=True)
    assert ensemble.summaries["status"][0] != 0
    assert np.isnan(ensemble.traces[0, -1]).all()
    finite = np.isfinite(ensemble.traces[0]).all(axis=1)
    # Whole blocks or nothing: no row between is half filled.
    assert not finite[np.argmin(finite) :].any()


def test_energy_of_a_negative_time_is_refused():
    with pytest.raises(ParameterError, match=r"^duration = -1.0 s is out of bounds: it must be above 0 s$"):
        energy_balance(SQUEALING, -1.0)
