"""What a campaign makes of ramps, loud points and squeals that end; and of folders and files that are not its own."""

import json
import math

import numpy as np
import pytest

from squeal_rig.errors import DiskError, ExperimentError
from squeal_rig.experiments.campaign.measuring import BACK, OUT, measure_point, start_and_end
from squeal_rig.experiments.campaign.pages import write_campaign_report
from squeal_rig.experiments.campaign.plans import load_campaign, parse_campaign
from squeal_rig.experiments.campaign.running import Where, run_direct, start, status
from squeal_rig.experiments.campaign.store import JOURNAL, PLAN, Store, read
from tests.experiments.small_campaigns import LEVELS, finished

RATE = 51200
PLAIN = """
campaign: plain
factors: {preload: [60.0, 120.0]}
protocol: [reset, {dwell: 2.0}]
"""


class MadeBench:
    """Gives a made signal: `loud(t)` is the amplitude [m] of a tone of 1 kHz, in noise of 1 nm."""

    sample_rate = RATE

    def __init__(self, loud):
        self._loud, self._taken, self._rng = loud, 0, np.random.default_rng(1)

    def set_parameters(self, values):
        pass

    def reset(self):
        pass

    def run(self, duration):
        for _ in range(round(duration * 100)):
            t = (self._taken + np.arange(512)) / RATE
            self._taken += 512
            amplitude = np.array([self._loud(moment) for moment in t])
            yield amplitude * np.sin(2.0 * math.pi * 1000.0 * t) + 1e-9 * self._rng.standard_normal(512)


def test_a_squeal_that_ends_within_the_dwell_is_one():
    campaign = parse_campaign(PLAIN, "plan")
    row = measure_point(campaign, {"preload": 60.0}, MadeBench(lambda t: 1e-6 if 0.3 < t < 1.2 else 0.0)).row
    assert (row["verdict"], row["squeals_at_end"]) == ("squeal", False)
    assert row["frequency"] == pytest.approx(1000.0, rel=1e-3)
    row = measure_point(campaign, {"preload": 60.0}, MadeBench(lambda t: 1e-6 if t > 0.3 else 0.0)).row
    assert (row["verdict"], row["squeals_at_end"]) == ("squeal", True)
    row = measure_point(campaign, {"preload": 60.0}, MadeBench(lambda t: 0.0)).row
    assert (row["verdict"], row["squeals_at_end"]) == ("quiet", False)


def test_the_rule_on_the_level_ends_a_point_within_its_phase():
    campaign = parse_campaign(PLAIN + "stop: {level: -10.0}\n", "plan")
    row = measure_point(campaign, {"preload": 60.0}, MadeBench(lambda t: 1e-6 if t > 0.5 else 0.0)).row
    assert row["verdict"] == "stopped"
    assert row["duration"] < 1.0
    assert row["level"] > -10.0


def test_where_squeal_starts_and_ends_on_a_ramp():
    values = [1.0, 2.0, 3.0, 4.0, 3.0, 2.0, 1.0]
    legs = [OUT] * 4 + [BACK] * 3
    assert start_and_end(values, legs, [0, 0, 1, 1, 1, 1, 0]) == (3.0, 1.0)
    start_at, end_at = start_and_end(values, legs, [1, 1, 1, 1, 1, 1, 0])  # it squealed when the ramp began
    assert (math.isnan(start_at), end_at) == (True, 1.0)
    assert start_and_end(values, legs, [0, 1, 1, 0, 0, 1, 0]) == (2.0, 1.0)
    assert all(map(math.isnan, start_and_end(values, legs, [0] * 7)))


def test_a_plan_with_other_line_ends_is_the_same_plan_afterwards(tmp_path):
    plan = tmp_path / "plan.yaml"
    plan.write_bytes(LEVELS.replace("\n", "\r\n").replace("points: 32", "points: 4").encode())
    folder = tmp_path / "done"
    store = start(folder, load_campaign(plan), 4)
    run_direct(store, Where(0), lambda progress: None)
    store.close()
    assert "4 of 4 points" in status(folder)[0]
    assert (folder / PLAN).read_bytes() == plan.read_bytes()


def test_files_of_the_user_are_neither_overwritten_nor_cut(tmp_path):
    (tmp_path / PLAN).write_text("mine")
    (tmp_path / JOURNAL).write_text("dear diary")
    with pytest.raises(DiskError, match="is not empty"):
        start(tmp_path, parse_campaign(LEVELS, "plan"))
    assert ((tmp_path / PLAN).read_text(), (tmp_path / JOURNAL).read_text()) == ("mine", "dear diary")


def test_a_campaign_killed_before_its_first_line_is_begun_again(tmp_path):
    campaign = parse_campaign(LEVELS, "plan")
    (tmp_path / PLAN).write_bytes(campaign.text.encode())
    (tmp_path / JOURNAL).write_text('{"what": "campaign", "ti')
    start(tmp_path, campaign).close()
    assert "0 of 32 points" in status(tmp_path)[0]


def test_damaged_tables_are_told_and_measured_again(tmp_path):
    folder = tmp_path / "levels"
    whole = finished(folder)
    (folder / "points" / "part-00000001.parquet").write_bytes(b"no parquet")
    with pytest.raises(ExperimentError, match="the table 'points' cannot be read"):
        write_campaign_report(folder)
    store = Store.resume(folder)
    run_direct(store, Where(0), lambda progress: None)
    store.close()
    assert np.array_equal(read(folder, "points")["level"], whole["level"], equal_nan=True)


def test_lines_of_the_journal_that_are_not_ours_are_passed_over(tmp_path):
    folder = tmp_path / "levels"
    finished(folder)
    outside = {"what": "chunk", "chunk": 0, "rows": 4, "files": {"points/../../elsewhere.parquet": 1}}
    with (folder / JOURNAL).open("a") as stream:
        for line in (outside, {"no": "what"}, {"what": "chunk"}, {"what": 3}):
            stream.write(json.dumps(line) + "\n")
    assert "32 of 32 points" in status(folder)[0]
    assert len(read(folder, "points")["place"]) == 32


@pytest.mark.parametrize("address", ["nonsense", "http://localhost:1", "tcp://localhost:port"])
def test_a_scheduler_that_is_none_is_told_in_a_sentence(tmp_path, address):
    store = start(tmp_path, parse_campaign(LEVELS, "plan"), 4)
    try:
        with pytest.raises(ExperimentError, match=f"no Dask scheduler with a worker answers at '{address}'"):
            run_direct(store, Where(scheduler=address), lambda progress: None)
    finally:
        store.close()
