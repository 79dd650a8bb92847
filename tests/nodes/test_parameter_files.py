"""Parameter files as ROS users write them and as ROS tools write them: every node takes them."""

from pathlib import Path

import pytest

from squeal_rig.catalogue.checking import NODE_PARAMETERS, check_file
from squeal_rig.errors import SquealRigError
from tests.graph.processes import parameters
from tests.graph.statuses import health_of

pytest.importorskip("rclpy")

from rcl_interfaces.msg import Parameter as Change
from rcl_interfaces.msg import ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, ListParameters

#: Every node, all but the rig in the slow suite.
RIG_OR_SLOW = [name if name == "rig" else pytest.param(name, marks=pytest.mark.slow) for name in NODE_PARAMETERS]
REFERENCE = Path(__file__).parents[2] / "bags" / "reference"
FOR_ALL = """\
/**:
  ros__parameters:
    use_sim_time: false
    preload: 66.0
    window: 0.3
    band_low: 600.0
    somebody_elses: [1, 2]
    nested: {deeper: 1.0}
    qos_overrides: {/daq/samples: {publisher: {depth: 3}}}
"""


def start(processes, name, folder, *arguments):
    needs = {"player": parameters(bag=REFERENCE, start_paused="true"), "recorder": parameters(directory=folder / "bag")}
    executable = "simulator" if name == "rig" else name
    return processes.node(executable, *arguments, *needs.get(name, []))


@pytest.mark.parametrize("name", RIG_OR_SLOW)
def test_a_block_for_every_node_is_taken_as_far_as_a_node_has_it(compiled, processes, observer, tmp_path, name):
    file = tmp_path / "all.yaml"
    file.write_text(FOR_ALL, encoding="utf-8")
    node = start(processes, name, tmp_path, "--params-file", str(file))
    known = {"rig": ("preload", 66.0), "friction_estimator": ("window", 0.3), "squeal_detector": ("band_low", 600.0)}
    if name in known:
        parameter, value = known[name]
        assert observer.get([parameter], name) == {parameter: value}
    health = observer.follow("/diagnostics")
    observer.wait_for(lambda: health_of(health, name), f"health of {name}")
    assert node.end()[0] == 0
    assert "passed over: " in node.errors
    assert "somebody_elses" in node.errors
    assert check_file(file).startswith("parameters of every node (passed over: nested.deeper, qos_overrides./daq")


def test_a_bad_value_for_every_node_is_found_by_the_check(tmp_path):
    file = tmp_path / "all.yaml"
    file.write_text(FOR_ALL.replace("66.0", "-66.0"), encoding="utf-8")
    with pytest.raises(SquealRigError, match=r"preload = -66 N is out of bounds"):
        check_file(file)


def dumped(observer, name):
    """All parameters of a node as `ros2 param dump` writes them."""
    listed = observer.call(ListParameters, f"{name}/list_parameters", ListParameters.Request(), repeat=2.0)
    names = listed.result.names
    lines = [f"/{name}:", "  ros__parameters:"]
    for key, value in observer.get(names, name).items():
        if isinstance(value, bool):
            shown = "true" if value else "false"
        else:
            shown = list(value) if isinstance(value, (list, tuple)) else value
        lines.append(f"    {key}: {repr(shown) if isinstance(value, str) else shown}")
    return "\n".join(lines) + "\n"


@pytest.mark.slow
@pytest.mark.parametrize("name", RIG_OR_SLOW)
def test_what_a_node_dumps_it_loads_and_the_check_takes(compiled, processes, observer, tmp_path, name):
    extra = parameters(regularization_speed=1e-05) if name == "rig" else []
    first = start(processes, name, tmp_path / "first", *extra)
    text = dumped(observer, name)
    assert first.end()[0] == 0
    if name == "player":
        assert "remap: []" in text
    if name == "rig":
        assert "regularization_speed: 1e-05" in text
    file = tmp_path / "dump.yaml"
    file.write_text(text.replace(str(tmp_path / "first"), str(tmp_path / "second")), encoding="utf-8")
    assert check_file(file) == f"parameters of {name}"
    executable = "simulator" if name == "rig" else name
    second = processes.node(executable, "--params-file", str(file))
    assert dumped(observer, name) == file.read_text(encoding="utf-8")
    assert second.end()[0] == 0


def test_numeric_text_counts_where_a_number_is_meant(bench):
    assert bench.observer.set({"preload": "6e1", "regularization_speed": "1e-05"})[0] == (True, "")
    assert bench.observer.get(["preload"]) == {"preload": 60.0}


def test_descriptors_say_what_a_range_cannot(bench):
    request = DescribeParameters.Request(names=["mass", "sample_rate", "friction_speed", "preload"])
    answer = bench.observer.call(DescribeParameters, "rig/describe_parameters", request)
    said = [descriptor.additional_constraints for descriptor in answer.descriptors]
    assert said[0] == "0.001 to 100000 kg; changes only while the rig is inactive"
    assert said[1] == "1000 to 2e+06 Hz; a multiple of 100"
    assert said[2] == "one of: belt, slip"
    assert said[3] == "0 to 2000 N"
    assert answer.descriptors[1].integer_range[0].step == 100


def test_an_empty_list_of_no_type_is_one_of_texts(compiled, processes, observer, tmp_path):
    node = start(processes, "player", tmp_path)
    # ros2cli sends an empty list as one of truth values.
    empty = Change(name="topics", value=ParameterValue(type=ParameterType.PARAMETER_BOOL_ARRAY))
    ((done, reason),) = observer.set({"topics": empty}, "player")
    assert (done, "read-only" in reason) == (False, True)  # the type is not what it is refused for
    assert node.end()[0] == 0
