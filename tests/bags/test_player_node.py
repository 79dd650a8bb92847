"""The player as a process: what was recorded comes out again, under control; bags of others play."""

import json

import numpy as np
import pytest
from bag_nodes import Children, ended, published, wait_until
from full_load import CLOUDS, SMALL

from squeal_rig.recording import Bag

TOPICS = (*CLOUDS, *SMALL, "/rig/description")


@pytest.fixture(scope="module")
def recorded(bag_domain, tmp_path_factory):
    """A bag of some seconds of full load."""
    from bag_nodes import Client

    folder = tmp_path_factory.mktemp("player")
    children, client = Children(bag_domain, folder), Client(bag_domain)
    recorder = children.node("recorder", directory=folder / "run", topics=TOPICS)
    client.wait_for(lambda: "recorder" in client.health, "the recorder")
    load = children.load(folder / "load.txt", 4.0, wait=True)
    assert load.wait(60) == 0
    assert published(folder / "load.txt")[0] > 350
    assert ended(recorder) == 0
    client.close()
    children.end_all()
    return folder / "run"


def messages(bag):
    """Topic -> payloads in order."""
    found = {topic: [] for topic in bag.topics}
    for message in bag.messages():
        found[message.topic].append(message.data)
    return found


def test_record_replay_record_gives_the_same_again(children, client, tmp_path, recorded, record_property):
    recorder = children.node("recorder", directory=tmp_path / "again", topics=TOPICS)
    client.wait_for(lambda: "recorder" in client.health, "the recorder")
    player = children.node("player", bag=recorded, topics=["*"], wait_for_subscribers=15.0)
    assert player.wait(60) == 0, player.log.read_text()
    first = Bag(recorded)
    client.wait_for(lambda: client.messages_recorded() >= first.message_count, "all messages")
    assert ended(recorder) == 0
    second = Bag(tmp_path / "again")
    assert {n: (t.type_name, t.type_hash, t.message_count, t.qos) for n, t in first.topics.items()} == {
        n: (t.type_name, t.type_hash, t.message_count, t.qos) for n, t in second.topics.items()
    }
    assert messages(first) == messages(second)
    before = np.sort([m.log_time for m in first.messages()])
    after = np.sort([m.publish_time for m in second.messages()])
    error = np.abs(np.diff(after) - np.diff(before)) * 1e-6
    p50, p99 = np.percentile(error, [50, 99])
    record_property("spacing_error_ms", json.dumps({"p50": p50, "p99": p99}))
    print(f"\nspacing error p50 {p50:.3f} ms, p99 {p99:.3f} ms")  # noqa: T201
    # 0.1 and 0.7 ms were measured; a busy machine may be ten times as late.
    assert p50 < 1.0


def test_services_and_parameters_control_the_replay(children, client, recorded):
    from rosgraph_msgs.msg import Clock

    clocks = []
    client.node.create_subscription(
        Clock, "/clock", lambda m: clocks.append(m.clock.sec * 10**9 + m.clock.nanosec), 100
    )
    player = children.node("player", bag=recorded, topics=["daq/*"], start_paused=True, loop=True, clock=True)

    def told(key):
        return float(client.health["player"][2][key]) if "player" in client.health else -1.0

    client.wait_for(lambda: "player" in client.health, "the player")
    assert told("messages") == 0.0
    assert client.trigger("player/step")[0]
    client.wait_for(lambda: told("messages") == 1.0, "one message")
    assert client.set("/player", "seek_to", 2.0) == (True, "")
    client.wait_for(lambda: told("position [s]") == 2.0, "the place sought")
    assert client.set("/player", "seek_to", 1e6)[0] is False
    assert client.set("/player", "rate", 0.5) == (True, "")
    assert client.trigger("player/resume")[0]
    assert client.trigger("player/step")[0] is False
    client.wait_for(lambda: told("loops") >= 1.0, "the next loop")
    assert client.trigger("player/pause")[0]
    start, end = Bag(recorded).start_time, Bag(recorded).end_time
    assert clocks
    assert all(start <= clock <= end for clock in clocks)
    assert min(clocks[-1], clocks[0]) < start + 3_000_000_000
    assert ended(player) == 0


def test_a_bag_written_by_rosbags_plays_under_another_name(children, client, tmp_path):
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore
    from std_msgs.msg import String

    store = get_typestore(Stores.ROS2_JAZZY)
    kind = store.types["std_msgs/msg/String"]
    with Writer(tmp_path / "foreign", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/words", kind.__msgtype__, typestore=store)
        for number in range(20):
            data = store.serialize_cdr(kind(f"word {number}"), kind.__msgtype__)
            writer.write(connection, 10**18 + number * 10_000_000, data)
    heard = []
    client.node.create_subscription(String, "/lab/words", lambda message: heard.append(message.data), 100)
    player = children.node(
        "player", bag=tmp_path / "foreign", topics=["*"], remap=["/:=/lab/"], wait_for_subscribers=15.0
    )
    client.wait_for(lambda: len(heard) == 20, "all words", 30.0)
    assert heard == [f"word {number}" for number in range(20)]
    wait_until(lambda: player.poll() is not None, "the player's end")
    assert player.returncode == 0


@pytest.mark.parametrize(
    ("parameters", "sentence"),
    [
        ({"bag": "/no/such/bag"}, "There is no bag at /no/such/bag"),
        ({"rate": 0.001}, "rate = 0.001 is out of bounds"),
        ({"topics": ["nothing"]}, "no topic"),
        ({"start_offset": 1000.0}, "behind the bag's end"),
        ({"remap": ["nonsense"]}, "is no rule"),
    ],
)
def test_bad_input_ends_the_player_with_a_sentence(children, recorded, parameters, sentence):
    player = children.node("player", **{"bag": recorded, **parameters})
    assert player.wait(30) == 2
    log = player.log.read_text()
    assert sentence in log
    assert "Traceback" not in log
