"""Bad values at start: exit code 2 and one sentence, from the command line and from a parameter file."""

import os
import re
import time

import pytest

from tests.graph.processes import parameters

pytest.importorskip("rclpy")

# Name of the fact -> (node, arguments as after --ros-args, what the sentence must say).
ON_THE_COMMAND_LINE = {
    "nan": ("simulator", parameters(preload=".nan"), "preload = nan N is not finite: it must be 0 to 2000 N"),
    "inf": ("simulator", parameters(k1=".inf"), "k1 = inf N/m is not finite: it must be 0 to 1e+10 N/m"),
    "negative_mass": ("simulator", parameters(mass=-1.0), "mass = -1 kg is out of bounds: it must be 0.001"),
    "too_much_preload": ("simulator", parameters(preload=2001), "2001 N is out of bounds: it must be 0 to 2000 N"),
    "text_for_a_number": ("simulator", parameters(preload="lots"), "preload = 'lots' is not a number"),
    "truth_value_for_a_number": ("simulator", parameters(preload="true"), "preload = True is not a number"),
    "float_for_an_integer": ("simulator", parameters(sample_rate=51200.0), "sample_rate = 51200.0 is not an integer"),
    "unknown_key": ("simulator", parameters(preloda=50.0), "unknown parameter 'preloda': did you mean 'preload'?"),
    "unknown_preset": ("simulator", parameters(preset="none_such"), "no preset 'none_such': there are yavuz_sen_2023"),
    "unknown_instruments": (
        "simulator", parameters(instruments="best"), "instruments = 'best' is not known: there are ideal, poor, typical"
    ),
    "instruments_not_there": ("simulator", parameters(instruments="/none/such.yaml"), "cannot read /none/such.yaml"),
    "negative_friction": ("simulator", parameters(mu0=-1.0), "the friction law gives mu = -0.9007 at preload = 50 N"),
    "broken_block": ("simulator", parameters(sample_rate=51250), "sample_rate = 51250 Hz must be a multiple of 100 Hz"),
    "no_equilibrium": ("rig", parameters(k1=0.0, k2=0.0, k3=0.0, k4=0.0), "no equilibrium"),
    "stability_has_no_parameters": ("stability", parameters(preload=50.0), "unknown parameter 'preload'"),
    "estimator_window": ("friction_estimator", parameters(window=0.0), "window = 0 s is out of bounds"),
    "empty_band": ("squeal_detector", parameters(band_low=6000.0), "6000 Hz must be below band_high = 5000 Hz"),
    "topics_not_a_list": ("recorder", parameters(topics="daq/samples"), "'daq/samples' is not a list of texts"),
    "no_bag_given": ("player", [], "bag = '' names no bag"),
    "bag_not_there": ("player", parameters(bag="/none/such"), "There is no bag at /none/such"),
    "parameter_file_not_there": ("simulator", ["--params-file", "/none/such.yaml"], "/none/such.yaml"),
    "unknown_argument": ("simulator", ["--none-such"], "unknown argument after --ros-args: ['--none-such']"),
    "bad_namespace": ("simulator", ["-r", "__ns:=/3left"], "'-r __ns:=/3left'"),
}  # fmt: skip

IN_A_FILE = {
    "negative_mass": ("/**/rig:\n  ros__parameters:\n    mass: -1.0\n", "mass = -1 kg is out of bounds"),
    "unknown_key": ("/**/rig:\n  ros__parameters:\n    preloda: 50.0\n", "did you mean 'preload'?"),
    "nested_key": ("/**/rig:\n  ros__parameters:\n    arm: {mass: 1.0}\n", "unknown parameter 'arm.mass'"),
    "unknown_key_here_and_for_all": (
        "/**:\n  ros__parameters:\n    preloda: 5.0\n/**/rig:\n  ros__parameters:\n    preloda: 50.0\n",
        "did you mean 'preload'?",
    ),
    "qos_overrides": (
        "/**/rig:\n  ros__parameters:\n    qos_overrides: {/daq/samples: {publisher: {depth: 3}}}\n",
        "the quality of service of every topic is fixed, there are no qos_overrides",
    ),
    "broken_yaml": ("/**/rig:\n  ros__parameters:\n    mass: [1.0\n", "bad.yaml"),
    "not_a_parameter_file": ("mass: 11.5\n", "bad.yaml"),
    "twice_the_same_key": ("/**/rig:\n  ros__parameters:\n    mass: 1.0\n    mass: -2.0\n", "mass = -2 kg"),
}  # fmt: skip

# A process each: these, one of a kind and of a way in, are tried by `make test`, the others by `make test-slow`.
_TRIED_FIRST = {
    "nan", "unknown_key", "no_equilibrium", "no_bag_given", "unknown_argument", "file_negative_mass",
}  # fmt: skip
_NAMES = [*ON_THE_COMMAND_LINE, *(f"file_{name}" for name in IN_A_FILE)]


@pytest.fixture(scope="module")
def refused(request, compiled, processes, tmp_path_factory):
    """Name of the fact -> (exit code, what the node wrote to stderr), of the bad starts tried, made side by side."""
    starts = dict(ON_THE_COMMAND_LINE)
    for name, (text, sentence) in IN_A_FILE.items():
        file = tmp_path_factory.mktemp(name) / "bad.yaml"
        file.write_text(text, encoding="utf-8")
        starts[f"file_{name}"] = ("simulator", ["--params-file", str(file)], sentence)
    tried = {item.callspec.params["name"] for item in request.session.items if item.module is request.module}
    waiting, children = [(name, start) for name, start in starts.items() if name in tried], {}
    deadline = time.monotonic() + 900.0
    while waiting or any(child.running for child in children.values()):
        assert time.monotonic() < deadline, "bad starts that do not end"
        if waiting and sum(child.running for child in children.values()) < 2 * (os.cpu_count() or 1):
            name, (node, arguments, _) = waiting.pop(0)
            children[name] = processes.node(node, *arguments)
        elif running := next((child for child in children.values() if child.running), None):
            running.wait()
    return {name: (child.wait(), child.errors) for name, child in children.items()}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name in _TRIED_FIRST else pytest.mark.slow) for name in _NAMES]
)
def test_a_bad_start_ends_with_exit_code_2_and_a_sentence(refused, name):
    sentence = ON_THE_COMMAND_LINE[name][2] if name in ON_THE_COMMAND_LINE else IN_A_FILE[name.removeprefix("file_")][1]
    code, errors = refused[name]
    lines = errors.strip().splitlines()
    assert code == 2, errors
    assert sentence in lines[-1]
    assert "Traceback" not in errors
    # rcl and the lifecycle machine log lines of their own before; apart from them there is the sentence alone.
    assert [line for line in lines if not re.match(r"\[(WARN|ERROR)\] ", line)] == lines[-1:]
