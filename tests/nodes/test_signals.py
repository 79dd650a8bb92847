"""Every node ends with exit code 0 and without a word of complaint, however it is asked to."""

import signal

import pytest

from tests.graph.processes import parameters
from tests.graph.statuses import health_of
from tests.made_bag import write_squeal

pytest.importorskip("rclpy")

pytestmark = pytest.mark.slow  # every node, and every signal at it

NODES = ("rig", "simulator", "friction_estimator", "stability", "squeal_detector", "supervisor", "recorder", "player")
SIGNALS = {
    "sigint": (signal.SIGINT,),
    "sigterm": (signal.SIGTERM,),
    "sighup": (signal.SIGHUP,),
    "double_sigint": (signal.SIGINT, signal.SIGINT),
}


@pytest.fixture(scope="module")
def recorded(compiled, tmp_path_factory):
    """A bag of a second, for the player."""
    bag = tmp_path_factory.mktemp("bags") / "bag"
    write_squeal(bag)
    return bag


@pytest.fixture(
    scope="module",
    params=["double_sigint", *(pytest.param(name, marks=pytest.mark.slow) for name in ("sigint", "sigterm", "sighup"))],
)
def endings(request, recorded, processes, observer, tmp_path_factory):
    """Node -> (exit code, time to end [s], stderr): all nodes run at once and are ended one after the other."""
    folder = tmp_path_factory.mktemp("recorded")
    arguments = {
        # Two nodes named rig: each in a namespace of its own, as every node here.
        "recorder": parameters(directory=folder / "bag", topics="['/rig/daq/samples', '/rig/truth/samples']"),
        # It still plays when it is asked to end.
        "player": parameters(bag=recorded, rate=0.05, loop=True),
    }
    running = {name: processes.node(name, "-r", f"__ns:=/{name}", *arguments.get(name, [])) for name in NODES}
    health = observer.follow("/diagnostics")
    full_names = {name: f"{name}/{'rig' if name == 'simulator' else name}" for name in NODES}
    for name, node in running.items():
        observer.wait_for(lambda name=name: health_of(health, full_names[name]), f"health of {name}")
        assert node.running
    results = {}
    for name, node in running.items():
        code, seconds = node.end(*SIGNALS[request.param])
        results[name] = code, seconds, node.errors
    return results


@pytest.mark.parametrize("node", NODES)
def test_a_signal_ends_the_node_with_exit_code_0(endings, node, measured, request):
    code, _, errors = endings[node]
    assert code == 0, errors
    assert "Traceback" not in errors
    assert "Error" not in errors
    if node == NODES[-1]:
        slowest = max(endings, key=lambda name: endings[name][1])
        case, seconds = request.node.callspec.id, endings[slowest][1]
        measured(f"{case}: slowest node to end was {slowest} after {seconds:.2f} s (asked for: 2 s)")


def test_a_player_at_the_end_of_its_bag_ends_by_itself(recorded, processes, observer):
    player = processes.node("player", *parameters(bag=recorded, rate=5.0))
    assert observer.wait_for_end(player) == 0
    assert "played" in player.errors


@pytest.mark.slow
def test_a_subscriber_that_hangs_keeps_neither_the_player_nor_the_rig_from_ending(recorded, processes, observer):
    hanging = processes.node("friction_estimator")
    observer.wait_for(lambda: "friction_estimator" in observer.node.get_node_names(), "the estimator")
    blocks = observer.follow_samples("/daq/samples")
    player = processes.node("player", *parameters(bag=recorded, rate=0.1, loop=True))
    observer.wait_for(lambda: blocks, "blocks of the bag")
    played = blocks[-1].stamp_ns
    simulator = processes.node("simulator")
    # A rig of now stamps later than the bag's last block, which lies seconds of replay ahead.
    observer.wait_for(lambda: blocks[-1].stamp_ns > played + 5 * 10**9, "blocks of the rig")
    hanging.send(signal.SIGSTOP)
    blocks.clear()
    observer.wait_for(lambda: len(blocks) > 20, "blocks that the hanging node does not take")
    for node in (player, simulator):
        assert node.running
        code, _ = node.end()
        assert code == 0
        assert "Traceback" not in node.errors
    hanging.send(signal.SIGCONT)
    assert hanging.end()[0] == 0
