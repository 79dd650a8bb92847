"""Type names come out of bags: what is imported for them is an installed interface package and nothing else."""

import sys

import pytest

from squeal_rig.errors import RecordingError

pytest.importorskip("rclpy")

from squeal_rig.graph.interfaces import message_class

_NAMES = (
    "planted/msg/Word",
    "planted/Word",
    "planted.msg/msg/Word",
    "../planted/msg/Word",
    "planted",
    "",
    "/msg/",
    "a/b/c",
)


def test_an_installed_type_is_found_by_both_forms_of_its_name():
    from std_msgs.msg import String

    assert message_class("std_msgs/msg/String") is message_class("std_msgs/String") is String


@pytest.mark.parametrize("name", _NAMES)
def test_a_module_that_a_bag_names_is_not_imported(tmp_path, monkeypatch, name):
    package = tmp_path / "planted"
    package.mkdir()
    (package / "__init__.py").write_text("", encoding="utf-8")
    (package / "msg.py").write_text("class Word: pass\n", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(RecordingError):
        message_class(name)
    assert not [module for module in sys.modules if module.startswith("planted")]
