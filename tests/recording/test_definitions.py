"""Two definitions under one type name: messages of one are never read by the other."""

import shutil
import struct

import pytest
from bag_making import START

from squeal_rig.errors import RecordingError
from squeal_rig.recording import Bag, BagWriter, MessageSchema, decoder_of
from squeal_rig.recording.recover import recover
from squeal_rig.recording.rewrite import cut, merge

PAIR = "test_rig/msg/Pair"
FORCES = MessageSchema(PAIR, "float64 normal  # [N]\nfloat64 tangential\n")
SWAPPED = MessageSchema(PAIR, "float64 tangential\nfloat64 normal\n")
RESPELT = MessageSchema(PAIR, "# of another release\n\nfloat64   normal\nfloat64 tangential # [N]\n")


def write(directory, definition, topic="/forces", start=START):
    with BagWriter(directory) as writer:
        handle = writer.add_topic(topic, PAIR, schema=definition)
        for number in range(3):
            values = {"normal": 50.0, "tangential": 17.5}
            order = [line.split()[1] for line in definition.text.splitlines() if line.startswith("float64")]
            data = b"\0\1\0\0" + struct.pack("<2d", *(values[name] for name in order))
            writer.write(handle, data, start + number, start + number)
    return directory


def forces(directory):
    bag = Bag(directory)
    decoded = [decoder_of(bag.topics[m.topic].schema)(m.data) for m in bag.messages()]
    return {(pair.normal, pair.tangential) for pair in decoded}


@pytest.mark.parametrize("topic", ["/forces", "/other"])
def test_bags_that_define_a_type_in_two_ways_are_not_merged(tmp_path, topic):
    bags = [write(tmp_path / "a", FORCES), write(tmp_path / "b", SWAPPED, topic, START + 100)]
    with pytest.raises(RecordingError, match=r"b: test_rig/Pair of /\w+ has other fields than in .*a; one bag cannot"):
        merge(bags, tmp_path / "both")
    assert not (tmp_path / "both").exists()


def test_comments_and_spacing_make_no_other_definition(tmp_path):
    bags = [write(tmp_path / "a", FORCES), write(tmp_path / "b", RESPELT, start=START + 100)]
    assert merge(bags, tmp_path / "both") == 6
    assert forces(tmp_path / "both") == {(50.0, 17.5)}


def test_a_definition_within_a_definition_counts(tmp_path):
    outer, separator = "test_rig/Pair pair\n", "=" * 80
    first, second = (
        MessageSchema("test_rig/msg/Two", f"{outer}{separator}\nMSG: test_rig/Pair\n{inner.text}")
        for inner in (FORCES, SWAPPED)
    )
    assert first.conflict(second) == "test_rig/Pair"
    nameless = MessageSchema(first.type_name, first.text.replace("MSG: test_rig/Pair\n", "MSG: test_rig/PairJ"))
    assert first.conflict(nameless) == "test_rig/Pair"
    assert nameless.conflict(first)


def test_a_definition_that_nobody_can_read_by_is_no_other_wording_of_a_good_one(tmp_path):
    text = f"test_rig/Pair pair\n{'=' * 80}\nMSG: test_rig/Pair\n{FORCES.text}"
    good, damaged = (MessageSchema(PAIR, t) for t in (text, text.replace("MSG:", "OSG:")))
    assert good.conflict(damaged) == damaged.conflict(good) == "'OSG: test_rig/Pair'"
    assert damaged.conflict(damaged) is None
    bags = [write(tmp_path / "a", damaged), write(tmp_path / "b", good, start=START + 100)]
    with pytest.raises(RecordingError, match="one bag cannot hold both"):
        merge(bags, tmp_path / "both")


def test_topics_whose_definitions_differ_in_language_alone_keep_theirs(tmp_path):
    """Found by fuzz, which had damaged the name of one."""
    other = MessageSchema(PAIR, FORCES.text, encoding="ros2\0sg")
    with BagWriter(tmp_path / "a") as writer:
        for topic, definition in (("/other", other), ("/forces", FORCES)):
            writer.write(writer.add_topic(topic, PAIR, schema=definition), bytes(20), START, START)
    cut(tmp_path / "a", tmp_path / "piece")
    told = {name: topic.schema.encoding for name, topic in Bag(tmp_path / "piece").topics.items()}
    assert told == {"/other": other.encoding, "/forces": FORCES.encoding}
    bags = [write(tmp_path / "b", FORCES), tmp_path / "a"]
    with pytest.raises(RecordingError, match=r"a: test_rig/msg/Pair of /other has other fields than in .*b"):
        merge(bags, tmp_path / "both")


def test_recover_keeps_the_first_definition_and_leaves_out_the_messages_of_another(tmp_path):
    folder = tmp_path / "files"
    folder.mkdir()
    for number, definition in enumerate((FORCES, SWAPPED)):
        made = write(tmp_path / f"run{number}", definition, start=START + 100 * number)
        shutil.copy(made / f"run{number}_0.mcap", folder / f"run_{number}.mcap")
    with pytest.raises(RecordingError, match=r"run_1.mcap has topic /forces in two definitions"):
        Bag(folder)
    report = recover(folder, tmp_path / "out")
    assert (report.messages, report.complete) == (3, False)
    assert any("3 messages were left out: test_rig/Pair of /forces has other" in told for told in report.sentences())
    assert forces(tmp_path / "out") == {(50.0, 17.5)}


def test_a_piece_keeps_the_definition_that_it_had(tmp_path):
    cut(write(tmp_path / "a", SWAPPED), tmp_path / "piece")
    assert forces(tmp_path / "piece") == {(50.0, 17.5)}
