"""Squeal cycles, their branches and folds: published figures, an independent solver, what no solver can choose."""

import math

import numpy as np
import pytest

from squeal_rig.errors import ModelError, ParameterError
from squeal_rig.model import (
    RigParameters,
    contact_events,
    displaced_state,
    eigenvalues,
    equilibrium,
    fold_curve,
    follow_cycle,
    simulate,
    squeal_cycle,
    zone,
)
from squeal_rig.model.core.layout import pack
from squeal_rig.model.cycles import flow
from squeal_rig.model.cycles.path import Path
from squeal_rig.model.motion.propagator import fastest_rate
from squeal_rig.model.motion.trajectory import Motion

from .dop853 import reference

#: Friction coefficient mu0 alone.
PLAIN = RigParameters().replace(mu_speed=0.0, mu_preload=0.0, mu_speed_preload=0.0)


def damped(c, base=None, **changes):
    return (base or RigParameters()).replace(damping_x=float(c), damping_y=float(c), **changes)


POINT = damped(200)


@pytest.fixture(scope="module")
def branch():
    return follow_cycle(POINT, squeal_cycle(POINT), "mu0", bounds=(-0.1, 0.5))


def flowed(p, start, time, field="mu0"):
    """End state, its derivative by the start (4, 4) and by a field (4,)."""
    path, z, v = Path(p, field), np.array(start), np.zeros((4, 5))
    v[:4, :4] = np.eye(4)
    w, tally = np.zeros((flow.ROWS, flow.ORDER + 1)), np.zeros(flow.TALLY_SIZE)
    q, longest = pack(p), flow.RATE_TIMES_STEP / fastest_rate(pack(p))
    assert flow.follow(z, v, q, path.derivative(path.value), time, longest, True, False, w, tally, np.empty((0, 4)))
    return z, v[:, :4], v[:, 4]


def test_the_flow_agrees_with_dop853_through_contact_events():
    start = displaced_state(POINT, 3.0)
    expected, events = reference(POINT, start, np.array([0.0, 2e-3]))
    found, _, _ = flowed(POINT, start, 2e-3)
    assert len(events) >= 3
    # DOP853 loses about 1e-12 a step.
    assert np.max(np.abs(found[:2] - expected[-1, :2])) < 1e-10 * np.max(np.abs(expected[-1, :2]))


# Fields of every kind: stiffness, friction, load, damping, mass, contact, geometry; unequal arms, preload along them.
FIELDS = "pad_stiffness mu0 preload belt_speed damping_y mass k3 contact_stiffness pretension_length arm_angle_1"


@pytest.mark.parametrize("field", [*FIELDS.split(), "arm_length_2"])
def test_the_derivative_by_a_field_is_that_of_the_flow(field):
    p = damped(200, k1=3e7, arm_angle_1=2.2, preload_direction="arms")
    start, path = displaced_state(p, 3.0), Path(p, field)
    _, _, derivative = flowed(p, start, 1e-3, field)
    # Central differences of fourth order; the step is that share of the field which moves the edge by 1e-3 u at most.
    step = 1e-4 * path.value if field != "pretension_length" else 1e-10
    ends = {n: flowed(path.rig(path.value + n * step), start, 1e-3)[0] for n in (-2, -1, 1, 2)}
    expected = (8.0 * (ends[1] - ends[-1]) - (ends[2] - ends[-2])) / (12.0 * step)
    units = np.array([1e-6, 1e-6, 7e-3, 7e-3])
    assert np.max(np.abs((derivative - expected) / units)) < 2e-6 * np.max(np.abs(derivative / units))


def test_one_point_to_every_digit():
    at = zone(POINT)
    squeal, separatrix = at.squeal, at.separatrix
    assert squeal.frequency == pytest.approx(994.4029, abs=5e-5)
    assert squeal.off_belt_share == pytest.approx(0.5232, abs=5e-5)
    assert squeal.multipliers == pytest.approx([1.0, 0.528863 + 0.838430j, 0.528863 - 0.838430j, 0.982661], abs=1e-6)
    assert squeal.stable
    assert separatrix.frequency == pytest.approx(1140.352, abs=5e-4)
    assert separatrix.off_belt_share == pytest.approx(0.1587, abs=1e-4)
    assert separatrix.multipliers == pytest.approx([1.0, 1.85719, 0.98486, 0.53030], abs=5e-6)
    assert not separatrix.stable


@pytest.mark.parametrize(
    ("c", "preload", "frequency", "share"),
    [(20, 50.0, 994.391, 0.5232), (1000, 50.0, 994.698, None), (20, 300.0, 961.41, 0.570)],
)
def test_damping_hardly_moves_the_squeal_cycle(c, preload, frequency, share):
    found = squeal_cycle(damped(c, preload=preload))
    assert found.frequency == pytest.approx(frequency, abs=5e-4 if preload == 50.0 else 5e-3)
    if share is not None:
        assert found.off_belt_share == pytest.approx(share, abs=5e-4)
    if preload == 300.0:
        assert found.multipliers[1:] == pytest.approx([0.251 + 0.967j, 0.251 - 0.967j, 0.9982], abs=6e-4)


def test_the_share_off_the_belt_is_that_of_dop853():
    separatrix = zone(POINT).separatrix
    # At its maximum of x the pad is off the belt.
    assert separatrix.state[1] > POINT.pretension_length
    meets, leaves = reference(POINT, separatrix.state, np.array([0.0, separatrix.period]))[1]
    assert separatrix.off_belt_share == pytest.approx(1.0 - (leaves - meets) / separatrix.period, abs=1e-9)


def test_a_cycle_closes_in_dop853_with_the_same_multipliers():
    found = squeal_cycle(POINT)
    times = np.array([0.0, found.period])
    end = reference(POINT, found.state, times)[0][-1]
    size = np.array([found.peak_x, found.peak_y, 0.02, 0.02])
    assert np.max(np.abs((end - found.state) / size)) < 1e-9
    matrix = np.empty((4, 4))
    for i in range(4):
        step = np.zeros(4)
        step[i] = 1e-4 * size[i]
        ends = [reference(POINT, found.state + sign * step, times)[0][-1] for sign in (1.0, -1.0)]
        matrix[:, i] = (ends[0] - ends[1]) / (2.0 * step[i])
    expected = np.linalg.eigvals(matrix)
    for multiplier in found.multipliers:
        # Central differences at 1e-4 of the amplitude.
        assert np.min(np.abs(expected - multiplier)) < 1e-6


# k, c: fold in mu, its frequency (0.4 Hz: the cycle moves fast there), flutter in mu, its frequency.
TABLE = [
    (200, 2e7, 0.0431, 1034.5, 0.69350, 1128.25),
    (200, 4e7, 0.0855, 1058.2, 0.39284, 1147.61),
    (200, 6e7, 0.1270, 1083.1, 0.31311, 1166.64),
    (1000, 4e7, 0.0878, 1058.3, 0.39476, 1147.61),
    (4000, 4e7, 0.1237, 1059.2, 0.42472, 1147.61),
    (4000, 1e7, 0.1671, 1023.8, 1.46205, 1118.44),
]


@pytest.mark.parametrize(("c", "k", "fold", "fold_frequency", "flutter", "end_frequency"), TABLE)
def test_folds_and_ends_of_the_branch_in_mu(c, k, fold, fold_frequency, flutter, end_frequency):
    p = damped(c, PLAIN, mu0=0.3, pad_stiffness=k)
    found = follow_cycle(p, squeal_cycle(p), "mu0", bounds=(0.0, 2.0))
    assert [special.parameter for special in found.folds] == [pytest.approx(fold, abs=5e-5)]
    assert found.folds[0].frequency == pytest.approx(fold_frequency, abs=0.4)
    end = next(end for end in found.ends if end.how == "flutter threshold")
    assert end.parameter == pytest.approx(flutter, abs=5e-6)
    assert end.frequency == pytest.approx(end_frequency, abs=5e-3)
    assert sorted(end.how for end in found.ends) == ["bound", "flutter threshold"]


# The figure found by the engine alone for c = 4000 is 4.28e6 N/m, 1.2 % above: the next test shows a cycle below it.
@pytest.mark.parametrize(
    ("c", "fold", "flutter"), [(2000, 1.03e6, 4.974e7), (4000, 4.231e6, 5.497e7), (8000, 1.92e7, 8.70e7)]
)
def test_folds_in_the_pad_stiffness(c, fold, flutter):
    found = zone(damped(c))
    assert found.fold_pad_stiffness == pytest.approx(fold, rel=5e-3)
    assert found.flutter_pad_stiffness == pytest.approx(flutter, rel=1e-3)


def test_a_stable_cycle_stands_just_above_the_fold_in_the_pad_stiffness_in_dop853_too():
    p = damped(4000, pad_stiffness=4.24e6)
    found = zone(p).squeal
    assert found.stable
    end = reference(p, found.state, np.array([0.0, found.period]))[0][-1]
    assert np.max(np.abs(end - found.state)[:2]) < 1e-9 * found.peak_y
    assert zone(p.replace(pad_stiffness=4.22e6)).name == "quiet"


def test_every_point_of_a_branch_meets_liouville_and_its_own_direction(branch):
    assert len(branch.points) > 30
    assert np.max(branch.points["volume_error"]) < 1e-9
    assert np.max(branch.points["flow_error"]) < 1e-9


def test_a_fold_is_a_simple_multiplier_1_of_the_return_map(branch):
    (fold,) = branch.folds
    others = np.sort(np.abs(fold.multipliers[1:] - 1.0))
    assert others[0] < 1e-6
    assert others[1] > 1e-3
    # It is the least parameter of the branch, and stability changes there.
    lowest = np.argmin(branch.points["parameter"])
    assert fold.parameter <= branch.points["parameter"][lowest] + 1e-12
    stable = branch.points["stable"][branch.points["off_belt_share"] > 0.0]
    assert stable[0] != stable[-1]
    assert np.count_nonzero(stable[1:] != stable[:-1]) == 1


def test_a_period_doubling_is_a_multiplier_of_minus_1():
    p = damped(1000, PLAIN, mu0=0.3)
    found = follow_cycle(p, squeal_cycle(p), "mu0", bounds=(0.2, 8.5))
    (doubling,) = [special for special in found.specials if special.kind == "period doubling"]
    assert np.min(np.abs(doubling.multipliers + 1.0)) < 1e-7
    before = found.points[np.searchsorted(found.points["parameter"][found.points["stable"]], doubling.parameter) - 1]
    assert before["parameter"] < doubling.parameter
    rig = p.replace(mu0=doubling.parameter * 1.01)
    assert not squeal_cycle(rig, found.cycles_at(rig.mu0)[0]).stable


def test_a_branch_without_a_flutter_threshold_closes_on_itself():
    p = damped(2450.5, PLAIN, mu0=0.12, preload=240.2, pad_stiffness=7.471e6)
    found = follow_cycle(p, squeal_cycle(p), "pad_stiffness")
    assert [end.how for end in found.ends] == ["closed", "closed"]
    assert len(found.folds) == 2
    assert zone(p).fold_pad_stiffness == pytest.approx(min(fold.parameter for fold in found.folds), rel=1e-9)
    assert math.isnan(zone(p).flutter_pad_stiffness)


def test_cycles_at_a_value_are_those_of_the_zone(branch):
    found = branch.cycles_at(POINT.mu0)
    assert sorted(cycle.frequency for cycle in found) == pytest.approx([994.4029, 1140.352], abs=5e-4)


@pytest.mark.parametrize("seed", range(3))
def test_the_unstable_end_meets_the_threshold_of_the_eigenvalues(seed):
    from .hard_rigs import flutter_by_eigenvalues, followed, random_hard_rig

    p = random_hard_rig(np.random.default_rng(seed))
    found, threshold = followed(p)
    mu, frequency = flutter_by_eigenvalues(p, threshold)
    end = next(end for end in found.ends if end.how == "flutter threshold")
    assert end.parameter == pytest.approx(mu, rel=1e-4)
    assert end.frequency == pytest.approx(frequency, rel=1e-4)


def test_settled_squeal_of_a_simulation_has_the_cycles_frequency():
    p = damped(1000)
    found = squeal_cycle(p)
    motion, block = Motion(p, 51200.0, displaced_state(p, 3.0)), np.empty((512, 6))
    for _ in range(60):
        motion.advance(block)
    events = contact_events(p, 0.2, initial_state=motion.state)
    leaves = events.time[events.leaves]
    measured = (len(leaves) - 1) / (leaves[-1] - leaves[0])
    assert measured == pytest.approx(found.frequency, rel=1e-5)


def test_states_and_peaks_are_those_of_a_simulation():
    found = squeal_cycle(POINT)
    run = simulate(POINT, found.period * (1.0 - 0.5 / 256), 256.0 / found.period, found.state)
    assert found.states[:, 0] == pytest.approx(run.x, abs=1e-9 * found.peak_x)
    assert found.states[:, 1] == pytest.approx(run.y, abs=1e-9 * found.peak_x)
    assert found.times == pytest.approx(run.t, abs=1e-15)
    x, y = equilibrium(POINT)
    # Between two of 256 samples a peak is higher by 1e-4 at most.
    assert found.peak_x == pytest.approx(np.max(np.abs(run.x - x)), rel=1e-4)
    assert found.peak_y == pytest.approx(np.max(np.abs(run.y - y)), rel=1e-4)
    assert abs(found.state[2]) < 1e-12
    assert np.argmax(found.states[:, 0]) == 0


def test_a_start_near_a_cycle_finds_it_stable_or_not():
    at = zone(POINT)
    for cycle in (at.squeal, at.separatrix):
        for start in (cycle, cycle.state, cycle.states[77] * (1.0 + 1e-5)):
            assert squeal_cycle(POINT, start).frequency == pytest.approx(cycle.frequency, rel=1e-9)


def test_a_start_that_dies_out_says_so():
    found = squeal_cycle(POINT, displaced_state(POINT, 0.1))
    assert found.ending == "dies out"
    assert math.isnan(found.frequency)
    assert not found.found
    quiet = squeal_cycle(damped(200, PLAIN, mu0=0.05))
    assert quiet.ending == "dies out"


def test_a_rig_that_squeals_by_itself_has_a_cycle():
    p = damped(200, pad_stiffness=6e7)
    assert np.max(eigenvalues(p).real) > 0.0
    found = squeal_cycle(p, displaced_state(p, 0.1))
    assert found.found
    assert found.frequency == pytest.approx(squeal_cycle(p).frequency, rel=1e-9)


@pytest.mark.parametrize("function", [squeal_cycle, zone])
@pytest.mark.parametrize(
    ("p", "words"),
    [
        (RigParameters(), "nothing dies out"),
        (damped(200, friction_direction="slip"), "constant direction"),
        (damped(200, friction_speed="slip"), "belt speed"),
    ],
)
def test_rigs_without_cycles_are_refused_by_a_sentence(function, p, words):
    with pytest.raises(ModelError, match=words):
        function(p)


def test_wrong_fields_and_bounds_are_refused(branch):
    cycle = squeal_cycle(POINT)
    with pytest.raises(ParameterError, match="no numeric field"):
        follow_cycle(POINT, cycle, "friction_speed")
    with pytest.raises(ParameterError, match="between them"):
        follow_cycle(POINT, cycle, "mu0", bounds=(0.3, 0.5))
    with pytest.raises(ParameterError, match="the same"):
        fold_curve(POINT, "mu0", "mu0", [0.1])
    with pytest.raises(ParameterError, match="finite numbers"):
        fold_curve(POINT, "mu0", "damping_x", [math.nan])
    with pytest.raises(ModelError, match="no cycle to follow"):
        follow_cycle(POINT, squeal_cycle(POINT, displaced_state(POINT, 0.1)), "mu0")
    with pytest.raises(ModelError, match="none of this rig"):
        follow_cycle(damped(200, PLAIN, mu0=0.01), cycle, "mu0")


@pytest.mark.parametrize("field", ["preload", "damping_x", "arm_angle_1", "mu_speed_preload"])
def test_a_branch_in_any_field_is_one_of_closed_orbits(field):
    found = follow_cycle(damped(1000), squeal_cycle(damped(1000)), field, points=25)
    assert len(found.points) > 10
    assert np.max(found.points["flow_error"]) < 1e-9
    assert np.max(found.points["volume_error"]) < 1e-9
    point = found.points[0]
    p = Path(damped(1000), field).rig(float(point["parameter"]))
    end = reference(p, point["state"], np.array([0.0, 1.0 / point["frequency"]]))[0][-1]
    assert np.max(np.abs(end - point["state"])[:2]) < 1e-9 * max(point["peak_x"], point["peak_y"])


def test_a_fold_curve_passes_through_the_folds_of_single_rigs():
    base = damped(200, PLAIN, mu0=0.3)
    found = fold_curve(base, "mu0", "pad_stiffness", np.linspace(2e7, 6e7, 5))
    assert not found.reasons
    assert found.fold[[0, 2, 4]] == pytest.approx([0.0431, 0.0855, 0.1270], abs=5e-5)
    for k, fold in zip(found.values, found.fold, strict=True):
        assert zone(base.replace(pad_stiffness=k)).fold_mu == pytest.approx(fold, abs=1e-9)


def test_the_preload_does_not_enter_the_fold_but_through_mu():
    found = fold_curve(damped(1000, PLAIN, mu0=0.3), "mu0", "preload", [10.0, 150.0, 300.0])
    # The arms' geometry is all that breaks the homogeneity: r/L.
    assert np.ptp(found.fold) < 1e-5 * found.fold[0]
