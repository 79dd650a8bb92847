"""The demo: a scripted run, its bag, its replay through a fresh estimator, its picture."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from squeal_rig.analysis.segments import analyse_bag
from squeal_rig.configuration.files import config_directory
from squeal_rig.estimation.hard_squeal import hard_squeal
from squeal_rig.experiments.plan import load_plan
from squeal_rig.model.parameters import RigParameters
from squeal_rig.report.run_figure import draw_run
from squeal_rig.report.tables import SegmentTable, zone_sentences
from squeal_rig.session.replay_check import replay_and_compare
from squeal_rig.session.run import SessionOptions, SignalWatch, private_domain, run_session

_REPLAY_RATE = 2.0


def run_demo(bag: Path, console: Console, instruments: str | None = None) -> int:
    """Run the plan `demo` on a private ROS domain, record, replay, compare, draw; returns the exit code.

    `instruments` are data sheets by name or path; those of the package's rig.yaml where it is None.
    """
    # Compiled now where it never was: the plan's hits wait for it, and the bag would show a minute of nothing.
    console.print("preparing: a first demo compiles the model, which takes about a minute")
    hard_squeal(RigParameters(damping_x=20.0, damping_y=20.0))
    private_domain()
    watch = SignalWatch()
    config = config_directory() / "rig.yaml"
    plan = load_plan(config_directory() / "plans" / "demo.yaml")
    console.print(f"{plan.title}: {plan.duration:g} s of a virtual rig, recorded to {bag}")
    result = run_session(SessionOptions(config, bag, plan, instruments=instruments), console, watch)
    if result.interrupted:
        console.print("ended by the operator; the bag holds what was recorded until then")
        return 130
    failed = {name: code for name, code in result.exit_codes.items() if code != 0}
    if failed:
        console.print(f"nodes that did not end well: {failed}")
        return 1
    console.print(f"replaying at {_REPLAY_RATE:g} times the speed through a fresh estimator ...")
    comparison = replay_and_compare(bag, config, _REPLAY_RATE, watch)
    console.print(comparison.sentence)
    analysis = analyse_bag(bag)
    console.print(SegmentTable(analysis))
    for sentence in zone_sentences(analysis):
        console.print(sentence)
    picture = bag / "report.png"
    draw_run(analysis, picture)
    console.print(f"bag: {bag}\npicture: {picture}")
    return 0 if comparison.same else 1
