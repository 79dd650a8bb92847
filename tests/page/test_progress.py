"""How far a plan or a campaign is, from what is told of it."""

import math

from squeal_rig.experiments.engine import RUN_ENDED, RUN_STARTED, STEP_BEGUN, STEP_ENDED
from squeal_rig.page.progress import Progress


def test_a_campaign_counts_what_was_done_before_and_tells_what_is_left():
    progress = Progress()
    assert not progress.shown
    started = {"campaign": "Smoke", "points": "24", "done before": "4", "plan text": "x" * 10**6}
    progress.take(100.0, 0, RUN_STARTED, started)
    progress.take(101.0, 0, STEP_BEGUN, {"step": "5", "of": "24", "title": "preload = 30"})
    shown = dict(progress.shown)
    assert (shown["kind"], shown["title"], shown["of"], shown["done"], shown["step"]) == ("campaign", "Smoke", 24, 4, 5)
    assert shown["doing"] == "preload = 30"
    assert math.isnan(shown["left"])
    ended = {"step": "5", "title": "preload = 30", "outcome": "done", "verdict": "squeal", "frequency": "2201.5"}
    progress.take(110.0, 0, STEP_ENDED, ended)
    assert (progress.shown["done"], progress.shown["failed"], progress.shown["step"]) == (5, 0, 0)
    assert progress.shown["last"] == "preload = 30: verdict squeal, frequency 2201.5"
    assert progress.shown["left"] == (110.0 - 101.0) * 19
    progress.take(120.0, 0, STEP_ENDED, {**ended, "verdict": "failed", "frequency": "nan", "note": "samples were lost"})
    assert progress.shown["failed"] == 1
    assert progress.shown["last"].endswith("verdict failed, note samples were lost")
    progress.take(121.0, 2, RUN_ENDED, {"outcome": "ended by the operator"})
    assert progress.shown["ended"] == "ended by the operator"
    assert len(str(progress.shown)) < 2000


def test_a_plan_is_steps_and_a_run_without_one_has_no_number():
    progress = Progress()
    progress.take(0.0, 0, RUN_STARTED, {"plan": "demo", "steps": "3"})
    progress.take(1.0, 0, STEP_BEGUN, {"step": "1", "of": "3", "title": "quiet"})
    progress.take(2.0, 0, STEP_ENDED, {"step": "1", "of": "3", "title": "quiet", "outcome": "done"})
    assert (progress.shown["kind"], progress.shown["of"], progress.shown["done"]) == ("plan", 3, 1)
    assert progress.shown["last"] == "quiet: done"
    progress.take(3.0, 0, RUN_STARTED, {"config": "rig.yaml"})
    assert (progress.shown["kind"], progress.shown["of"], progress.shown["done"]) == ("run", 0, 0)


def test_who_comes_late_knows_the_step_and_the_number_of_them():
    progress = Progress()
    progress.take(0.0, 0, STEP_BEGUN, {"step": "1200", "of": "5000", "title": "preload = 30"})
    assert (progress.shown["kind"], progress.shown["step"], progress.shown["of"]) == ("run", 1200, 5000)


def test_numbers_that_are_none_count_as_not_known():
    progress = Progress()
    progress.take(0.0, 0, RUN_STARTED, {"campaign": "x", "points": "-1", "done before": "9" * 400})
    assert (progress.shown["of"], progress.shown["done"]) == (0, 0)
