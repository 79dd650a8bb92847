"""What `verify` tells: a sound bag is sound, and each kind of fault is named."""

import shutil
import zlib

import pytest
from bag_making import START, block_cdr, write_bag
from mcap.records import (
    Attachment,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Message,
    Schema,
    Statistics,
)
from mcap.stream_reader import StreamReader
from mcap.writer import Writer

from squeal_rig.errors import RecordingError
from squeal_rig.recording import Bag, BagWriter
from squeal_rig.recording.records import MAGIC, record_bytes
from squeal_rig.recording.verify import verify
from tests.messages import schema_of, string_cdr


def errors(directory):
    return [finding.sentence for finding in verify(directory).findings if finding.level == "error"]


@pytest.fixture
def bag(tmp_path):
    write_bag(tmp_path / "run", blocks=50)
    return tmp_path / "run"


def test_a_sound_bag_has_no_findings(bag):
    verdict = verify(bag)
    assert verdict.findings == []
    assert verdict.messages == 101
    assert verdict.samples["/daq/samples"].samples == 50 * 64


def test_lost_samples_are_counted_by_seq(tmp_path):
    write_bag(tmp_path / "run", blocks=50, skip=(10, 11, 30))
    count = verify(tmp_path / "run").samples["/daq/samples"]
    assert (count.gaps, count.lost) == (2, 3 * 64)
    assert "192 samples are missing in 2 gaps by seq" in errors(tmp_path / "run")


def test_seq_wraps_at_32_bits_without_a_gap(tmp_path):
    last = 2**32 // 64 - 1
    cloud = schema_of("sensor_msgs/msg/PointCloud2")
    with BagWriter(tmp_path / "run") as writer:
        handle = writer.add_topic("/daq/samples", cloud.type_name, schema=cloud)
        for number in (last, 0):
            time = START + (number == 0)
            data = bytearray(block_cdr(0, time))
            first = len(data) - 1 - 64 * 24
            for row in range(64):
                data[first + row * 24 + 16 : first + row * 24 + 20] = (number * 64 + row).to_bytes(4, "little")
            writer.write(handle, bytes(data), time, time)
    assert errors(tmp_path / "run") == []


def test_an_unclosed_file_is_named(tmp_path):
    write_bag(tmp_path / "run", ending=None)
    assert any("was not closed" in sentence for sentence in errors(tmp_path / "run"))


def test_log_time_that_goes_back_is_named(tmp_path):
    cloud = schema_of("sensor_msgs/msg/PointCloud2")
    with BagWriter(tmp_path / "run") as writer:
        handle = writer.add_topic("/daq/samples", cloud.type_name, schema=cloud)
        for number, time in enumerate((START, START + 3_000_000_000, START + 5)):
            writer.write(handle, block_cdr(number, time), time, time)
    assert any(sentence.startswith("log time goes back 1 times, by 3.0") for sentence in errors(tmp_path / "run"))


def test_messages_of_several_publishers_a_little_out_of_order_are_no_error(tmp_path):
    text = schema_of("std_msgs/msg/String")
    with BagWriter(tmp_path / "run") as writer:
        handle = writer.add_topic("/words", text.type_name, schema=text)
        for time in (START + 1_000_000, START):
            writer.write(handle, string_cdr("word"), time, time)
    verdict = verify(tmp_path / "run")
    assert verdict.sound
    assert any("log time goes back" in finding.sentence for finding in verdict.findings)


def test_missing_messages_are_named_by_their_numbers(tmp_path):
    cloud = schema_of("sensor_msgs/msg/PointCloud2")
    with BagWriter(tmp_path / "run") as writer:
        handle = writer.add_topic("/daq/samples", cloud.type_name, schema=cloud)
        for block, number in enumerate((0, 1, 5)):
            writer.write(handle, block_cdr(block, START + block), START + block, START, number)
    assert "3 messages are missing by their numbers" in errors(tmp_path / "run")


def test_metadata_that_disagrees_is_named(bag):
    path = bag / "metadata.yaml"
    path.write_text(path.read_text().replace("message_count: 50", "message_count: 51"))
    assert any("says 51 messages of /daq/samples; there are 50" in sentence for sentence in errors(bag))


def test_a_missing_file_of_a_split_bag_is_an_error(tmp_path):
    write_bag(tmp_path / "run", max_file_size=100_000)
    (tmp_path / "run" / "run_1.mcap").unlink()
    assert any("run_1.mcap" in sentence for sentence in errors(tmp_path / "run"))


@pytest.mark.parametrize("lost", [0, 1])
def test_a_missing_file_is_seen_by_the_numbers_of_the_others_where_metadata_yaml_is_gone_too(tmp_path, lost):
    write_bag(tmp_path / "run", max_file_size=100_000)
    (tmp_path / "run" / f"run_{lost}.mcap").unlink()
    (tmp_path / "run" / "metadata.yaml").unlink()
    verdict = verify(tmp_path / "run")
    assert not verdict.sound
    assert [finding.where for finding in verdict.findings if "not there" in finding.sentence] == [f"run_{lost}.mcap"]


def test_messages_that_do_not_fit_their_definition_are_named(tmp_path):
    text = schema_of("std_msgs/msg/String")
    with BagWriter(tmp_path / "run") as writer:
        handle = writer.add_topic("/words", text.type_name, schema=text)
        writer.write(handle, b"\0\1\0\0\xff\xff", START, START)
    assert any("do not fit their definition" in sentence for sentence in errors(tmp_path / "run"))


def test_a_metadata_record_changed_by_hand_is_named(bag):
    """The seal of a record holds even where the file's own checksums were made to fit again."""
    from squeal_rig.recording.sealed import is_intact, sealed

    record = sealed({"node": "/rig", "values": "preload: 50.0"})
    assert is_intact(record)
    assert is_intact({**record, "values": "preload: 60.0"}) is False
    assert is_intact({"node": "/rig"}) is None


def test_what_is_no_bag_is_refused_in_a_sentence(tmp_path):
    with pytest.raises(RecordingError, match="no bag"):
        verify(tmp_path / "nothing")


def test_a_bag_without_metadata_yaml_is_sound_with_a_warning(bag):
    (bag / "metadata.yaml").unlink()
    verdict = verify(bag)
    assert verdict.sound
    assert any("metadata.yaml" in finding.where for finding in verdict.findings)
    shutil.rmtree(bag)


def rewritten_index(path, change):
    """Give a file another chunk index, made of the records it has, with checksums that fit."""
    data = path.read_bytes()
    start = int.from_bytes(data[-28:-20], "little")
    with open(path, "rb") as stream:
        entries = [r for r in StreamReader(stream, emit_chunks=True).records if isinstance(r, ChunkIndex)]
    summary = data[start:-37]
    first = summary.index(record_bytes(entries[0]))
    size = sum(len(record_bytes(entry)) for entry in entries)
    change(entries)
    summary = summary[:first] + b"".join(map(record_bytes, entries)) + summary[first + size :]
    footer = data[-37:-28] + start.to_bytes(8, "little") + bytes(8)
    crc = zlib.crc32(summary + footer)
    path.write_bytes(data[:start] + summary + footer + crc.to_bytes(4, "little") + data[-8:])


def test_a_chunk_listed_twice_is_an_error_and_is_not_read_twice(bag):
    path = bag / "run_0.mcap"
    rewritten_index(path, lambda entries: entries.append(entries[1]))
    assert any("lists the chunk at byte" in sentence and "twice" in sentence for sentence in errors(bag))
    with pytest.raises(RecordingError, match="lists the chunk at byte"):
        Bag(bag)


@pytest.mark.parametrize("place", [0, -1])
def test_a_chunk_that_the_index_lacks_is_an_error(bag, place):
    """Readers pass over it."""
    rewritten_index(bag / "run_0.mcap", lambda entries: entries.pop(place))
    assert any("is not in the index of the file" in sentence for sentence in errors(bag))


def test_a_channel_that_is_missing_from_the_index_is_an_error(bag):
    """Readers take a chunk for one without messages of the topic then."""
    rewritten_index(bag / "run_0.mcap", lambda entries: entries[1].message_index_offsets.popitem())
    assert any("message indexes elsewhere" in sentence for sentence in errors(bag))


@pytest.mark.parametrize(
    ("key", "words"),
    [
        ("lost_messages", "650 messages were lost on the way to the recorder"),
        ("messages_lost_at_end", "650 messages were lost at the end"),
        ("recovered_lost_messages", "650 messages were missing already when it was recovered"),
        ("recovered_uncounted_files", "650 of its files had lost the count of what they should hold"),
    ],
)
def test_what_a_bag_says_of_its_losses_is_told(tmp_path, key, words):
    with BagWriter(tmp_path / "run", custom_data={key: "650"}):
        pass
    (finding,) = verify(tmp_path / "run").findings
    assert words in finding.sentence


@pytest.mark.parametrize("content", [b"", b"no bag at all" * 100, bytes(5000)])
def test_files_that_are_no_mcap_are_no_bag(tmp_path, content):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "run_0.mcap").write_bytes(content)
    for path in (tmp_path / "run", tmp_path / "run" / "run_0.mcap"):
        with pytest.raises(RecordingError, match="is no bag"):
            verify(path)


def loose_file(path, records, summary):
    """A file without chunks: records of the data section, records of the summary, checksums left out."""
    head = MAGIC + record_bytes(Header(profile="ros2", library="test"))
    data = head + b"".join(map(record_bytes, records)) + record_bytes(DataEnd(0))
    told = b"".join(map(record_bytes, summary))
    footer = record_bytes(Footer(summary_start=len(data), summary_offset_start=0, summary_crc=0))
    path.write_bytes(data + told + footer + MAGIC)


SCHEMA = Schema(id=1, name="std_msgs/msg/String", encoding="ros2msg", data=b"string data")
CHANNEL = Channel(id=1, topic="/words", message_encoding="cdr", metadata={}, schema_id=1)
MESSAGE = Message(channel_id=1, log_time=5, publish_time=5, sequence=0, data=string_cdr("a"))
COUNTS = Statistics(
    attachment_count=0,
    channel_count=1,
    channel_message_counts={1: 1},
    chunk_count=0,
    message_count=1,
    message_end_time=5,
    message_start_time=5,
    metadata_count=0,
    schema_count=1,
)


@pytest.mark.parametrize(
    ("records", "summary", "words"),
    [
        ([SCHEMA, CHANNEL, MESSAGE], [SCHEMA, CHANNEL, COUNTS], None),
        ([SCHEMA, MESSAGE, CHANNEL], [SCHEMA, CHANNEL, COUNTS], "before the channel's definition"),
        ([SCHEMA, CHANNEL, MESSAGE], [SCHEMA, COUNTS], "the summary lacks channel 1"),
        ([SCHEMA, CHANNEL, MESSAGE], [CHANNEL, COUNTS], "the summary lacks schema 1"),
        ([SCHEMA, CHANNEL, MESSAGE], [SCHEMA, CHANNEL, COUNTS, DataEnd(0)], "opcode 15, which has no place there"),
    ],
    ids=["sound", "late channel", "no channel", "no schema", "foreign record"],
)
def test_what_readers_of_others_need_in_a_file_is_looked_for(tmp_path, records, summary, words):
    path = tmp_path / "loose_0.mcap"
    loose_file(path, records, summary)
    found = errors(path)
    assert found == [] if words is None else any(words in sentence for sentence in found), found


def test_an_attachment_that_cannot_be_read_is_an_error(tmp_path):
    path = tmp_path / "loose_0.mcap"
    note = Attachment(create_time=1, log_time=1, name="note", media_type="text", data=b"x")
    loose_file(path, [SCHEMA, CHANNEL, MESSAGE, note], [SCHEMA, CHANNEL, COUNTS])
    path.write_bytes(path.read_bytes().replace(b"note", b"n\xffte"))
    assert any("an attachment record cannot be read" in sentence for sentence in errors(path))


def test_a_record_that_has_no_place_among_the_data_is_an_error(tmp_path):
    """An attachment of which one bit was flipped, in a file without a checksum: readers from front to back stumble."""
    path = tmp_path / "odd_0.mcap"
    with open(path, "wb") as stream:
        writer = Writer(stream, enable_crcs=False)
        writer.start("ros2", "another recorder")
        writer.add_attachment(START, START, "note.txt", "text/plain", b"a note")
        writer.finish()
    assert verify(path).sound
    data = bytearray(path.read_bytes())
    data[data.index(b"note.txt") - 4 - 16 - 9] ^= 9 ^ 10
    path.write_bytes(data)
    assert any("a record of opcode 10 has no place among the data" in told for told in errors(path))


def test_what_lies_between_the_data_and_the_summary_is_an_error(tmp_path):
    """A footer there: the summary is where the last one says, and who reads from front to back ends at the first."""
    path = tmp_path / "loose_0.mcap"
    loose_file(path, [SCHEMA, CHANNEL, MESSAGE], [SCHEMA, CHANNEL, COUNTS])
    assert verify(path).sound
    data = path.read_bytes()
    start = int.from_bytes(data[-28:-20], "little")
    footer = bytearray(data[-37:])
    footer[9:17] = (start + 29).to_bytes(8, "little")
    path.write_bytes(data[:start] + bytes(footer[:29]) + data[start:-37] + bytes(footer))
    assert any("is of no section of the file" in told for told in errors(path)), errors(path)
