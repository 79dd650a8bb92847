"""Commands that need no ROS: help, check, info, analyse, and what they say to nonsense."""

import subprocess
import sys
from pathlib import Path

import pytest

import squeal_rig
from squeal_rig.configuration.files import config_directory
from squeal_rig.recording import BagWriter
from tests.made_bag import write_squeal
from tests.messages import schema_of, string_cdr

_COMMANDS = ("run", "demo", "analyse", "cycles", "map", "check", "info", "warm-up")


@pytest.fixture(scope="module")
def bag(tmp_path_factory, compiled_zones):
    """A bag of a second of squeal."""
    folder = tmp_path_factory.mktemp("bags") / "bag"
    write_squeal(folder)
    return folder


def test_help_pages_work_and_name_every_command(in_process):
    code, output, errors = in_process("--help")
    assert (code, errors) == (0, "")
    assert all(command in output for command in _COMMANDS)
    for command in _COMMANDS:
        code, output, errors = in_process(command, "--help")
        assert (code, errors) == (0, "")
        assert f"{command} [OPTIONS]" in output


def test_parameters_presets_and_plans_that_ship_are_in_order(in_process):
    config = config_directory()
    files = [config / "rig.yaml", *sorted(config.glob("presets/*.yaml")), *sorted(config.glob("plans/*.yaml"))]
    assert len(files) >= 4
    for file in files:
        code, output, errors = in_process("check", file)
        assert (code, errors) == (0, ""), file
        assert "all in order" in " ".join(output.split())


BAD_FILES = {
    "unknown_parameter": ("preloda: 50.0\n", "unknown parameter 'preloda': did you mean 'preload'?"),
    "negative_mass": ("mass: -1.0\n", "mass = -1 kg is out of bounds"),
    "nan": ("preload: .nan\n", "preload = nan N is not finite"),
    "broken": ("mass: [1.0\n", "not valid YAML"),
    "duplicate": ("mass: 1.0\nmass: 2.0\n", "not valid YAML"),
    "a_word": ("hello\n", "expected a mapping, got 'hello'"),
    "empty": ("", "expected a mapping, got None"),
    "negative_friction": ("mu0: -1.0\n", "the friction law gives mu"),
    "unknown_node": ("/**/engine:\n  ros__parameters:\n    mass: 1.0\n", "no node 'engine'"),
    "key_that_no_namespace_matches": ("rig:\n  ros__parameters:\n    mass: 1.0\n", "write /**/rig"),
    "parameter_of_another_node": ("/**/stability:\n  ros__parameters:\n    mass: 1.0\n", "unknown parameter 'mass'"),
    "empty_plan": ("steps: []\n", "list of steps"),
    "plan_with_a_constant": ("steps:\n  - set: {mass: 1.0}\n", "step 1: mass is a constant of the machine"),
    "plan_with_an_unknown_call": ("steps:\n  - call: explode\n", "it must be one of reset, impact, zero"),
    "plan_that_waits_backwards": ("steps:\n  - wait: -1.0\n", "wait = -1.0 is out of bounds"),
    "markup": ("'[bold]': 1.0\n", "unknown parameter '[bold]'"),
}


def _assert_one_sentence(code, output, errors, sentence):
    assert code == 2
    assert output == ""
    assert errors.startswith("squeal-rig: ")
    assert errors.count("\n") == 1
    assert sentence in errors


@pytest.mark.parametrize("name", BAD_FILES)
def test_check_refuses_a_bad_file_with_one_sentence(in_process, tmp_path, name):
    text, sentence = BAD_FILES[name]
    file = tmp_path / f"{name}.yaml"
    file.write_text(text, encoding="utf-8")
    _assert_one_sentence(*in_process("check", file), sentence)


@pytest.mark.parametrize("command", ["analyse", "info"])
def test_nonsense_instead_of_a_bag_is_refused_with_one_sentence(in_process, tmp_path, bag, command):
    (tmp_path / "empty_folder").mkdir()
    (tmp_path / "empty.mcap").touch()
    (tmp_path / "text.mcap").write_text("no bag at all\n", encoding="utf-8")
    whole = next(bag.glob("*.mcap")).read_bytes()
    (tmp_path / "half.mcap").write_bytes(whole[: len(whole) // 2])
    broken = tmp_path / "broken_metadata"
    broken.mkdir()
    (broken / "metadata.yaml").write_text("rosbag2_bagfile_information: 3\n", encoding="utf-8")
    nonsense = ("not_there", "empty_folder", "empty.mcap", "text.mcap", "half.mcap", "broken_metadata")
    for name in nonsense:
        _assert_one_sentence(*in_process(command, tmp_path / name), name)


def test_analyse_of_a_bag_of_something_else_says_what_is_missing(in_process, tmp_path):
    string = schema_of("std_msgs/msg/String")
    with BagWriter(tmp_path / "other") as writer:
        topic = writer.add_topic("/chatter", string.type_name, [], string)
        writer.write(topic, string_cdr("hello"), 1, 1)
    _assert_one_sentence(*in_process("analyse", tmp_path / "other"), "no topic rig/description")


def test_info_tells_topics_times_and_how_the_bag_ended(in_process, bag):
    code, output, errors = in_process("info", bag)
    assert (code, errors) == (0, "")
    for word in ("/daq/samples", "sensor_msgs/msg/PointCloud2", "/rig/description", "201", "complete"):
        assert word in output


def test_analyse_writes_a_table_and_a_picture(in_process, bag, tmp_path):
    picture = tmp_path / "squeal.png"
    code, output, errors = in_process("analyse", bag, "--picture", picture)
    assert (code, errors) == (0, "")
    assert "Operating points" in output
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert not (bag / "report.png").exists()


@pytest.mark.slow
def test_warm_up_says_how_long_it_took(in_process):
    # What it compiles, tests/model/test_compiled_code.py tells.
    code, output, errors = in_process("warm-up")
    assert (code, errors) == (0, "")
    assert "the model is compiled: " in output


def test_unknown_commands_and_options_are_refused_without_a_traceback(in_process):
    run = (["run", "--explode"], ["run", "--duration", "-1"], ["run", "--duration", "long"])
    for arguments in (["explode"], ["check"], *run):
        code, _, errors = in_process(*arguments)
        assert code == 2
        assert "Traceback" not in errors
        assert errors.strip()


def _python(program, *arguments):
    command = [sys.executable, "-c", program, *arguments]
    return subprocess.run(command, check=False, capture_output=True, text=True, timeout=60.0)


@pytest.mark.slow
def test_commands_that_need_no_ros_import_none(bag, tmp_path):
    picture = str(tmp_path / "picture.png")
    on_bag = ["info", str(bag)], ["analyse", str(bag), "--picture", picture]
    commands = [["check", str(config_directory() / "rig.yaml")], *on_bag]
    program = (
        "import sys\n"
        "from squeal_rig import cli\n"
        f"for command in {commands!r}:\n"
        "    sys.argv = ['squeal-rig', *command]\n"
        "    try:\n        code = cli.main()\n    except SystemExit as end:\n        code = end.code\n"
        "    assert not code, (command, code)\n"
        "    ros = [n for n in sys.modules if n.split('.')[0] in ('rclpy', 'sensor_msgs', 'rcl_interfaces')]\n"
        "    assert not ros, (command, ros)\n"
    )
    result = _python(program)
    assert result.returncode == 0, result.stderr


@pytest.mark.slow
def test_commands_that_need_ros_say_so_where_it_is_missing(tmp_path):
    # A package named rclpy that cannot be imported stands for none.
    (tmp_path / "rclpy.py").write_text("raise ModuleNotFoundError(\"No module named 'rclpy'\", name='rclpy')\n")
    paths = [str(tmp_path), str(Path(squeal_rig.__file__).parents[1])]
    program = f"import sys; sys.path[:0] = {paths!r}; from squeal_rig.cli import main; sys.exit(main())"
    for command in (["demo"], ["run"]):
        result = _python(program, *command)
        _assert_one_sentence(result.returncode, result.stdout, result.stderr, "ROS 2 is not installed here")


def test_paths_that_cannot_be_are_one_sentence(in_process, tmp_path):
    for arguments in (
        ("info", "a" * 300), ("analyse", "a" * 300), ("bag", "verify", "a" * 300), ("bag", "recover", "a" * 300, "out"),
        ("bag", "cut", "a" * 300, "out"), ("check", "a" * 300),
    ):  # fmt: skip
        _assert_one_sentence(*in_process(*arguments), "name too long")


@pytest.mark.parametrize("value", ["nan", "inf"])
def test_times_that_are_not_finite_are_refused(in_process, bag, tmp_path, value):
    for arguments in (("run", "--duration", value), ("bag", "cut", bag, tmp_path / "out", "--end", value)):
        code, _, errors = in_process(*arguments)
        told = " ".join(errors.replace("│", " ").split())
        assert code == 2
        assert f"{value} s is not finite" in told or "greater than or equal to 0" in told


def test_a_text_that_no_message_can_hold_is_refused(in_process, tmp_path):
    plan = tmp_path / "plan.yaml"
    for title in (r"\ud800", r"a\0b"):
        plan.write_text(f'title: "{title}"\nsteps: [{{wait: 1.0}}]\n', encoding="utf-8")
        _assert_one_sentence(*in_process("check", plan), "has a character that no message can hold")
