"""The same at length, run by `make test-slow` and `make test-long` (ARGS=-s shows what was measured): thirty rigs, two
hundred points by force, five hundred hits.
"""

import math
import sys

import numpy as np
import pytest

from squeal_rig.model import (
    RigParameters,
    contact_events,
    displaced_state,
    eigenvalues,
    safe_hit,
    simulate,
    smallest_hit,
    squeal_cycle,
    zone,
)
from squeal_rig.model.cycles.verdict import OUTLASTS, SETTLES, judge
from squeal_rig.model.cycles.zones import located
from squeal_rig.model.motion.trajectory import Motion

from .hard_rigs import (
    flutter_by_eigenvalues,
    followed,
    random_hard_rig,
    random_point,
    share_on_belt_after,
    zone_by_force,
)


@pytest.mark.slow
def test_thirty_branches_meet_the_flutter_threshold():
    rng = np.random.default_rng(11)
    for _ in range(30):
        p = random_hard_rig(rng)
        found, threshold = followed(p)
        mu, frequency = flutter_by_eigenvalues(p, threshold)
        end = next(end for end in found.ends if end.how == "flutter threshold")
        assert end.parameter == pytest.approx(mu, rel=1e-4)
        assert end.frequency == pytest.approx(frequency, rel=1e-4)
        assert np.max(found.points["flow_error"]) < 1e-9
        assert np.max(found.points["volume_error"]) < 1e-9


@pytest.mark.long
def test_two_hundred_zones_agree_with_brute_force_but_for_thin_basins():
    rng = np.random.default_rng(5)
    thin = []
    for _ in range(200):
        p = random_point(rng)
        found, (expected, _, _) = zone(p), zone_by_force(p)
        if found.name == expected:
            continue
        # The cycle is there and holds the motion, but hits in eight directions pass over its thin basin: only in the
        # first part of the way from the fold to flutter.
        assert (found.name, expected) == ("bistable", "quiet")
        assert found.squeal.stable
        thin.append(found.to_fold_mu / (found.flutter_mu - found.fold_mu))
        settle = 10.0 / -np.max(eigenvalues(p).real)
        assert share_on_belt_after(p, found.squeal.state, settle) < 0.9999
    sys.stdout.write(f"{len(thin)} of 200 points are bistable with a basin that hits pass over, at shares {thin}\n")
    assert len(thin) < 10
    assert max(thin, default=0.0) < 0.1


@pytest.mark.long
def test_five_hundred_safe_hits_are_below_the_smallest():
    rng = np.random.default_rng(7)
    ratios = []
    while len(ratios) < 500:
        p = random_point(rng)
        at = located(p)
        if at.zone.name != "bistable":
            continue
        hit = smallest_hit(p, beyond=1.0, known=at)
        if hit.found:
            ratios.append(safe_hit(p) / hit.bracket[1])
    sys.stdout.write(
        f"safe over smallest: largest {max(ratios):.3f}, median {np.median(ratios):.3f}, least {min(ratios):.3f}\n"
    )
    assert max(ratios) <= 1.0
    # A bound that is of use: half of them within a factor of two.
    assert np.median(ratios) > 0.5


@pytest.mark.slow
def test_settled_squeal_has_the_cycles_frequency_wherever_it_is_reached():
    rng = np.random.default_rng(9)
    compared, worst = 0, 0.0
    for _ in range(60):
        p = random_point(rng)
        found = squeal_cycle(p)
        if not (found.found and found.stable):
            continue
        slowest = -math.log(np.max(np.abs(found.multipliers[1:]))) * found.frequency
        motion, block = Motion(p, 51200.0, displaced_state(p, 3.0)), np.empty((512, 6))
        for _ in range(int(min(25.0 / slowest, 60.0) * 100.0) + 1):
            motion.advance(block)
        events = contact_events(p, 0.2, initial_state=motion.state)
        leaves = events.time[events.leaves]
        if len(leaves) < 3:
            continue  # it died out from this start
        compared += 1
        measured = (len(leaves) - 1) / (leaves[-1] - leaves[0])
        worst = max(worst, abs(measured / found.frequency - 1.0))
        assert measured == pytest.approx(found.frequency, rel=1e-5)
    sys.stdout.write(f"{compared} settled motions, frequency off by {worst:.1e} at most\n")
    assert compared > 20


@pytest.mark.slow
def test_hits_beyond_the_engines_near_range_get_the_verdict_of_a_long_run():
    """Some settle on the squeal cycle, others on a motion ten times as large: neither dies out, neither is given up."""
    p = RigParameters(preload=50.0, belt_speed=1.0, k1=4e7, k2=4e7, damping_x=1000.0, damping_y=1000.0)
    found = located(p)
    judged = judge(p, found.squeal, found.separatrix)
    starts = np.array([judged.struck(20.0 * judged.unit_impulse, angle) for angle in np.linspace(-3.0, 3.0, 8)])
    verdicts, _ = judged.verdicts(starts)
    peak = found.zone.squeal.peak_x
    for start, verdict in zip(starts, verdicts.tolist(), strict=True):
        end = simulate(p, 0.4, 51200.0, start).x[-2048:]
        settled = abs(np.ptp(end) / (2.0 * peak) - 1.0) < 0.1
        assert verdict == (SETTLES if settled else OUTLASTS)
        assert np.ptp(end) > peak
    assert set(verdicts.tolist()) == {SETTLES, OUTLASTS}
