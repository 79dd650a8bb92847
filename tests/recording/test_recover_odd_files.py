"""Files that are damaged in odd ways: others inside them, bytes too many, a summary that lies."""

import zlib

import numpy as np
import pytest
from bag_making import START, chunk_places, messages_of, schema_of, write_bag
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_typestore

from squeal_rig.recording import Bag, BagWriter
from squeal_rig.recording.recover import recover
from squeal_rig.recording.verify import verify

TYPES = get_typestore(Stores.ROS2_JAZZY)
BYTES = "std_msgs/msg/UInt8MultiArray"
FOOTER = 8 + 29


@pytest.fixture
def inner(tmp_path):
    """A whole MCAP file of 41 messages."""
    write_bag(tmp_path / "inner", blocks=20, compression="none", chunk_size=4096)
    return (tmp_path / "inner" / "inner_0.mcap").read_bytes()


def bytes_cdr(data):
    message = TYPES.types[BYTES](
        layout=TYPES.types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0),
        data=np.frombuffer(data, np.uint8),
    )
    return bytes(TYPES.serialize_cdr(message, BYTES))


def outer(path, inner, attach):
    """A file of ten short messages that holds another as an attachment, or as the payload of the fifth."""
    schema = schema_of(BYTES)
    payloads = [bytes([number] * 100) for number in range(10)]
    if not attach:
        payloads[5] = inner
    with open(path, "wb") as stream:
        writer = Writer(stream, chunk_size=2000, compression=CompressionType.NONE)
        writer.start("ros2", "another recorder")
        number = writer.register_schema(schema.type_name, "ros2msg", schema.text.encode())
        channel = writer.register_channel("/bytes", "cdr", number)
        for place, payload in enumerate(payloads):
            if attach and place == 5:
                writer.add_attachment(START, START, "inner.mcap", "application/octet-stream", inner)
            writer.add_message(channel, START + place, bytes_cdr(payload), START + place, place)
        writer.finish()
    return path.read_bytes()


@pytest.mark.parametrize("attach", [True, False])
@pytest.mark.parametrize("cut", [0, 60])
def test_a_file_within_the_file_is_no_part_of_it(tmp_path, inner, attach, cut):
    data = outer(tmp_path / "outer_0.mcap", inner, attach)
    (tmp_path / "outer_0.mcap").write_bytes(data[: len(data) - cut])
    report = recover(tmp_path / "outer_0.mcap", tmp_path / "out")
    bag = Bag(tmp_path / "out")
    assert set(bag.topics) == {"/bytes"}
    assert bag.message_count == 10
    assert report.complete == (cut == 0)


@pytest.mark.parametrize("cut", [0, 60])
def test_a_file_within_a_damaged_chunk_is_no_part_of_it(tmp_path, inner, cut):
    schema = schema_of(BYTES)
    with BagWriter(tmp_path / "outer", chunk_size=2000, compression="none") as writer:
        handle = writer.add_topic("/bytes", BYTES, schema=schema)
        for number in range(10):
            payload = bytes_cdr(inner if number == 5 else bytes(100))
            writer.write(handle, payload, START + number, START)
    data = bytearray((tmp_path / "outer" / "outer_0.mcap").read_bytes())
    data[data.index(inner) - 20] ^= 0xFF
    path = tmp_path / "broken_0.mcap"
    path.write_bytes(data[: len(data) - cut])
    report = recover(path, tmp_path / "out")
    bag = Bag(tmp_path / "out")
    assert set(bag.topics) == {"/bytes"}
    assert 0 < bag.message_count < 10
    assert not report.complete
    if not cut:
        assert report.lost == 10 - bag.message_count


def test_a_file_behind_the_file_is_told_and_left_out(tmp_path, inner):
    path = tmp_path / "two_0.mcap"
    path.write_bytes(outer(path, b"", attach=True) + inner)
    report = recover(path, tmp_path / "out")
    assert set(Bag(tmp_path / "out").topics) == {"/bytes"}
    assert not report.complete
    assert any(told.startswith("1 MCAP files inside") for told in report.sentences())


@pytest.mark.parametrize("where", ["in a chunk", "between chunks", "before the header"])
@pytest.mark.parametrize("extra", [1, 700])
def test_bytes_too_many_cost_one_chunk_and_what_is_lost_is_told(tmp_path, where, extra):
    sent = write_bag(tmp_path / "run", blocks=100)
    path = tmp_path / "run" / "run_0.mcap"
    data, (start, end) = path.read_bytes(), chunk_places(path)[-1]
    at = {"in a chunk": (start + end) // 2, "between chunks": end, "before the header": 0}[where]
    broken = tmp_path / "broken_0.mcap"
    broken.write_bytes(data[:at] + b"\x55" * extra + data[at:])
    report = recover(broken, tmp_path / "out")
    got = messages_of(Bag(tmp_path / "out"))
    assert set(got) <= set(sent)
    assert report.lost == len(sent) - len(got)
    assert (report.lost > 0) == (where == "in a chunk")


def test_a_summary_with_a_record_that_overruns_hides_nothing(tmp_path):
    sent = write_bag(tmp_path / "run", blocks=50)
    data = bytearray((tmp_path / "run" / "run_0.mcap").read_bytes())
    start = int.from_bytes(data[-FOOTER + 9 : -FOOTER + 17], "little")
    data[start + 1 : start + 9] = (2**40).to_bytes(8, "little")
    data[-12:-8] = zlib.crc32(data[start:-12]).to_bytes(4, "little")
    (tmp_path / "broken_0.mcap").write_bytes(data)
    recover(tmp_path / "broken_0.mcap", tmp_path / "out")
    assert messages_of(Bag(tmp_path / "out")) == sent


def test_what_was_refused_of_one_file_is_not_taken_from_what_is_lost_of_the_next(tmp_path):
    """The first file's messages have a time that no bag of rosbag2 can hold; the second lacks a chunk."""
    schema = schema_of("std_msgs/msg/String")
    folder = tmp_path / "files"
    folder.mkdir()
    with open(folder / "run_0.mcap", "wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "another recorder")
        number = writer.register_schema(schema.type_name, "ros2msg", schema.text.encode())
        channel = writer.register_channel("/words", "cdr", number)
        for place in range(30):
            writer.add_message(channel, 2**63 + place, b"\0\1\0\0\1\0\0\0\0", START)
        writer.finish()
    sent = write_bag(tmp_path / "run", blocks=100)
    path = tmp_path / "run" / "run_0.mcap"
    data, (start, end) = bytearray(path.read_bytes()), chunk_places(path)[-1]
    data[(start + end) // 2] ^= 0xFF
    (folder / "run_1.mcap").write_bytes(data)
    report = recover(folder, tmp_path / "out")
    assert sum(report.refused.values()) == 30
    assert report.lost == len(sent) - report.messages > 0


@pytest.mark.parametrize("metadata", [True, False])
@pytest.mark.parametrize("lost", [0, 1, "last"])
def test_files_that_a_folder_lacks_are_named(tmp_path, lost, metadata):
    """Every other file is whole; the name of the last one is known to metadata.yaml alone."""
    write_bag(tmp_path / "run", max_file_size=100_000)
    count = len(list((tmp_path / "run").glob("*.mcap")))
    name = f"run_{count - 1 if lost == 'last' else lost}.mcap"
    (tmp_path / "run" / name).unlink()
    if not metadata:
        (tmp_path / "run" / "metadata.yaml").unlink()
    report = recover(tmp_path / "run", tmp_path / "out")
    known = metadata or lost != "last"
    assert report.missing_files == ([name] if known else [])
    assert not report.complete
    assert any((name if known else "no file says how the recording ended") in told for told in report.sentences())
    assert not verify(tmp_path / "run").sound
