"""Plans and the checking of YAML files."""

from pathlib import Path

import pytest

from squeal_rig.catalogue.checking import NODE_PARAMETERS, check_file
from squeal_rig.catalogue.parameter_table import parameter_table
from squeal_rig.configuration.declared import declarations
from squeal_rig.configuration.files import config_directory
from squeal_rig.errors import ExperimentError, SquealRigError
from squeal_rig.experiments.engine import run_plan
from squeal_rig.experiments.plan import load_plan

ROOT = Path(__file__).parents[2]


class Notebook:
    """A rig that writes down what it is told; its time passes only in waits."""

    def __init__(self) -> None:
        self.log: list = []
        self.time = 5.0

    def set_parameters(self, values) -> None:
        self.log.append(("set", dict(values), self.time))

    def call(self, service: str) -> str:
        self.log.append(("call", service, self.time))
        return "done"

    def smallest_hit(self) -> tuple[float, float]:
        self.time += 0.5
        return 0.02, -1.2

    def change_springs(self, name: str, stiffness: float, dwell: float) -> str:
        self.time += 3.0  # it samples on for a while, then it stands
        self.log.append(("springs", name, stiffness, dwell))
        return "fitted by hand"

    def sampled_time(self) -> float:
        return self.time

    def wait_until(self, sampled_time: float) -> None:
        self.time = sampled_time + 0.013  # a block later than asked for


def test_waits_are_counted_from_the_step_before_and_do_not_drift(tmp_path):
    path = tmp_path / "plan.yaml"
    path.write_text("title: t\nsteps:\n- {set: {preload: 100}, wait: 1.0}\n- {call: impact, wait: 2.0}\n- {wait: 1}\n")
    rig = Notebook()
    told = []
    run_plan(load_plan(path), rig, told.append)
    ends = [event.facts for event in told if event.what == "step ended"]
    assert [(facts["begin [s]"], facts["end [s]"]) for facts in ends] == [(5.0, 6.0), (6.0, 8.0), (8.0, 9.0)]
    assert [facts["outcome"] for facts in ends] == ["done"] * 3
    assert [event.what for event in told] == ["step begun", "step ended"] * 3
    assert rig.log == [("set", {"preload": 100.0}, 5.0), ("call", "impact", 6.013)]
    assert ends[1]["answer"] == "done"


def test_a_hit_is_a_share_of_the_smallest_one_and_its_wait_begins_with_it(tmp_path):
    path = tmp_path / "plan.yaml"
    path.write_text("steps:\n- {hit: 0.5, wait: 2.0}\n- {wait: 1.0}\n")
    rig, told = Notebook(), []
    run_plan(load_plan(path), rig, told.append)
    assert rig.log == [("set", {"impact_impulse": 0.01, "impact_direction": -1.2}, 5.5), ("call", "impact", 5.5)]
    facts = told[1].facts
    assert (facts["share of the smallest hit"], facts["smallest hit [N s]"], facts["end [s]"]) == (0.5, 0.02, 7.5)
    assert told[0].facts["title"] == "0.5 of the smallest hit"


def test_springs_of_the_catalogue_are_fitted_and_the_wait_begins_with_them(tmp_path):
    path, drawer = tmp_path / "plan.yaml", tmp_path / "drawer.yaml"
    drawer.write_text("blue: {stiffness: 3.1e+7, tolerance: 0.02}\n")
    path.write_text(f"springs: {drawer}\nsteps:\n- {{spring: blue, wait: 2.0}}\n- {{spring: blue, dwell: 5}}\n")
    rig, told = Notebook(), []
    plan = load_plan(path)
    assert plan.duration == 2.0  # a dwell is no sampled time
    run_plan(plan, rig, told.append)
    assert rig.log == [("springs", "blue", 3.1e7, 600.0), ("springs", "blue", 3.1e7, 5.0)]
    facts = told[1].facts
    assert (facts["stiffness [N/m]"], facts["tolerance"], facts["end [s]"]) == (3.1e7, 0.02, 10.0)
    assert facts["answer"] == "fitted by hand"
    assert told[0].facts["title"] == "fit the springs 'blue'"
    assert check_file(drawer) == "a catalogue of 1 springs"
    path.write_text("steps: [{spring: stiff}]")
    assert load_plan(path).springs["stiff"].stiffness == 6e7  # the one that ships


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("blue: {stiffness: -1.0}", "blue: stiffness = -1 N/m is out of bounds"),
        ("blue: {stiffness: 4.0e+7, tolerance: 3}", "tolerance = 3 is out of bounds: it must be 0 to 0.5"),
        ("blue: {stiffness: 4.0e+7, colour: 3}", "unknown parameter 'colour'"),
        ("blue: {stiffness: 4.0e+7}\nred: 3", "red: a spring is a mapping with a stiffness"),
    ],
)
def test_a_bad_catalogue_of_springs_is_refused(tmp_path, text, sentence):
    path = tmp_path / "springs.yaml"
    path.write_text(text)
    with pytest.raises(SquealRigError) as refused:
        check_file(path)
    assert sentence in str(refused.value)


def test_a_refusal_ends_the_plan(tmp_path):
    class Refusing(Notebook):
        def call(self, service: str) -> str:
            raise ExperimentError("the rig refused reset: not active")

    path = tmp_path / "plan.yaml"
    path.write_text("steps:\n- {call: reset}\n")
    told = []
    with pytest.raises(ExperimentError, match="not active"):
        run_plan(load_plan(path), Refusing(), told.append)
    assert (told[-1].what, told[-1].failed) == ("step ended", True)
    assert told[-1].facts["outcome"] == "the rig refused reset: not active"


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("steps: []", "a plan is a mapping with a title and a list of steps"),
        ("steps: [3]", "step 1: a step is a mapping"),
        ("steps: [{wait: -1}]", "step 1: wait = -1 is out of bounds: it must be 0 to 86400 s"),
        ("steps: [{wait: .nan}]", "step 1: wait = nan is out of bounds"),
        ("steps: [{wait: soon}]", "step 1: wait = 'soon' is out of bounds"),
        ("steps: [{wait: 1}, {call: dance}]", "step 2: call = 'dance' is not known: it must be one of reset"),
        ("steps: [{hit: -1}]", "step 1: hit = -1 is out of bounds: it must be 0 to 100"),
        ("steps: [{hit: 0.9, set: {preload: 60}}]", "step 1: a hit is a step of its own"),
        ("steps: [{set: {preload: -1}}]", "step 1: preload = -1 N is out of bounds: it must be 0 to 2000 N"),
        ("steps: [{set: {preloud: 1}}]", "unknown parameter 'preloud': did you mean 'preload'?"),
        ("steps: [{set: {mass: 1}}]", "mass is a constant of the machine"),
        ("steps: [{spring: blue}]", "step 1: spring = 'blue' is not known: there are soft, medium, stiff, rigid"),
        ("springs: 3\nsteps: [{wait: 1}]", "springs = 3 is not the path of a catalogue"),
        ("steps: [{spring: 3}]", "step 1: spring = 3 is not a name of the catalogue"),
        ("steps: [{spring: soft, call: reset}]", "step 1: a change of springs is a step of its own"),
        ("steps: [{dwell: 3}]", "step 1: dwell is the time to fit a spring"),
        ("steps: [{spring: soft, dwell: -3}]", "step 1: dwell = -3 is out of bounds: it must be 0 to 86400 s"),
        ("steps: [{say: hello}]", "unknown key 'say'"),
        ("steps: [{wait: 1}]\nspeed: 3", "unknown key 'speed'"),
    ],
)
def test_a_bad_plan_is_refused_with_its_place(tmp_path, text, sentence):
    path = tmp_path / "plan.yaml"
    path.write_text(text)
    with pytest.raises(SquealRigError) as refused:
        load_plan(path)
    assert sentence in str(refused.value)
    assert str(path) in str(refused.value)


@pytest.mark.parametrize("path", sorted(config_directory().rglob("*.yaml")), ids=lambda path: path.stem)
def test_every_file_we_ship_is_in_order(path):
    assert check_file(path)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("/**/rig:\n  ros__parameters: {mass: -1.0}", "mass = -1 kg is out of bounds"),
        ("/**/rig:\n  ros__parameters: {sample_rate: 51234}", "must be a multiple of 100 Hz"),
        ("/**/rig:\n  ros__parameters: {belt_speed: 10, preload: 300}", "the friction law gives mu"),
        ("/**/rig:\n  ros__parameters: {preset: nobody}", "no preset 'nobody': there are yavuz_sen_2023"),
        ("/**/rig:\n  parameters: {mass: 1}", "holds ros__parameters and nothing else"),
        ("/**/rigg:\n  ros__parameters: {mass: 1}", "no node 'rigg'"),
        ("rig:\n  ros__parameters: {mass: 1.0}", "write /**/rig"),
        ("/**/squeal_detector:\n  ros__parameters: {band_low: 9000}", "band_low = 9000 Hz must be below"),
        ("/**/player:\n  ros__parameters: {topics: daq}", "topics = 'daq' is not a list of texts"),
        ("- 1\n- 2", "expected a mapping"),
    ],
)
def test_a_bad_parameter_file_is_refused_with_a_sentence(tmp_path, text, sentence):
    path = tmp_path / "rig.yaml"
    path.write_text(text)
    with pytest.raises(SquealRigError) as refused:
        check_file(path)
    assert sentence in str(refused.value)


def test_integers_are_taken_where_floats_are_meant(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text("/**/rig:\n  ros__parameters: {preload: 300, k1: 6e7, use_sim_time: true}")
    assert check_file(path) == "parameters of rig"


def test_the_table_in_the_docs_is_that_of_the_code():
    assert (ROOT / "docs" / "parameters.md").read_text() == parameter_table()


def test_no_name_is_declared_twice_for_one_node():
    for node, kinds in NODE_PARAMETERS.items():
        names = [name for kind in kinds for name in declarations(kind)]
        assert len(names) == len(set(names)), node
