import json
import sys
from pathlib import Path

import pytest
from rosbags.typesys import get_types_from_msg

from squeal_rig.errors import RecordingError
from squeal_rig.recording import decoder_of, installed_schema
from squeal_rig.recording.schemas import field_types

SHARE = Path(sys.prefix, "share")
RIG_TYPES = [
    "sensor_msgs/msg/PointCloud2",
    "sensor_msgs/msg/JointState",
    "geometry_msgs/msg/WrenchStamped",
    "std_msgs/msg/String",
    "std_msgs/msg/Float64",
    "std_msgs/msg/Float64MultiArray",
    "diagnostic_msgs/msg/DiagnosticArray",
    "rcl_interfaces/msg/ParameterEvent",
    "rcl_interfaces/msg/Log",
    "rosgraph_msgs/msg/Clock",
    "lifecycle_msgs/msg/TransitionEvent",
]
needs_interfaces = pytest.mark.skipif(
    not (SHARE / "sensor_msgs").is_dir(), reason="the ROS interface packages are not installed beside Python"
)


@pytest.fixture
def prefix(tmp_path, monkeypatch):
    """A prefix with one interface package of three types, first in AMENT_PREFIX_PATH."""
    folder = tmp_path / "share" / "rig_test_msgs" / "msg"
    folder.mkdir(parents=True)
    texts = {
        "Top": "Zed[<=3] zeds\nrig_test_msgs/Alpha alpha  # of Beta words\nstring<=20 name\nuint8 ONE=1\n",
        "Zed": "Alpha[2] alphas\n",
        "Alpha": "float64 value\n",
    }
    for name, text in texts.items():
        full = f"rig_test_msgs/msg/{name}"
        hashes = {"type_hashes": [{"type_name": full, "hash_string": f"RIHS01_{name}"}]}
        (folder / f"{name}.msg").write_text(text)
        (folder / f"{name}.json").write_text(json.dumps(hashes))
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    installed_schema.cache_clear()
    yield folder
    installed_schema.cache_clear()


def test_each_dependency_follows_once_in_sorted_order_depth_first(prefix):
    separator = "=" * 80
    assert installed_schema("rig_test_msgs/msg/Top").text == (
        (prefix / "Top.msg").read_text()
        + f"\n{separator}\nMSG: rig_test_msgs/msg/Alpha\nfloat64 value\n"
        + f"\n{separator}\nMSG: rig_test_msgs/msg/Zed\nAlpha[2] alphas\n"
    )


def test_the_type_hash_is_the_installed_one(prefix):
    assert installed_schema("rig_test_msgs/Top").type_hash == "RIHS01_Top"


def test_constants_comments_and_bounded_strings_are_no_dependencies():
    text = "# Foo bar\nuint8 A=1\nstring<=10[] names\n  pkg/Bar[4] bars # Baz qux\nwstring w\n"
    assert field_types(text, "here") == ("pkg/msg/Bar",)


@pytest.mark.parametrize("name", ["", "String", "std_msgs/srv/String", "../x/msg/Y", "std_msgs/msg/"])
def test_a_name_that_is_no_message_type_is_refused(name):
    with pytest.raises(RecordingError, match="is not the name of a ROS message type"):
        installed_schema(name)


def test_a_type_that_is_not_installed_is_named_in_one_sentence(prefix):
    with pytest.raises(RecordingError, match=r"No \.msg file of rig_test_msgs/msg/Nothing is installed"):
        installed_schema("rig_test_msgs/msg/Nothing")


def test_a_damaged_type_description_is_named(prefix):
    (prefix / "Alpha.json").write_text("{}")
    with pytest.raises(RecordingError, match=r"Alpha\.json holds no type hash"):
        installed_schema("rig_test_msgs/msg/Alpha")


@needs_interfaces
@pytest.mark.parametrize("name", RIG_TYPES)
def test_installed_definitions_agree_with_the_type_store_of_rosbags(name, types):
    schema = installed_schema(name)
    assert schema.type_hash == types.hash_rihs01(name)
    definitions = get_types_from_msg(schema.text, name)
    assert name in definitions
    for defined, (_, fields) in definitions.items():
        assert fields == types.fielddefs[defined][1]


@needs_interfaces
@pytest.mark.parametrize("name", RIG_TYPES)
def test_mcaps_ros2_decoder_accepts_every_installed_definition(name):
    assert callable(decoder_of(installed_schema(name)))
