"""`squeal-rig run` on the twin of the hardware: springs fitted by hand, by a mechanic's word alone."""

import json
import re
import urllib.error
import urllib.request

import numpy as np
import pytest
import yaml

from squeal_rig.recording import Bag, decoder_of, samples_from_cdr
from tests.drivers.conftest import needs_extra, serve_twin
from tests.graph.processes import parameters, patient_config

pytest.importorskip("rclpy")

_PLAN = """\
title: two springs
steps:
  - set: {{preload: 60.0}}
    wait: 1.0
  - note: both arms
    spring: stiff
    dwell: {dwell}
    wait: 1.0
"""


@pytest.fixture
def start(compiled, processes, tmp_path):
    """Starts a session on the twin, with a plan that gives the mechanic so long [s]; its bag is `bag`."""
    needs_extra()
    config = patient_config(tmp_path)
    values = yaml.safe_load(config.read_text(encoding="utf-8"))
    rig = values["/**/rig"]["ros__parameters"]
    twin = serve_twin(tmp_path, "--sample-rate", rig["sample_rate"])
    rig |= {"driver": "opendaq", "driver_config": str(twin.config)}
    config.write_text(yaml.safe_dump(values), encoding="utf-8")

    def session(dwell):
        (tmp_path / "plan.yaml").write_text(_PLAN.format(dwell=dwell))
        files = ("--config", config, "--plan", tmp_path / "plan.yaml", "--bag", tmp_path / "bag")
        return processes.command("run", *files, cwd=tmp_path)

    yield session
    twin.kill()


def sent(url, **command):
    """Answer of the page to a command: whether it was done, and the sentence."""
    request = urllib.request.Request(
        f"{url}command", json.dumps(command).encode(), {"Content-Type": "application/json"}
    )
    try:
        with urllib.request.urlopen(request, timeout=90.0) as answer:
            content = json.load(answer)
    except urllib.error.HTTPError as error:
        content = json.load(error)
    return content["done"], content["sentence"]


def ended_steps(bag):
    decode = decoder_of(bag.topics["/run/events"].schema)
    events = [decode(message.data).status[0] for message in bag.messages(["/run/events"])]
    return [{item.key: item.value for item in event.values} for event in events if event.message == "step ended"]


@pytest.mark.slow
def test_a_plan_has_springs_fitted_by_hand_on_a_rig_that_stands(start, processes, observer, tmp_path):
    page = processes.node("page", *parameters(port=0, control=True))
    observer.wait_for(lambda: "http://" in page.errors or not page.running, "the page's address", 300.0)
    url = re.search(r"http://\S+?/", page.errors)[0]
    assert sent(url, do="springs_fitted", name="stiff")[0] is False  # nobody runs a plan
    run = start(600.0)
    # The rig is active for a second of the first step alone: a busy machine may ask before and after it, never then.
    observer.wait_for(lambda: not run.running or "step 2 of 2" in run.output, "a step done on an active rig", 300.0)
    observer.wait_for(lambda: not run.running or observer.state() == "inactive", "the rig deactivated", 300.0)
    assert run.running, run.errors
    # The rig stands a moment before it is said what is to be fitted.
    observer.wait_for(
        lambda: "the springs to fit are 'stiff'" in sent(url, do="springs_fitted", name="soft")[1], "what to fit"
    )
    assert sent(url, do="springs_fitted", name="stif")[0] is False
    assert sent(url, do="springs_fitted", name="stiff") == (True, "stiff: confirmed")
    assert observer.wait_for_end(run, 300.0) == 0, run.errors
    assert page.end()[0] == 0
    bag = Bag(tmp_path / "bag")
    blocks = [samples_from_cdr(message.data) for message in bag.messages(["/daq/samples"])]
    preload = np.array([block.samples["preload"][-1] for block in blocks])
    speed = np.array([block.samples["belt_speed"][-1] for block in blocks])
    loaded = np.flatnonzero(preload > 55.0)
    standing = np.flatnonzero((preload < 5.0) & (speed < 0.02))
    between = standing[(standing > loaded[0]) & (standing < loaded[-1])]
    assert len(between) > 0, "the rig stood between the springs"
    facts = ended_steps(bag)
    assert [fact["outcome"] for fact in facts] == ["done", "done"]
    assert facts[1]["title"] == "both arms: fit the springs 'stiff'"
    assert facts[1]["answer"] == "fitted by hand, confirmed"
    assert float(facts[1]["stiffness [N/m]"]) == 6e7
    last = decoder_of(bag.topics["/rig/description"].schema)
    described = [last(message.data).data for message in bag.messages(["/rig/description"])][-1]
    assert "k1: 60000000.0" in described
    assert "preload: 60.0" in described


@pytest.mark.slow
def test_springs_that_nobody_confirms_end_the_plan_and_nothing_moves(start, tmp_path):
    run = start(1.0)
    assert run.wait(400.0) == 2
    sentence = "nobody has confirmed the springs 'stiff' within 1 s: the rig stays inactive"
    assert sentence in run.errors
    bag = Bag(tmp_path / "bag")
    assert ended_steps(bag)[-1]["outcome"] == sentence
    last = samples_from_cdr([message.data for message in bag.messages(["/daq/samples"])][-1]).samples[-1]
    assert last["preload"] < 5.0
    assert last["belt_speed"] < 0.02
