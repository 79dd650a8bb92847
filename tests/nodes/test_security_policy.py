"""config/security/policy.xml against the running nodes: each may do what it does, and nothing else."""

import pytest

from squeal_rig.configuration.files import config_directory
from squeal_rig.nodes.start import NODES
from tests.graph.policies import WITHIN, look_until_quiet, read_policy

pytestmark = pytest.mark.slow  # every node at once, until nothing new comes

_REMEDY = "config/security/policy.xml is not what the nodes do: look at it, then `make policy`"


@pytest.fixture(scope="module")
def seen(compiled, processes, observer, tmp_path_factory):
    """What every node does on the graph."""
    return look_until_quiet(processes, observer, tmp_path_factory.mktemp("policies"))


@pytest.fixture(scope="module")
def policy():
    """What every node may do."""
    return read_policy(config_directory() / "security" / "policy.xml")


def test_every_node_has_a_policy(policy):
    assert set(policy) - set(WITHIN) == (set(NODES) - {"simulator"}) | {"console"}


def test_nodes_do_nothing_that_their_policy_does_not_allow(seen, policy):
    surplus = {name: sorted(grants - policy.get(name, set())) for name, grants in seen.items()}
    assert {name: grants for name, grants in surplus.items() if grants} == {}, _REMEDY


def test_policies_allow_nothing_that_nodes_do_not_do(seen, policy):
    surplus = {name: sorted(grants - seen.get(name, set())) for name, grants in policy.items()}
    assert {name: grants for name, grants in surplus.items() if grants} == {}, _REMEDY


def test_samples_come_from_the_rig_and_the_player_alone(policy):
    for topic in ("daq/samples", "truth/samples", "rig/description"):
        assert {name for name, grants in policy.items() if ("publish", topic) in grants} == {"rig", "player"}


def test_no_policy_has_a_wildcard(policy):
    assert [what for grants in policy.values() for _, what in grants if "*" in what] == []
