"""Cut and merge: payloads, times, types, QoS and provenance stay what they were."""

import pytest
from bag_making import START, messages_of, write_bag
from mcap.writer import CompressionType, Writer

from squeal_rig.errors import RecordingError
from squeal_rig.recording import Bag
from squeal_rig.recording.rewrite import cut, merge
from squeal_rig.recording.verify import verify
from tests.messages import schema_of, string_cdr


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    directory = tmp_path_factory.mktemp("rewrite") / "run"
    return directory, write_bag(directory)


def test_a_cut_holds_its_time_and_the_latched_values_from_before(bag, tmp_path):
    directory, sent = bag
    cut(directory, tmp_path / "piece", 0.5, 1.0)
    low, high = START + 500_000_000, START + 1_000_000_000
    got = messages_of(Bag(tmp_path / "piece"))
    assert got[0].topic == "/rig/description"
    assert (got[0].data, got[0].log_time, got[0].publish_time) == (sent[0].data, low, sent[0].publish_time)
    assert got[1:] == [m for m in sent if low <= m.log_time < high]
    piece = Bag(tmp_path / "piece")
    assert piece.topics["/rig/description"].qos == Bag(directory).topics["/rig/description"].qos
    assert piece.custom_data["seed"] == "7"
    assert piece.ending == "cut from a bag that ended: complete"
    assert verify(tmp_path / "piece").sound


def test_a_cut_from_the_beginning_has_what_is_older_than_the_index_says(tmp_path):
    """A file of others without checksums, in which a bit of a time has fallen over."""
    text = schema_of("std_msgs/msg/String")
    file = tmp_path / "odd.mcap"
    with file.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE, enable_crcs=False)
        writer.start("ros2")
        schema = writer.register_schema(text.type_name, text.encoding, text.text.encode())
        channel = writer.register_channel("/words", "cdr", schema)
        for number in range(3):
            writer.add_message(channel, START + number, string_cdr(str(number)), START + number)
        writer.finish()
    first, older = (time.to_bytes(8, "little") for time in (START, START - 10**9))
    of_chunk, behind = file.read_bytes().split(first, 1)
    file.write_bytes(of_chunk + first + behind.replace(first, older, 1))  # the message's, not the chunk's own
    there = messages_of(Bag(file))
    assert [m.log_time for m in there] == [START - 10**9, START + 1, START + 2]
    cut(file, tmp_path / "piece")
    assert messages_of(Bag(tmp_path / "piece")) == there


def test_a_cut_by_topic_leaves_the_others_out(bag, tmp_path):
    directory, sent = bag
    cut(directory, tmp_path / "piece", topics=["daq/*"])
    assert messages_of(Bag(tmp_path / "piece")) == [m for m in sent if m.topic == "/daq/samples"]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"start": 100.0}, r"start = 100 s is not within the bag"),
        ({"start": 1.0, "end": 0.5}, r"end = 0.5 s must be above start = 1 s"),
        ({"end": float("nan")}, r"end = nan s must be above start = 0 s"),
        ({"topics": ["nothing"]}, "No topic"),
    ],
)
def test_a_cut_of_nothing_is_refused(bag, tmp_path, arguments, sentence):
    with pytest.raises(RecordingError, match=sentence):
        cut(bag[0], tmp_path / "piece", **arguments)


def test_two_pieces_merge_into_the_whole(bag, tmp_path):
    directory, sent = bag
    cut(directory, tmp_path / "a", 0.0, 1.0)
    cut(directory, tmp_path / "b", 1.0, topics=["daq/*", "truth/*"])
    merge([tmp_path / "b", tmp_path / "a"], tmp_path / "both")
    assert messages_of(Bag(tmp_path / "both")) == sent
    assert Bag(tmp_path / "both").custom_data["1.seed"] == "7"
    assert verify(tmp_path / "both").sound


def test_bags_that_overlap_are_merged_in_the_order_of_time(tmp_path):
    first = write_bag(tmp_path / "a", blocks=20)
    second = write_bag(tmp_path / "b", blocks=20, start=START + 5_000_000)
    merge([tmp_path / "a", tmp_path / "b"], tmp_path / "both")
    got = messages_of(Bag(tmp_path / "both"))
    assert got == sorted(first + second, key=lambda m: m.log_time)
    verdict = verify(tmp_path / "both")
    assert any("seq goes back" in finding.sentence for finding in verdict.findings)


def test_one_bag_alone_is_no_merge(bag, tmp_path):
    with pytest.raises(RecordingError, match="bags given: 1"):
        merge([bag[0]], tmp_path / "out")


@pytest.mark.parametrize("end", [1e300, float("inf")])
def test_a_cut_to_an_end_beyond_all_is_one_to_the_end(bag, tmp_path, end):
    assert cut(bag[0], tmp_path / "piece", 1.0, end) == cut(bag[0], tmp_path / "other", 1.0)
