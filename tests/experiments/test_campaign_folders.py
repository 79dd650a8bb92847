"""What a campaign makes of ramps, loud points and squeals that end; and of folders and files that are not its own."""

import json
import math
import os

import numpy as np
import pytest

from squeal_rig.errors import ConfigurationError, DiskError, ExperimentError
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


def test_a_motion_that_leaves_the_model_is_no_squeal():
    row = measure_point(parse_campaign(PLAIN, "plan"), {"preload": 60.0}, MadeBench(lambda t: 2e-3)).row
    assert row["verdict"] == "failed"
    assert row["note"].startswith("the pad moved by 0.002 m, above 0.01 of the arm length 0.1 m")
    row = measure_point(parse_campaign(PLAIN, "plan"), {"preload": 60.0}, MadeBench(lambda t: 5e-4)).row
    assert row["verdict"] == "squeal"


def test_by_level_what_rings_in_contact_and_what_leaves_the_model_is_no_squeal(tmp_path):
    plan = """
campaign: undamped
measure: level
rig: {preload: 300.0, pad_stiffness: 1.0e+7}
factors: {belt_speed: [1.0, 4.0]}
protocol: [{start: 0.5}, {dwell: 0.2}]
"""
    rings = finished(tmp_path / "rings", plan)
    assert np.all(rings["level"] > -12.0)
    assert rings["verdict"].tolist() == ["quiet", "quiet"]
    text = write_campaign_report(tmp_path / "rings").read_text(encoding="utf-8")
    assert "no tones are followed" in text.replace("\n", " ")
    assert "stands out of the noise" not in text
    far = finished(tmp_path / "far", plan.replace("1.0e+7", "6.0e+7").replace("0.5}", "30.0}").replace("0.2}", "2.0}"))
    assert (np.maximum(far["peak_x"], 0.0) > 1e-3).any()
    assert [v for v, x in zip(far["verdict"], far["peak_x"], strict=True) if x > 1e-3] == ["failed"] * int(
        np.sum(far["peak_x"] > 1e-3)
    )


def test_lines_that_would_be_ours_and_lack_something_are_passed_over(tmp_path):
    folder = tmp_path / "levels"
    finished(folder)
    for line in (
        {"what": "run ended"},
        {"what": "campaign", "plan": "x", "points": 3},
        {"what": "campaign", "plan": "x", "points": 3, "chunk_size": 0, "time": 1.0},
        {"what": "chunk", "chunk": 0, "rows": 4, "failed": "x", "files": {}, "time": 1.0},
        {"what": "run started", "time": 1e300},
    ):
        with (folder / JOURNAL).open("a") as stream:
            stream.write(json.dumps(line) + "\n" + "[" * 100_000 + "\n")
        assert "it ended: done" in status(folder)[-1], line
        Store.resume(folder).close()
    write_campaign_report(folder)


def test_a_journal_that_is_no_file_is_not_waited_for(tmp_path):
    finished(tmp_path / "levels")
    (tmp_path / "levels" / JOURNAL).unlink()
    os.mkfifo(tmp_path / "levels" / JOURNAL)
    for act in (status, Store.resume):
        with pytest.raises(ExperimentError, match="holds no campaign"):
            act(tmp_path / "levels")
    with pytest.raises(OSError, match=r"Not a regular file: .*journal\.jsonl"):  # a sentence at the command line
        start(tmp_path / "levels", parse_campaign(LEVELS, "plan"), 4)


def test_ramps_that_are_too_long_together_are_refused_before_they_are_made():
    ramp = "{ramp: {parameter: preload, from: 1.0, to: 2.0, steps: 100000, hold: 1.0}}"
    for count, sentence in ((3, "all ramps together have more than 200000 steps"), (800, "it has 800 phases")):
        with pytest.raises(ConfigurationError, match=sentence):
            parse_campaign(
                f"campaign: long\nfactors: {{preload: [60.0]}}\nprotocol: [{', '.join([ramp] * count)}]\n", "p"
            )
