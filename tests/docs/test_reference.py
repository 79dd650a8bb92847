"""The page of topics and services against what the nodes do, by the policies that are read off them."""

import re

import yaml

from squeal_rig.configuration.declared import declarations
from squeal_rig.configuration.files import config_directory
from squeal_rig.recording.settings import DEFAULT_TOPICS
from squeal_rig.safety.settings import SupervisorSettings
from tests.graph.policies import read_policy

from .pages import DOCS

_PAGE = (DOCS / "interfaces.md").read_text(encoding="utf-8")
_POLICY = read_policy(config_directory() / "security" / "policy.xml")
# Of every node, or of every managed one: ROS's own.
_OF_ROS = {"/parameter_events", "/rosout", "rig/transition_event"}
_PARAMETERS = re.compile(r"/(\w+_parameters(_atomically)?|get_parameter_types|get_type_description)$")
_LIFECYCLE = re.compile(r"/(change_state|get_state|get_available_\w+|get_transition_graph)$")


def _of(kind):
    return {what for grants in _POLICY.values() for given, what in grants if given == kind}


def test_the_table_has_every_topic_and_no_other():
    rows = {name for row in re.findall(r"^\| (`[^|]*`) \|", _PAGE, re.M) for name in re.findall(r"`([\w/]+)`", row)}
    topics = {re.sub(r"^view/scope/\w+$", "view/scope/CHANNEL", name) for name in _of("publish") - _OF_ROS}
    assert {name for name in rows if "/" in name or name in topics} == topics


def test_every_service_is_on_the_page():
    own = {name for name in _of("reply") if not _PARAMETERS.search(name) and not _LIFECYCLE.search(name)}
    missing = {name for name in own if f"`~/{name.partition('/')[2]}`" not in _PAGE and f"`{name}`" not in _PAGE}
    assert missing == set()


def test_the_shipped_file_says_of_limits_what_their_declarations_say():
    text = (config_directory() / "rig.yaml").read_text(encoding="utf-8")
    assert yaml.safe_load(text)["/**/recorder"]["ros__parameters"]["topics"] == list(DEFAULT_TOPICS)
    block = text.partition("/**/supervisor:")[2].partition("/**/")[0]
    for name, declared in declarations(SupervisorSettings).items():
        unit = f"[{declared.unit}]" if declared.unit else ""
        above = f"# {declared.description} {unit}".strip() + f"\n    {name}: "
        beside = re.escape(f"# {unit} {declared.description}".replace("#  ", "# "))
        assert above in block or re.search(rf"^    {name}: .* {beside}$", block, re.M), name
