import tracemalloc
from typing import NamedTuple

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter

from squeal_rig.errors import RecordingError
from squeal_rig.recording import Bag, BagWriter, QosProfile

T0 = 1_700_000_000_000_000_000


def write(directory, schema, messages, **options):
    """Write (topic, payload, log time) in the given order."""
    with BagWriter(directory, **options) as writer:
        for topic, payload, log_time in messages:
            handle = writer.add_topic(topic, schema.type_name, [QosProfile(depth=3)], schema)
            writer.write(handle, payload, log_time, log_time)
    return Bag(directory)


def test_topics_times_and_counts_are_told_without_reading_messages(tmp_path, string_schema):
    bag = write(
        tmp_path / "run",
        string_schema,
        [("/a", b"1", T0), ("/b", b"2", T0 + 5 * 10**8), ("/a", b"3", T0 + 10**9)],
    )
    assert (bag.message_count, bag.start_time, bag.end_time, bag.duration) == (3, T0, T0 + 10**9, 1.0)
    topic = bag.topics["/a"]
    assert (topic.type_name, topic.message_count, topic.qos) == (
        string_schema.type_name,
        2,
        (QosProfile(depth=3),),
    )
    assert (topic.type_hash, topic.schema, topic.serialization_format) == (
        string_schema.type_hash,
        string_schema,
        "cdr",
    )


@settings(max_examples=30)
@given(
    times=st.lists(st.integers(0, 30), min_size=1, max_size=60),
    per_file=st.integers(1, 60),
    window=st.tuples(st.integers(0, 31), st.integers(0, 31)),
    topics=st.sets(st.sampled_from(["/0", "/1", "/2"]), min_size=1),
)
def test_messages_come_in_log_time_order_and_equal_times_as_written(
    tmp_path_factory, string_schema, times, per_file, window, topics
):
    """Late messages, chunks that overlap in time and several files; the answer is a stable sort."""
    directory = tmp_path_factory.mktemp("bag") / "run"
    written = [(f"/{number % 3}", bytes([number]), time) for number, time in enumerate(times)]
    with BagWriter(directory, chunk_size=100) as writer:
        handles = {
            f"/{number}": writer.add_topic(f"/{number}", string_schema.type_name, schema=string_schema)
            for number in range(3)
        }
        for number, (topic, payload, time) in enumerate(written):
            if number and number % per_file == 0:
                writer.split()
            writer.write(handles[topic], payload, time, time)
    start, end = window
    expected = sorted(
        (item for item in written if start <= item[2] < end and item[0] in topics), key=lambda item: item[2]
    )
    read = Bag(directory).messages(topics, start, end)
    assert [(message.topic, message.data, message.log_time) for message in read] == expected


def test_a_bag_of_48_mb_is_read_in_less_than_8_mb(tmp_path, string_schema, noisy_payloads):
    payload = b"".join(noisy_payloads)[:48_000]
    bag = write(tmp_path / "run", string_schema, [("/a", payload, number) for number in range(1000)])
    tracemalloc.start()
    try:
        assert sum(len(message.data) for message in bag.messages()) == 48_000_000
        # One chunk of 1 MB is held packed, unpacked and as messages; 8 MB leaves room for a second one.
        assert tracemalloc.get_traced_memory()[1] < 8_000_000
    finally:
        tracemalloc.stop()


def test_a_topic_that_is_not_there_is_named(tmp_path, string_schema):
    bag = write(tmp_path / "run", string_schema, [("/a", b"1", T0)])
    with pytest.raises(RecordingError, match="has no topic /x; it has /a"):
        bag.messages(["/x"])


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("chunked", [True, False])
def test_files_of_the_mcap_library_are_read_chunked_or_not(tmp_path, string_schema, compression, chunked):
    path = tmp_path / "foreign.mcap"
    with open(path, "wb") as stream:
        writer = Writer(stream, chunk_size=2000, compression=compression, use_chunking=chunked)
        writer.start(profile="ros2")
        schema = writer.register_schema(string_schema.type_name, "ros2msg", string_schema.text.encode())
        channel = writer.register_channel("/a", "cdr", schema)
        writer.add_metadata("note", {"key": "value"})
        for number in range(300):
            writer.add_message(channel, 300 - number, bytes([number % 256]) * 50, number)
        writer.finish()
    bag = Bag(path)
    assert (bag.message_count, bag.start_time, bag.end_time) == (300, 1, 300)
    assert [message.log_time for message in bag.messages()] == list(range(1, 301))
    assert [(record.name, record.values) for record in bag.metadata_records] == [("note", {"key": "value"})]


@pytest.mark.parametrize("version", [8, 9])
def test_bags_of_rosbags_are_read(tmp_path, types, version):
    text = types.types["std_msgs/msg/String"](data="as written")
    data = bytes(types.serialize_cdr(text, "std_msgs/msg/String"))
    with RosbagsWriter(tmp_path / "run", version=version, storage_plugin=StoragePlugin.MCAP) as writer:
        writer.set_custom_data("preset", "yavuz_sen_2023")
        connection = writer.add_connection("/a", "std_msgs/msg/String", typestore=types)
        for number in range(5):
            writer.write(connection, T0 + number, data)
    bag = Bag(tmp_path / "run")
    assert bag.topics["/a"].type_name == "std_msgs/msg/String"
    assert [(message.log_time, message.data) for message in bag.messages()] == [(T0 + n, data) for n in range(5)]
    assert bag.custom_data == {"preset": "yavuz_sen_2023"}


def test_a_bag_without_metadata_yaml_is_read_with_its_provenance(tmp_path, string_schema):
    write(tmp_path / "run", string_schema, [("/a", b"1", T0)], custom_data={"seed": "7"})
    (tmp_path / "run" / "metadata.yaml").unlink()
    bag = Bag(tmp_path / "run")
    assert [message.data for message in bag.messages()] == [b"1"]
    assert bag.custom_data == {"seed": "7", "ending": "complete"}


@pytest.mark.parametrize("name", ["run", "run/run_0.mcap"])
def test_an_unclosed_recording_is_named_and_said_to_be_recoverable(tmp_path, string_schema, name):
    writer = BagWriter(tmp_path / "run")
    handle = writer.add_topic("/a", string_schema.type_name, schema=string_schema)
    writer.write(handle, b"1", T0, T0)
    writer.flush()
    with pytest.raises(RecordingError, match=r"run_0\.mcap was not closed: .* complete chunks can be recovered"):
        Bag(tmp_path / name)
    writer.close("complete")
    assert Bag(tmp_path / name).message_count == 1


def test_what_is_no_bag_is_said_to_be_none(tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "text.mcap").write_text("no bag at all, but long enough to hold a header")
    with pytest.raises(RecordingError, match="There is no bag at"):
        Bag(tmp_path / "nothing")
    with pytest.raises(RecordingError, match=r"holds neither metadata\.yaml nor an MCAP file"):
        Bag(tmp_path / "empty")
    with pytest.raises(RecordingError, match=r"text\.mcap is not an MCAP file"):
        Bag(tmp_path / "text.mcap")


@pytest.mark.parametrize("text", ["", "{", "a: 1", "rosbag2_bagfile_information: 5", "\0"])
def test_a_damaged_metadata_yaml_is_named(tmp_path, string_schema, text):
    write(tmp_path / "run", string_schema, [("/a", b"1", T0)])
    (tmp_path / "run" / "metadata.yaml").write_text(text)
    with pytest.raises(RecordingError, match=r"metadata\.yaml is no metadata of a bag"):
        Bag(tmp_path / "run")


def test_a_missing_file_is_named(tmp_path, string_schema):
    write(tmp_path / "run", string_schema, [("/a", b"1", T0)])
    (tmp_path / "run" / "run_0.mcap").unlink()
    with pytest.raises(RecordingError, match=r"Cannot read .*run_0\.mcap: No such file"):
        Bag(tmp_path / "run")


class SmallBag(NamedTuple):
    """The bytes of a file and its messages."""

    whole: bytes
    messages: list

    def __repr__(self):
        return f"SmallBag of {len(self.whole)} bytes"  # a failing example prints this, not the bytes


@pytest.fixture(scope="module")
def small_bag(tmp_path_factory, string_schema):
    """The bytes of a bag of 60 messages in several chunks, and its messages."""
    directory = tmp_path_factory.mktemp("small") / "run"
    bag = write(
        directory,
        string_schema,
        [("/a", bytes([number]) * 40, T0 + number) for number in range(60)],
        chunk_size=900,
    )
    return SmallBag((directory / "run_0.mcap").read_bytes(), list(bag.messages()))


def damaged_copy(data, whole):
    """The file cut off somewhere, or with one bit flipped somewhere."""
    if data.draw(st.booleans(), label="cut"):
        return whole[: data.draw(st.integers(0, len(whole) - 1), label="at")]
    at = data.draw(st.integers(0, len(whole) * 8 - 1), label="bit")
    return bytes([*whole[: at // 8], whole[at // 8] ^ 1 << at % 8, *whole[at // 8 + 1 :]])


@settings(max_examples=300)
@given(data=st.data(), checked=st.booleans())
def test_a_damaged_file_is_refused_with_a_sentence_and_never_read_wrongly(tmp_path_factory, small_bag, data, checked):
    """Cuts and bit flips anywhere, also in a file whose summary has no checksum (it may be left out)."""
    whole = small_bag.whole if checked else small_bag.whole[:-12] + bytes(4) + small_bag.whole[-8:]
    path = tmp_path_factory.mktemp("damaged") / "bag.mcap"
    path.write_bytes(damaged_copy(data, whole))
    read, refused = [], None
    try:
        for message in Bag(path).messages():
            read.append((message.log_time, message.data))
    except RecordingError as error:
        refused = error
    written = [(message.log_time, message.data) for message in small_bag.messages]
    assert set(read) <= set(written)
    assert "bag.mcap" in str(refused) if refused else read == written or not checked
