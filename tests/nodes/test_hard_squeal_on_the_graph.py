"""Zone, borders and smallest hit of the running rig: computed beside the callbacks, the latest set point wins."""

import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest

from squeal_rig.estimation.hard_squeal import COMPUTED, NAME, STATE_KEY, hard_squeal
from squeal_rig.model import smallest_hit, zone
from tests.graph.processes import has_ended, parameters
from tests.graph.statuses import status_of

pytest.importorskip("rclpy")

# A first one ever is compiled.
PATIENCE = 300.0


def _of_preload(summaries, preload):
    """Status of hard squeal in the newest summary, once that is of a preload [N] and computed."""
    if not summaries or float(status_of(summaries[-1], "stability: set point")[2]["preload [N]"]) != preload:
        return None
    found = status_of(summaries[-1], NAME)
    return found if found is not None and found[2][STATE_KEY] == COMPUTED else None


def _child_of(pid):
    """The process beside a node."""
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="utf-8").split()
    return [int(child) for child in children if b"hard_squeal" in Path(f"/proc/{child}/cmdline").read_bytes()]


def test_it_follows_an_update_and_equals_what_is_computed_offline(bench):
    for preload in (54.0, 300.0):
        assert bench.observer.set({"preload": preload}) == [(True, "")]
        level, message, values = bench.observer.wait_for(
            lambda preload=preload: _of_preload(bench.summaries, preload), "the hard squeal of the set point", PATIENCE
        )
        expected = hard_squeal(bench.observer.description().parameters)
        assert (level, message, values) == (expected[0], expected[2], dict(expected[3]))


@pytest.mark.slow
def test_the_latest_of_many_set_points_wins_and_eigenvalues_do_not_wait(bench):
    bench.observer.wait_for(lambda: _of_preload(bench.summaries, 50.0), "the first one", PATIENCE)
    bench.summaries.clear()
    for preload in np.linspace(51.0, 56.0, 30).tolist():
        assert bench.observer.set({"preload": preload}) == [(True, "")]
    bench.observer.wait_for(lambda: _of_preload(bench.summaries, 56.0), "that of the latest", PATIENCE)
    news = list(bench.summaries)
    points = [status_of(message, "stability: set point")[2]["preload [N]"] for message in news]
    computed = [p for p, m in zip(points, news, strict=True) if status_of(m, NAME)[2][STATE_KEY] == COMPUTED]
    # A busy machine may pass set points over: each summary is of the latest then.
    assert len(set(points)) >= 4
    assert len(set(computed)) < len(set(points))


def test_a_parameter_turns_it_off_and_on(bench):
    bench.observer.wait_for(lambda: _of_preload(bench.summaries, 50.0), "the first one", PATIENCE)
    assert bench.observer.set({"hard_squeal": False}, "stability") == [(True, "")]
    bench.observer.wait_for(lambda: status_of(bench.summaries[-1], NAME) is None, "a summary without it")
    assert not _child_of(bench.nodes["stability"].process.pid)
    assert bench.observer.set({"hard_squeal": True}, "stability") == [(True, "")]
    bench.observer.wait_for(lambda: _of_preload(bench.summaries, 50.0), "a summary with it", PATIENCE)


@pytest.mark.slow
def test_the_process_beside_is_started_again_and_ends_with_its_node(compiled, processes, observer, config_file):
    files = ["--params-file", str(config_file)]
    rig, stability = processes.node("simulator", *files), processes.node("stability", *files)
    summaries = observer.follow("stability/summary")
    observer.wait_for(lambda: _of_preload(summaries, 50.0), "the first one", PATIENCE)
    (beside,) = _child_of(stability.process.pid)
    os.kill(beside, signal.SIGKILL)
    assert observer.set({"preload": 52.0}) == [(True, "")]
    observer.wait_for(lambda: _of_preload(summaries, 52.0), "that of another set point", PATIENCE)
    (beside,) = _child_of(stability.process.pid)
    stability.send(signal.SIGKILL)
    deadline = time.monotonic() + 30.0  # it is niced: a busy machine has little time for it
    while not has_ended(beside):
        assert time.monotonic() < deadline, "the process beside outlived its node"
        time.sleep(0.05)
    assert rig.end()[0] == 0


@pytest.mark.parametrize(
    "point",
    [
        pytest.param({"preload": 50.0, "k1": 4e7, "k2": 4e7}, marks=pytest.mark.slow),
        pytest.param({"preload": 50.0, "k1": 3e7, "k2": 3e7}, marks=pytest.mark.long),
        pytest.param({"preload": 100.0, "k1": 2e7, "k2": 2e7}, marks=pytest.mark.long),
        pytest.param({"preload": 30.0, "k1": 5e7, "k2": 4e7}, marks=pytest.mark.long),
        pytest.param({"preload": 50.0, "belt_speed": 3.0, "k1": 4e7, "k2": 4e7}, marks=pytest.mark.long),
        pytest.param({"preload": 20.0, "belt_speed": 0.5, "k1": 4e7, "k2": 4.5e7}, marks=pytest.mark.slow),
    ],
)
def test_the_smallest_hit_bisected_on_the_running_rig_is_the_one_computed(
    compiled, processes, observer, config_file, measured, point
):
    values = {**point, "damping_x": 1000.0, "damping_y": 1000.0, "real_time_factor": 2.0}
    files = ["--params-file", str(config_file)]
    nodes = [processes.node("simulator", *files, *parameters(**values)), processes.node("stability", *files)]
    with observer.following_for_a_while():
        told, low, high = bisected(observer, point)
    measured(f"smallest hit at {point}: {told:.5g} N s computed, {low:.5g} to {high:.5g} N s on the running rig")
    assert 0.5 * (low + high) == pytest.approx(told, rel=0.01)
    assert [node.end()[0] for node in nodes] == [0, 0]


def bisected(observer, point):
    """Smallest hit at a point as it was computed, and its bracket on the running rig [N s]."""
    summaries, blocks = observer.follow("stability/summary"), observer.follow_samples("daq/samples")
    _, _, found = observer.wait_for(lambda: _of_preload(summaries, point["preload"]), "the smallest hit", PATIENCE)
    told, direction = float(found["smallest hit [N s]"]), float(found["smallest hit direction [rad]"])

    def squeals(impulse):
        assert observer.set({"impact_impulse": impulse, "impact_direction": direction}) == [(True, "")] * 2
        assert observer.trigger("reset")[0]
        observer.wait_for(lambda: moves(blocks[-1]) < 1e-12, "the pad at rest")
        blocks.clear()
        assert observer.trigger("impact")[0]
        # Blocks may be late: time counts from the one with the hit.
        struck = observer.wait_for(lambda: next((b for b in blocks if moves(b) > 1e-9), None), "the hit")
        end = int(struck.samples["seq"][0]) + 2 * 51200
        observer.wait_for(lambda: int(blocks[-1].samples["seq"][0]) > end, "two seconds after the hit")
        return moves(blocks[-1]) > 1e-8

    def moves(block):
        return float(np.ptp(block.samples["x"]))

    low, high = 0.8 * told, 1.2 * told
    assert not squeals(low)
    assert squeals(high)
    while high - low > 0.004 * told:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if squeals(middle) else (middle, high)
    return told, low, high


@pytest.mark.slow
def test_a_slow_ramp_down_in_mu_ends_squeal_at_the_fold(compiled, processes, observer, config_file, measured):
    """At c = 1000 N s/m, 0.0005 in mu each half second of sampled time."""
    law = {"mu_speed": 0.0, "mu_preload": 0.0, "mu_speed_preload": 0.0, "mu0": 0.35}
    values = {**law, "damping_x": 1000.0, "damping_y": 1000.0, "real_time_factor": 2.0}
    files = ["--params-file", str(config_file)]
    rig = processes.node("simulator", *files, *parameters(**values))
    with observer.following_for_a_while():
        blocks, truth = observer.follow_samples("daq/samples"), observer.follow_samples("truth/samples")
        observer.wait_for(lambda: blocks, "samples")
        p = observer.description().parameters
        fold, hit = zone(p).fold_mu, smallest_hit(p)
        struck = {"impact_impulse": 1.1 * hit.impulse, "impact_direction": hit.direction}
        assert observer.set(struck) == [(True, "")] * 2
        assert observer.trigger("impact")[0]
        # What was sampled while the smallest hit was computed comes first.
        observer.wait_for(lambda: np.ptp(blocks[-1].samples["x"]) > 1e-9, "the hit")

        def in_force(mu):
            """Number of a sample from which on that coefficient is in force, as far as it has come here."""
            return next((int(b.samples["seq"][-1]) for b in reversed(truth) if b.samples["mu"][-1] == mu), None)

        def amplitude(seconds, mu=law["mu0"]):
            """Peak to peak of x in the block that comes so long after a coefficient was in force [m]."""
            end = observer.wait_for(lambda: in_force(mu), f"mu = {mu}") + int(seconds * 51200)
            observer.wait_for(lambda: int(blocks[-1].samples["seq"][-1]) > end, "the wait")
            return float(np.ptp(blocks[-1].samples["x"]))

        assert amplitude(2.0) > 1e-7
        for mu in (0.2, 0.12, 0.1):
            assert observer.set({"mu0": mu}) == [(True, "")]
            assert amplitude(1.0, mu) > 1e-7
        while mu > 0.08:
            assert observer.set({"mu0": mu}) == [(True, "")]
            if amplitude(0.5, mu) < 1e-8:
                break
            mu -= 0.0005
    measured(f"squeal ends at mu = {mu:.4f} going down 0.001 a second; the fold is at {fold:.4f}")
    assert mu == pytest.approx(fold, rel=0.02)
    assert rig.end()[0] == 0
