"""A live campaign that is killed and resumed, beside the engine's; occurrence out of its bags by other code."""

import csv
import re

import numpy as np
import pytest

from benchmarks.live_campaign import killed_live
from squeal_rig.experiments.campaign.plans import load_campaign
from squeal_rig.experiments.campaign.running import Where, run_direct, start
from squeal_rig.experiments.campaign.store import journal, read
from tests.experiments.occurrence import squealing_points

pytest.importorskip("rclpy")
pytestmark = pytest.mark.long  # a graph is started again after every kill

_PLAN = """
campaign: small
rig: {preset: yavuz_sen_2023, damping_x: 1000.0, damping_y: 1000.0}
factors:
  belt_speed: [1.0, 4.0]
  preload: [60.0, 120.0]
protocol:
  - reset
  - ramp: {parameter: pad_stiffness, from: 3.0e+7, to: 6.0e+7, steps: 7, hold: 0.3, back: true}
  - reset
  - hit: {impulse: 1.0e-11}
  - settle: {longest: 1.0, change: 0.5, over: 0.2}
  - dwell: 0.5
"""
_KILLS = 3


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The campaign `live` was killed and resumed, `direct` is the engine's."""
    folder = tmp_path_factory.mktemp("campaign")
    plan = folder / "plan.yaml"
    plan.write_text(_PLAN, encoding="utf-8")
    store = start(folder / "direct", load_campaign(plan))
    run_direct(store, Where(0), lambda progress: None)
    store.close()
    endings = killed_live(plan, folder / "live", _KILLS, seed=3, latest=45.0)
    assert endings[-1] == "done", endings
    assert endings.count("killed") == _KILLS
    return folder


def test_a_killed_live_campaign_finds_what_the_engine_does_and_measures_nothing_twice(folder):
    live, direct = read(folder / "live", "points"), read(folder / "direct", "points")
    done = [entry["chunk"] for entry in journal(folder / "live") if entry["what"] == "chunk"]
    assert sorted(done) == list(range(4))
    assert live["verdict"].tolist() == direct["verdict"].tolist()
    squealing = direct["verdict"] == "squeal"
    assert 0 < squealing.sum() < 4
    assert live["frequency"][squealing] == pytest.approx(direct["frequency"][squealing], rel=1e-2)
    step = 0.5e7
    assert np.isfinite(direct["squeal_from"]).any()
    for name in ("squeal_from", "squeal_to"):
        assert np.allclose(live[name], direct[name], rtol=0.0, atol=1.01 * step, equal_nan=True)
    steps = read(folder / "live", "steps")
    assert [int(np.sum(steps["place"] == place)) for place in range(4)] == [13] * 4


def test_growth_is_measured_live_too(folder):
    points, events = read(folder / "live", "points"), read(folder / "live", "events")
    predicted = {int(place): growth for place, growth in zip(points["place"], points["predicted_growth"], strict=True)}
    after_ramp = np.flatnonzero(np.isfinite(events["growth"]) & (events["onset"] >= 13 * 0.3))
    assert len(after_ramp)
    for i in after_ramp:
        assert events["growth"][i] == pytest.approx(predicted[int(events["place"][i])], rel=0.02)


def test_occurrence_in_the_report_is_that_of_the_bags(folder):
    seen = squealing_points(folder / "live" / "bags")
    with (folder / "live" / "report" / "points_all.csv").open() as stream:
        table = {int(row["point"]): row["verdict"] == "squeal" for row in csv.DictReader(stream)}
    assert seen == table
    told = re.search(r"(\d+) points? squeals?, ([0-9.]+) %", (folder / "live" / "report" / "index.html").read_text())
    assert int(told[1]) == sum(seen.values())
    assert float(told[2]) == pytest.approx(100.0 * sum(seen.values()) / len(seen), rel=1e-2)
