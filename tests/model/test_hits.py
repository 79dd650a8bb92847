"""Zones, smallest and safe hits, basins: published figures, and long runs of the engine that know no criterion."""

import math

import numpy as np
import pytest

from squeal_rig.errors import ModelError, ParameterError
from squeal_rig.model import (
    RigParameters,
    basin_share,
    contact_events,
    eigenvalues,
    equilibrium,
    safe_hit,
    smallest_hit,
    zone,
    zone_map,
)
from squeal_rig.model.cycles.safe import response_bounds
from squeal_rig.model.cycles.verdict import OUTLASTS, QUIET, SETTLES, judge
from squeal_rig.model.cycles.zone_map import BISTABLE, NAMES, UNKNOWN
from squeal_rig.model.cycles.zones import located
from squeal_rig.model.linear.eigen import state_matrix

from .hard_rigs import random_point, share_on_belt_after, zone_by_force
from .test_cycles import PLAIN, damped

POINT = damped(1000)
CYCLE_HAS_SETTLED = 0.3  # s: ten times the slowest decay at 1000 N s/m


@pytest.fixture(scope="module")
def known():
    return located(POINT)


def after(p, impulse, direction):
    """Share on the belt after a hit has settled."""
    x, y = equilibrium(p)
    kick = impulse / p.mass
    return share_on_belt_after(
        p, np.array([x, y, kick * math.cos(direction), kick * math.sin(direction)]), CYCLE_HAS_SETTLED
    )


# To the digits printed; at c = 20 the border has several crossings within its last digit.
@pytest.mark.parametrize(
    ("c", "degrees", "impulse", "digits"),
    [
        (1000, 0, 0.0637, 5e-5),
        (1000, 45, 0.0678, 5e-5),
        (1000, 90, 0.0277, 5e-5),
        (1000, 135, 0.0273, 5e-5),
        (20, 0, 0.0466, 1.5e-4),
        (20, 90, 0.0203, 5e-5),
        (20, 135, 0.0200, 5e-5),
    ],
)
def test_smallest_hits_by_direction(c, degrees, impulse, digits):
    p = damped(c)
    cycles = located(p)
    for turn in (0.0, math.pi):
        found = smallest_hit(p, math.radians(degrees) + turn, known=cycles)
        # The system is not symmetric, these hits are so to the last digit printed.
        assert found.impulse == pytest.approx(impulse, abs=2.0 * digits)


@pytest.mark.parametrize("degrees", [-70.0, 20.0, 110.0])
def test_both_ends_of_the_bracket_end_as_they_must_on_the_engine(known, degrees):
    direction = math.radians(degrees)
    found = smallest_hit(POINT, direction, tolerance=1e-6, known=known)
    low, high = found.bracket
    assert low < high <= low * (1.0 + 2e-6)
    assert after(POINT, low, direction) == 1.0
    # 0.1 s is no whole number of periods.
    assert after(POINT, high, direction) == pytest.approx(1.0 - known.zone.squeal.off_belt_share, abs=0.01)


def test_the_best_direction_is_not_beaten_by_any_other(known):
    best = smallest_hit(POINT, known=known)
    for angle in np.linspace(-math.pi, math.pi, 25):
        assert smallest_hit(POINT, float(angle), known=known).impulse > best.impulse * (1.0 - 2e-3)
    assert best.scan_step > 0.0
    assert best.upper_bound > best.impulse


def test_starts_just_inside_and_outside_the_separatrix_end_as_they_must(known):
    orbit, judged = known.separatrix, judge(POINT, known.squeal, known.separatrix)
    values, vectors = np.linalg.eig(orbit.return_map)
    unstable = vectors[:, np.argmax(np.abs(values))].real
    amplitude = known.zone.separatrix.peak_x
    unstable *= np.sign(unstable[0]) * 1e-6 * amplitude / np.max(np.abs(unstable[:2]))
    for sign, expected in ((-1.0, QUIET), (1.0, SETTLES)):
        start = np.array(orbit.state) + sign * np.array([unstable[0], unstable[1], 0.0, unstable[2]])
        assert judged.verdicts(start[None])[0][0] == expected
        assert (share_on_belt_after(POINT, start, 0.5) < 0.9999) == (expected == SETTLES)


def test_verdicts_without_the_cycles_are_the_same():
    """With nothing known of the cycles the motion is followed until it has outlasted every transient."""
    rng = np.random.default_rng(3)
    judged, blind = judge(POINT, *(located(POINT).squeal, located(POINT).separatrix)), judge(POINT)
    size = judged.compression * np.array([1.0, 1.0, judged.rate, judged.rate])
    starts = judged.rest + rng.uniform(-3.0, 3.0, (200, 4)) * size * rng.uniform(0.0, 1.0, (200, 1))
    found, unaided = judged.verdicts(starts)[0], blind.verdicts(starts)[0]
    assert set(found) == {QUIET, SETTLES}
    assert np.all((found == SETTLES) == (unaided == OUTLASTS))


def test_a_rig_that_squeals_by_itself_needs_no_hit():
    p = damped(200, pad_stiffness=6e7)
    found = smallest_hit(p)
    assert (found.impulse, found.bracket) == (0.0, (0.0, 0.0))
    assert safe_hit(p) == 0.0
    assert zone(p).name == "squeal"
    with pytest.raises(ModelError, match="unstable"):
        basin_share(p)


def test_a_quiet_rig_has_no_hit_that_starts_squeal():
    p = damped(1000, PLAIN, mu0=0.05)
    found = smallest_hit(p, 1.6)
    assert not found.found
    assert "no hit up to" in found.sentence
    assert str(zone(p)) == "quiet"
    assert basin_share(p, samples=50).share == 0.0


def test_hits_that_die_out_again_are_reported():
    # Close above the fold the basin of squeal is a thin shell: larger hits pass over it.
    p = damped(1000, PLAIN, mu0=0.0885)
    found = smallest_hit(p, 2.4, beyond=10.0)
    assert found.found
    assert found.larger
    for impulse in found.larger:
        assert after(p, impulse, 2.4) == 1.0


def test_safe_hits_never_leave_the_belt():
    impulse = safe_hit(POINT)
    x, y = equilibrium(POINT)
    for angle in np.arange(24) * math.pi / 12.0:
        kick = impulse / POINT.mass
        start = np.array([x, y, kick * math.cos(angle), kick * math.sin(angle)])
        assert len(contact_events(POINT, 0.2, initial_state=start).time) == 0


def test_the_response_bounds_hold_and_are_close():
    from scipy.linalg import expm

    matrix = state_matrix(POINT)
    rate = float(np.max(np.abs(np.linalg.eigvals(matrix))))
    scale = np.array([1.0, 1.0, rate, rate])
    unit = matrix * scale / scale[:, None] / rate
    highest_y, highest_r, total_y, total_r = response_bounds(unit)
    times = np.linspace(0.0, 600.0, 24001)
    step, state, ys, rs = expm(unit * times[1]), np.eye(4), [], []
    for _ in times:
        ys.append(np.hypot(*state[1, 2:]))
        rs.append(np.linalg.norm(state[:2, 2:]))
        state = step @ state
    # Proven bounds: never below the truth; the maxima close above it, the integrals within their tail's bound.
    assert np.max(ys) < highest_y < 1.01 * np.max(ys)
    assert np.max(rs) < highest_r < 1.01 * np.max(rs)
    for values, total in ((ys, total_y), (rs, total_r)):
        truth = np.sum(values) * times[1]
        assert truth < total < 2.0 * truth


@pytest.mark.parametrize("seed", range(6))
def test_the_safe_hit_is_below_the_smallest(seed):
    rng = np.random.default_rng(seed)
    found = 0
    while found == 0:
        p = random_point(rng)
        hit = smallest_hit(p, beyond=1.0)
        if hit.found:
            found += 1
            assert safe_hit(p) <= hit.bracket[1]


def test_basin_shares_do_not_depend_on_threads_and_have_an_interval():
    one, two = (basin_share(POINT, 2.0, 300, 7, threads) for threads in (1, 2))
    assert one == two
    assert one.interval[0] < one.share < one.interval[1]
    assert sum(one.verdicts.values()) == 300
    assert len({basin_share(POINT, 2.0, 300, seed).share for seed in range(5)}) > 1
    inner = basin_share(POINT, 0.05, 100)
    assert (inner.share, inner.interval[0]) == (0.0, 0.0)


def test_a_basin_of_given_bounds_agrees_with_long_runs():
    x, y = equilibrium(POINT)
    speed = 0.003
    region = np.array([[0.0, 0.0], [0.0, 0.0], [-speed, speed], [-speed, speed]])
    found = basin_share(POINT, region, 60, 1)
    speeds = np.random.default_rng(1).random((60, 4))[:, 2:] * 2.0 * speed - speed
    squeals = [
        share_on_belt_after(POINT, np.array([x, y, vx, vy]), CYCLE_HAS_SETTLED) < 0.9999 for vx, vy in speeds.tolist()
    ]
    assert 0 < sum(squeals) < 60
    assert found.share == np.mean(squeals)


@pytest.mark.parametrize("seed", range(4))
def test_zones_agree_with_brute_force(seed):
    p = random_point(np.random.default_rng(100 + seed))
    assert zone(p).name == zone_by_force(p)[0]


def test_margins_tell_how_far_both_borders_are():
    found = zone(POINT)
    assert found.name == "bistable"
    assert found.to_fold_mu == pytest.approx(found.mu - 0.0878, abs=5e-5)
    assert found.to_flutter_mu == pytest.approx(found.mu - 0.39476, abs=5e-6)
    assert found.to_fold_pad_stiffness > 0.0 > found.to_flutter_pad_stiffness
    at_fold = POINT.replace(mu0=POINT.mu0 - found.to_fold_mu)
    assert zone(at_fold.replace(mu0=at_fold.mu0 - 1e-6)).name == "quiet"
    assert zone(at_fold.replace(mu0=at_fold.mu0 + 1e-6)).name == "bistable"
    at_flutter = POINT.replace(mu0=POINT.mu0 - found.to_flutter_mu)
    assert zone(at_flutter.replace(mu0=at_flutter.mu0 - 1e-6)).name == "bistable"
    assert zone(at_flutter.replace(mu0=at_flutter.mu0 + 1e-6)).name == "squeal"


def test_a_rig_that_cannot_flutter_says_why_it_has_no_border():
    p = damped(200).replace(arm_angle_2=0.25 * math.pi)
    found = zone(p)
    assert np.max(eigenvalues(p).real) < 0.0
    assert math.isnan(found.flutter_mu)
    assert any("flutter" in reason for reason in found.reasons)


def test_a_map_of_zones_is_the_zones_of_its_points():
    preload, speed = np.linspace(20.0, 300.0, 5)[:, None], np.linspace(1.0, 4.0, 4)[None, :]
    found = zone_map(damped(200), hits=True, preload=preload, belt_speed=speed)
    assert found.zone.shape == (5, 4)
    assert found.border_error < 1e-6
    for i, j in ((0, 0), (2, 1), (4, 0), (3, 3)):
        p = damped(200, preload=float(preload[i, 0]), belt_speed=float(speed[0, j]))
        alone = zone(p)
        assert ("quiet", "bistable", "squeal")[found.zone[i, j]] == alone.name
        assert found.fold_mu[i, j] == pytest.approx(alone.fold_mu, abs=1e-7)
        assert found.flutter_mu[i, j] == pytest.approx(alone.flutter_mu, abs=1e-7)
        hit = smallest_hit(p, beyond=1.0)
        assert found.smallest_hit[i, j] == pytest.approx(hit.impulse, rel=0.02)


def test_a_map_over_machines_does_not_depend_on_threads():
    grids = {"pad_stiffness": np.linspace(1e7, 6e7, 4)[:, None], "mu0": np.linspace(0.02, 0.6, 5)[None, :]}
    one, two = (zone_map(damped(500, PLAIN), threads=threads, **grids) for threads in (1, 2))
    assert np.array_equal(one.zone, two.zone)
    assert np.array_equal(one.fold_mu, two.fold_mu)
    assert {0, 1, 2} == set(one.zone.ravel().tolist())


def test_wrong_arguments_are_refused_by_a_sentence():
    for changes in ({"direction": math.nan}, {"upper_bound": 0.0}, {"scan_step": -1.0}, {"tolerance": 0.0}):
        with pytest.raises(ParameterError, match=next(iter(changes))):
            smallest_hit(POINT, **changes)
    with pytest.raises(ParameterError, match="samples"):
        basin_share(POINT, samples=0)
    with pytest.raises(ParameterError, match="region"):
        basin_share(POINT, region=-1.0)
    with pytest.raises(ParameterError, match="not a parameter"):
        zone_map(POINT, arm_length_1=[0.1])
    for function in (smallest_hit, safe_hit, basin_share, zone_map):
        with pytest.raises(ModelError, match="nothing dies out"):
            function(RigParameters())


def test_a_rig_without_a_flutter_threshold_within_the_bounds_of_mu_is_not_called_quiet():
    """At 2000 N s/m and so soft the threshold is at mu = 11, beyond the bound of mu0; the fold in k is at 1.03e6."""
    p = damped(2000, pad_stiffness=1.2e6)
    found = zone(p)
    assert found.fold_pad_stiffness == pytest.approx(1.03e6, rel=0.01)
    assert math.isnan(found.flutter_mu)
    assert (found.name, found.squeal.stable, found.separatrix is not None) == ("bistable", True, True)
    assert share_on_belt_after(p, found.squeal.state, 1.0) < 0.9999
    assert zone(p.replace(pad_stiffness=1.0e6)).name == "quiet"
    mapped = zone_map(p, pad_stiffness=[1.0e6, 1.2e6, 4e7])
    assert mapped.zone.tolist() == [QUIET, BISTABLE, BISTABLE]
    assert next(iter(mapped.reasons)).startswith("no mu0 within its bounds makes the equilibrium flutter")


def test_a_map_does_not_know_a_zone_that_changes_between_borders_that_it_does_not_know():
    p = damped(2000, pad_stiffness=1.2e6)
    law = {"mu_speed": 0.0, "mu_preload": 0.0, "mu_speed_preload": 0.0}
    mapped = zone_map(p.replace(**law), mu0=[0.01, 0.35])  # no squeal at the first
    assert zone(p.replace(**law, mu0=0.01)).name == "quiet"
    assert mapped.zone.tolist() == [UNKNOWN, UNKNOWN]
    assert NAMES[UNKNOWN] == "not known"
