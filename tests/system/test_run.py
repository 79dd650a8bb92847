"""`squeal-rig run`: nodes, live state, recording, plans, and a clean end however it comes."""

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil
import pytest
from rosbags.highlevel import AnyReader

import squeal_rig
from squeal_rig.configuration.files import config_directory
from squeal_rig.recording import Bag, decoder_of, samples_from_cdr
from tests.graph.processes import PATIENT_RATE, patient_config

pytest.importorskip("rclpy")

# Starting six nodes takes some seconds; compiling the model for the first time far longer.
_PATIENCE = 200.0
_STALL = 1.5
_PACKAGE = Path(squeal_rig.__file__).parent
_PLAN = """\
title: quiet, squeal, reset, impact
steps:
  - wait: 0.6
  - note: into squeal
    set: {preload: 300, mu0: 0.26}
    wait: 1.2
  - call: reset
  - call: zero
    wait: 0.2
  - call: impact
    wait: 0.4
"""


def _read(bag):
    """Topic -> structured array of all samples, with seq checked to have no gap from 0."""
    found = Bag(bag)
    assert found.ending.startswith("complete")
    samples = {}
    for topic in ("/daq/samples", "/truth/samples"):
        samples[topic] = np.concatenate([samples_from_cdr(m.data).samples for m in found.messages([topic])])
        np.testing.assert_array_equal(samples[topic]["seq"], np.arange(len(samples[topic])))
    with AnyReader([bag]) as reader:
        assert reader.message_count == found.message_count
        assert sum(1 for _ in reader.messages()) == found.message_count
    return samples


def _complaints(child):
    """What a run has printed to stderr, but for rclpy's warning that one who asked has gone: a busy machine has that.

    Python shows the line of source that warns below it.
    """
    return re.sub(r".*RuntimeWarning: failed to send response \(timeout\): .*\n(  .*\n)?", "", child.errors)


def _wait_for_word(child, word):
    deadline = time.monotonic() + _PATIENCE
    while word not in child.output:
        assert child.running, child.errors
        assert time.monotonic() < deadline, f"{word!r} was not printed: {child.output}"
        time.sleep(0.05)


@pytest.fixture(scope="module")
def planned(processes, tmp_path_factory):
    """A run of a plan to its end: (child, bag)."""
    folder = tmp_path_factory.mktemp("planned")
    (folder / "plan.yaml").write_text(_PLAN, encoding="utf-8")
    child = processes.command(
        "run",
        *("--config", patient_config(folder), "--plan", folder / "plan.yaml", "--bag", folder / "bag"),
        cwd=folder,
    )
    assert child.wait(_PATIENCE) == 0, child.errors
    return child, folder / "bag"


def test_a_plan_runs_to_its_end_and_leaves_a_whole_bag(planned):
    child, bag = planned
    assert _complaints(child) == ""
    daq = _read(bag)["/daq/samples"]
    assert len(daq) >= 2.4 * PATIENT_RATE
    assert daq["preload"][0] == 50.0
    assert daq["preload"][-1] == 300.0
    # 250 N at 500 N/s: half a second of slew between both.
    assert np.count_nonzero((daq["preload"] > 50.0) & (daq["preload"] < 300.0)) == pytest.approx(
        0.5 * PATIENT_RATE, abs=128
    )


def test_the_steps_and_the_live_state_are_shown(planned):
    child, bag = planned
    for words in ("step 1 of 5", "step 2 of 5: into squeal", "step 5 of 5", f"bag: {bag}"):
        assert words in child.output.replace("\n", "")
    for words in ("mu set", "k_cr", "margin", "squeal", "recorded", "F = 50 N"):
        assert words in child.output


def _events(bag):
    """(level, what, facts) of everything on `run/events`."""
    found = Bag(bag)
    decode = decoder_of(found.topics["/run/events"].schema)
    statuses = [s for message in found.messages(["/run/events"]) for s in decode(message.data).status]
    return [(s.level, s.message, {pair.key: pair.value for pair in s.values}) for s in statuses]


def test_the_bag_keeps_the_plan_and_how_each_step_ended(planned):
    _, bag = planned
    events = _events(bag)
    assert [what for _, what, _ in events] == ["run started", *["step begun", "step ended"] * 5, "run ended"]
    assert {level for level, _, _ in events} == {0}
    assert events[0][2]["plan"] == "quiet, squeal, reset, impact"
    ends = [facts for _, what, facts in events if what == "step ended"]
    assert [facts["outcome"] for facts in ends] == ["done"] * 5
    assert ends[1]["set"] == "preload = 300.0, mu0 = 0.26"
    waits = [float(facts["end [s]"]) - float(facts["begin [s]"]) for facts in ends]
    assert waits == pytest.approx([0.6, 1.2, 0.0, 0.2, 0.4])
    assert ends[3]["answer"].startswith("tare taken, subtracted from now on")
    assert events[-1][2]["outcome"] == "done"
    # The numbers of samples tell where in the data a step lies: not before it was waited for.
    daq = _read(bag)["/daq/samples"]
    raised = int(daq["seq"][np.argmax(daq["preload"] > 50.0)])
    assert int(ends[0]["next sample"]) <= raised <= int(ends[1]["next sample"])


def test_the_bag_keeps_the_logs_of_the_nodes(planned):
    _, bag = planned
    logs = {path.name: path.read_text(encoding="utf-8") for path in (bag / "logs").iterdir()}
    assert set(logs) >= {f"{name}.log" for name in ("simulator", "recorder", "stability", "friction_estimator")}
    assert not [name for name, text in logs.items() if "Traceback" in text]


def test_the_recorded_run_can_be_analysed_and_shown(planned, in_process):
    _, bag = planned
    code, output, errors = in_process("analyse", bag)
    assert (code, errors) == (0, "")
    assert (bag / "report.png").read_bytes().startswith(b"\x89PNG")
    code, output, errors = in_process("info", bag)
    assert (code, errors) == (0, "")
    assert "/stability/summary" in output


@pytest.mark.slow
@pytest.mark.parametrize("signals", [(signal.SIGINT,), (signal.SIGINT, signal.SIGINT)])
def test_ctrl_c_ends_a_run_cleanly_with_a_valid_bag(processes, tmp_path, signals, measured):
    child = processes.command(
        "run",
        *("--config", patient_config(tmp_path), "--duration", "60", "--bag", tmp_path / "bag"),
        cwd=tmp_path,
    )
    _wait_for_word(child, "F = 50 N")
    code, seconds = child.end(*signals)
    assert code == 0, child.errors
    assert _complaints(child) == ""
    measured(f"Ctrl-C to the end of a run: {seconds:.1f} s")
    assert len(_read(tmp_path / "bag")["/daq/samples"]) > 0
    assert [(what, facts["outcome"]) for _, what, facts in _events(tmp_path / "bag")[-1:]] == [
        ("run ended", "ended by the operator")
    ]


@pytest.mark.slow
def test_a_recorder_that_stands_still_as_a_run_is_ended_gets_the_last_samples(processes, tmp_path):
    child = processes.command(
        "run",
        *("--config", patient_config(tmp_path), "--duration", "60", "--bag", tmp_path / "bag"),
        cwd=tmp_path,
    )
    _wait_for_word(child, "F = 50 N")
    (recorder,) = [p for p in psutil.Process(child.process.pid).children() if "recorder" in p.cmdline()]
    recorder.suspend()
    begin = time.monotonic()
    child.send(signal.SIGINT)
    while time.monotonic() - begin < _STALL:  # the rig would have ended long ago
        time.sleep(0.05)
    recorder.resume()
    assert child.wait() == 0, child.errors
    samples = _read(tmp_path / "bag")
    ((_, _, ended),) = [event for event in _events(tmp_path / "bag") if event[1] == "run ended"]
    assert len(samples["/daq/samples"]) == len(samples["/truth/samples"]) >= int(ended["next sample"]) > 0


@pytest.mark.slow
def test_a_run_of_one_second_without_recording_ends_by_itself_and_leaves_nothing(processes, tmp_path):
    config, empty = patient_config(tmp_path), tmp_path / "empty"
    empty.mkdir()
    child = processes.command("run", "--config", config, "--duration", "1", "--no-record", cwd=empty)
    assert child.wait(_PATIENCE) == 0, child.errors
    assert _complaints(child) == ""
    assert list(empty.iterdir()) == []


def test_a_run_that_cannot_be_is_refused_in_a_sentence_before_anything_starts(in_process, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)  # where a bag would appear
    bad = tmp_path / "bad.yaml"
    text = (config_directory() / "rig.yaml").read_text(encoding="utf-8")
    bad.write_text(text.replace("preload: 50.0", "preload: -50.0"), encoding="utf-8")
    plan = tmp_path / "plan.yaml"
    plan.write_text("steps:\n  - set: {mass: 1.0}\n", encoding="utf-8")
    cases = {
        "preload = -50 N is out of bounds": ("run", "--config", bad),
        "mass is a constant of the machine": ("run", "--plan", plan),
        "cannot read": ("run", "--config", tmp_path / "none.yaml"),
    }
    for sentence, arguments in cases.items():
        code, _, errors = in_process(*arguments)
        assert code == 2
        assert sentence in errors
        assert errors.count("\n") == 1
    assert {path.name for path in tmp_path.iterdir()} == {"bad.yaml", "plan.yaml"}


def test_a_bag_that_exists_already_is_refused_before_anything_starts(planned, in_process):
    _, bag = planned
    before = {path: path.stat().st_mtime_ns for path in bag.rglob("*")}
    code, output, errors = in_process("run", "--duration", "1", "--bag", bag)
    assert (code, errors.count("\n")) == (2, 1)
    assert f"The bag directory {bag} exists already and is not empty." in errors
    assert "node" not in output
    assert {path: path.stat().st_mtime_ns for path in bag.rglob("*")} == before


@pytest.mark.parametrize(
    "domain", ["abc", *(pytest.param(d, marks=pytest.mark.slow) for d in ("0000000000300", "0x12c"))]
)
def test_a_domain_that_is_none_is_a_sentence(domain, tmp_path):
    environment = {**os.environ, "ROS_DOMAIN_ID": domain}
    start = [sys.executable, str(_PACKAGE / "nodes" / "start.py"), "simulator"]
    for command in ([sys.executable, "-m", "squeal_rig.cli", "run", "--duration", "1", "--no-record"], start):
        ended = subprocess.run(
            command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=_PATIENCE, check=False
        )
        assert ended.returncode == 2, ended.stderr
        assert "ROS_DOMAIN_ID" in ended.stderr
        assert ended.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
