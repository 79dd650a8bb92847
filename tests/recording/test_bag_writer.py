import io
import resource
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, ChunkIndex, Message, MessageIndex, Schema, Statistics
from mcap.stream_reader import StreamReader, breakup_chunk
from rosbags.rosbag2 import Reader
from ruamel.yaml import YAML

from squeal_rig.errors import DiskError, RecordingError
from squeal_rig.recording import Bag, BagWriter, MessageSchema, QosProfile
from squeal_rig.recording.bag_metadata import read_metadata
from squeal_rig.recording.recover import recover
from squeal_rig.recording.writer import new_directory

T0 = 1_700_000_000_000_000_000
LATCHED = QosProfile(depth=1, durability="transient_local")


def write_bag(directory, cloud_schema, string_schema, payloads, **options):
    """Write the payloads in turn on two topics, 10 ms apart, and declare a third topic that stays empty."""
    writer = BagWriter(directory, custom_data={"seed": "7", "parameters": "a: 1\nb: [x, y]\n"}, **options)
    clouds = writer.add_topic("/daq/samples", cloud_schema.type_name, [QosProfile()], cloud_schema)
    texts = writer.add_topic("/rig/description", string_schema.type_name, [LATCHED, LATCHED], string_schema)
    writer.add_topic("/unused", string_schema.type_name, schema=string_schema)
    for number, payload in enumerate(payloads):
        writer.write((clouds, texts)[number % 2], payload, T0 + number * 10**7, T0 + number * 10**7 - 1000)
    writer.close("complete")
    return directory


def expected_messages(payloads):
    return [
        (("/daq/samples", "/rig/description")[number % 2], T0 + number * 10**7, payload)
        for number, payload in enumerate(payloads)
    ]


def records_of(path):
    """All records outside chunks, every CRC of the file checked on the way."""
    with open(path, "rb") as stream:
        return list(StreamReader(stream, emit_chunks=True, validate_crcs=True).records)


@pytest.fixture
def bag(tmp_path, cloud_schema, string_schema, noisy_payloads):
    return write_bag(tmp_path / "run", cloud_schema, string_schema, noisy_payloads, chunk_size=100_000)


def test_rosbags_reads_every_message_as_it_was_written(bag, noisy_payloads):
    with Reader(bag) as reader:
        read = [(connection.topic, time, bytes(data)) for connection, time, data in reader.messages()]
        assert reader.message_count == len(noisy_payloads)
        assert reader.ros_distro == "jazzy"
    assert read == expected_messages(noisy_payloads)


def test_rosbags_decodes_by_the_definitions_in_the_bag(tmp_path, types, string_schema):
    text = types.types["std_msgs/msg/String"](data="preload 300 N")
    with BagWriter(tmp_path / "run") as writer:
        handle = writer.add_topic("/rig/description", string_schema.type_name, schema=string_schema)
        writer.write(handle, bytes(types.serialize_cdr(text, "std_msgs/msg/String")), T0, T0)
    with Reader(tmp_path / "run") as reader:
        ((connection, _, data),) = reader.messages()
        assert types.deserialize_cdr(data, connection.msgtype) == text
        assert connection.msgdef.data == string_schema.text
        assert connection.digest == string_schema.type_hash


def test_mcap_reads_every_message_with_both_times_and_a_count_per_topic(bag, noisy_payloads):
    with open(bag / "run_0.mcap", "rb") as stream:
        read = list(make_reader(stream, validate_crcs=True).iter_messages())
    assert [(channel.topic, message.log_time, message.data) for _, channel, message in read] == expected_messages(
        noisy_payloads
    )
    assert all(message.publish_time == message.log_time - 1000 for _, _, message in read)
    assert [message.sequence for _, _, message in read] == [number // 2 for number in range(len(read))]


def test_the_file_has_rosbag2s_profile_and_channel_metadata(bag, cloud_schema):
    with open(bag / "run_0.mcap", "rb") as stream:
        reader = make_reader(stream)
        assert reader.get_header().profile == "ros2"
        assert reader.get_header().library.startswith("squeal_rig ")
        summary = reader.get_summary()
    channel = next(channel for channel in summary.channels.values() if channel.topic == "/daq/samples")
    assert channel.message_encoding == "cdr"
    assert channel.metadata["topic_type_hash"] == cloud_schema.type_hash
    assert channel.metadata["offered_qos_profiles"].startswith("- history: keep_last\n  depth: 10\n")
    schema = summary.schemas[channel.schema_id]
    assert (schema.name, schema.encoding, schema.data) == (
        cloud_schema.type_name,
        "ros2msg",
        cloud_schema.text.encode(),
    )


def test_every_chunk_is_compressed_checked_and_defines_what_it_uses(bag):
    chunks = [record for record in records_of(bag / "run_0.mcap") if isinstance(record, Chunk)]
    assert len(chunks) > 10
    for chunk in chunks:
        assert (chunk.compression, chunk.uncompressed_crc != 0) == ("zstd", True)
        schemas, channels = set(), {}
        for record in breakup_chunk(chunk, validate_crc=True):
            if isinstance(record, Schema):
                schemas.add(record.id)
            elif isinstance(record, Channel):
                assert record.schema_id in schemas
                channels[record.id] = record.topic
            else:
                assert record.channel_id in channels
        assert set(channels.values()) == {"/daq/samples", "/rig/description"}


def test_indexes_and_statistics_count_what_is_there(bag, noisy_payloads):
    records = records_of(bag / "run_0.mcap")
    by_kind = Counter(type(record) for record in records)
    statistics = next(record for record in records if isinstance(record, Statistics))
    assert statistics.message_count == len(noisy_payloads)
    assert statistics.chunk_count == by_kind[Chunk] == by_kind[ChunkIndex]
    assert statistics.channel_message_counts == {1: 100, 2: 100, 3: 0}
    assert (statistics.schema_count, statistics.channel_count) == (2, 3)
    assert statistics.message_start_time == T0
    assert statistics.message_end_time == T0 + (len(noisy_payloads) - 1) * 10**7
    assert sum(len(record.records) for record in records if isinstance(record, MessageIndex)) == 200


def test_each_message_index_points_at_its_message(bag):
    data = (bag / "run_0.mcap").read_bytes()
    for index in (record for record in records_of(bag / "run_0.mcap") if isinstance(record, ChunkIndex)):
        start, end = index.chunk_start_offset, index.chunk_start_offset + index.chunk_length
        chunk = next(StreamReader(io.BytesIO(data[start:end]), skip_magic=True, emit_chunks=True).records)
        raw = b"".join(_uncompressed(chunk))
        for channel_id, offset in index.message_index_offsets.items():
            found = next(StreamReader(io.BytesIO(data[offset:]), skip_magic=True).records)
            assert (type(found), found.channel_id) == (MessageIndex, channel_id)
            for log_time, at in found.records:
                message = next(StreamReader(io.BytesIO(raw[at:]), skip_magic=True).records)
                assert (type(message), message.channel_id, message.log_time) == (
                    Message,
                    channel_id,
                    log_time,
                )


def _uncompressed(chunk):
    from mcap.stream_reader import get_chunk_data_stream

    stream, size = get_chunk_data_stream(chunk)
    yield stream.read(size)


def test_metadata_yaml_has_the_keys_of_version_9_in_rosbag2s_order(bag, cloud_schema):
    loaded = YAML(typ="safe").load(bag / "metadata.yaml")["rosbag2_bagfile_information"]
    # convert<BagMetadata>::encode in rosbag2_storage/yaml.hpp, branch jazzy
    assert (
        list(loaded)
        == (
            "version storage_identifier duration starting_time message_count topics_with_message_count"
            " compression_format compression_mode relative_file_paths files custom_data ros_distro"
        ).split()
    )
    assert (loaded["version"], loaded["storage_identifier"], loaded["ros_distro"]) == (9, "mcap", "jazzy")
    assert loaded["message_count"] == 200
    assert loaded["starting_time"] == {"nanoseconds_since_epoch": T0}
    assert loaded["duration"] == {"nanoseconds": 199 * 10**7}
    topic = loaded["topics_with_message_count"][0]
    assert (topic["message_count"], list(topic["topic_metadata"])) == (
        100,
        ["name", "type", "serialization_format", "offered_qos_profiles", "type_description_hash"],
    )
    assert topic["topic_metadata"]["type_description_hash"] == cloud_schema.type_hash
    assert loaded["relative_file_paths"] == ["run_0.mcap"]
    assert loaded["files"] == [
        {
            "path": "run_0.mcap",
            "starting_time": {"nanoseconds_since_epoch": T0},
            "duration": {"nanoseconds": 199 * 10**7},
            "message_count": 200,
        }
    ]
    assert loaded["custom_data"] == {"seed": "7", "parameters": "a: 1\nb: [x, y]\n", "ending": "complete"}


def test_a_bag_without_messages_is_valid(tmp_path, string_schema):
    with BagWriter(tmp_path / "run") as writer:
        writer.add_topic("/unused", string_schema.type_name, schema=string_schema)
    with Reader(tmp_path / "run") as reader:
        assert (reader.message_count, [item.topic for item in reader.connections]) == (0, ["/unused"])
    records_of(tmp_path / "run" / "run_0.mcap")
    assert Bag(tmp_path / "run").message_count == 0


@pytest.mark.parametrize("options", [{"max_file_size": 300_000}, {"max_file_duration": 0.5}])
def test_a_split_bag_reads_as_one_and_each_file_alone(tmp_path, cloud_schema, string_schema, noisy_payloads, options):
    bag = write_bag(tmp_path / "run", cloud_schema, string_schema, noisy_payloads, **options)
    files = sorted(bag.glob("*.mcap"), key=lambda path: int(path.stem.split("_")[-1]))
    assert len(files) >= 4
    with Reader(bag) as reader:
        read = [(connection.topic, time, bytes(data)) for connection, time, data in reader.messages()]
    assert read == expected_messages(noisy_payloads)
    alone = [message for path in files for message in Bag(path).messages()]
    assert [(message.topic, message.log_time, message.data) for message in alone] == read
    for path in files:
        assert set(Bag(path).topics) == {"/daq/samples", "/rig/description", "/unused"}
        assert Bag(path).custom_data["seed"] == "7"
        if "max_file_size" in options:
            # The first chunk that reaches the limit closes the file; a chunk holds no more than the limit.
            assert path.stat().st_size < 2 * 300_000 + 20_000
        else:
            assert Bag(path).duration < 0.5
    listed = YAML(typ="safe").load(bag / "metadata.yaml")["rosbag2_bagfile_information"]
    assert listed["relative_file_paths"] == [path.name for path in files]
    assert [file["message_count"] for file in listed["files"]] == [Bag(path).message_count for path in files]


def test_uncompressed_bags_are_read_too(tmp_path, cloud_schema, string_schema, noisy_payloads):
    bag = write_bag(tmp_path / "run", cloud_schema, string_schema, noisy_payloads, compression="none")
    with Reader(bag) as reader:
        assert [bytes(data) for _, _, data in reader.messages()] == noisy_payloads


def test_metadata_records_are_kept_in_order(tmp_path):
    with BagWriter(tmp_path / "run") as writer:
        for number in range(3):
            writer.add_metadata("parameter", {"preload": str(number)})
    records = Bag(tmp_path / "run").metadata_records
    assert [(record.name, record.values) for record in records] == [
        ("parameter", {"preload": str(number)}) for number in range(3)
    ]


def test_an_exception_inside_the_recording_is_told_as_its_ending(tmp_path):
    with pytest.raises(ZeroDivisionError), BagWriter(tmp_path / "run"):
        raise ZeroDivisionError("division by zero")
    assert Bag(tmp_path / "run").ending == "aborted: ZeroDivisionError: division by zero"


def test_a_message_is_on_disk_after_flush_and_by_itself_after_the_interval(tmp_path, string_schema):
    writer = BagWriter(tmp_path / "run", flush_interval=1e-6)
    handle = writer.add_topic("/text", string_schema.type_name, schema=string_schema)
    sizes = [writer.bytes_written]
    for _ in range(3):  # each is later than the interval after the one before
        writer.write(handle, b"\0\1\0\0\1\0\0\0\0", T0, T0)
        writer.flush()
        sizes.append((tmp_path / "run" / "run_0.mcap").stat().st_size)
        assert sizes[-1] == writer.bytes_written > sizes[-2]
    writer.close("complete")


def test_a_type_without_definition_is_recorded_with_an_empty_one(tmp_path):
    with BagWriter(tmp_path / "run") as writer:
        schema = MessageSchema("far_away/msg/Thing")
        writer.write(writer.add_topic("/thing", schema.type_name, schema=schema), b"\0\1\0\0", T0, T0)
    with Reader(tmp_path / "run") as reader:
        assert [connection.msgtype for connection in reader.connections] == ["far_away/msg/Thing"]


def test_a_topic_declared_twice_is_one_topic_and_a_second_type_is_refused(tmp_path, string_schema, cloud_schema):
    with BagWriter(tmp_path / "run") as writer:
        first = writer.add_topic("/text", string_schema.type_name, schema=string_schema)
        assert writer.add_topic("/text", "std_msgs/String") is first
        with pytest.raises(RecordingError, match="/text has type std_msgs/msg/String; it cannot be"):
            writer.add_topic("/text", cloud_schema.type_name, schema=cloud_schema)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"chunk_size": 0}, "chunk_size is 0; it must be above 0"),
        ({"flush_interval": float("nan")}, "flush_interval is nan; it must be above 0"),
        ({"max_file_size": -1}, "max_file_size is -1; it must be above 0"),
        ({"max_file_duration": 0.0}, "max_file_duration is 0.0; it must be above 0"),
        ({"compression": "rar"}, "Compression is 'rar'; it must be one of zstd, none"),
        ({"reserve_bytes": -1}, "reserve_bytes is -1; it must not be below 0"),
    ],
)
def test_bad_settings_are_refused_with_a_sentence_and_leave_nothing(tmp_path, options, sentence):
    with pytest.raises(RecordingError, match=sentence):
        BagWriter(tmp_path / "run", **options)
    assert not (tmp_path / "run").exists()


def test_a_bag_never_overwrites_anything(tmp_path):
    BagWriter(tmp_path / "run").close("complete")
    with pytest.raises(RecordingError, match="exists already and is not empty"):
        BagWriter(tmp_path / "run")


@pytest.mark.parametrize("time", [-1, 2**63])
def test_times_outside_rosbag2s_range_are_refused(tmp_path, string_schema, time):
    with BagWriter(tmp_path / "run") as writer:
        handle = writer.add_topic("/text", string_schema.type_name, schema=string_schema)
        with pytest.raises(RecordingError, match="both must lie in"):
            writer.write(handle, b"", time, 0)
    assert Bag(tmp_path / "run").message_count == 0


def test_a_closed_bag_takes_nothing_more_and_closing_again_is_harmless(tmp_path, string_schema):
    writer = BagWriter(tmp_path / "run")
    handle = writer.add_topic("/text", string_schema.type_name, schema=string_schema)
    writer.close("complete")
    writer.close("again")
    writer.flush()
    with pytest.raises(RecordingError, match="is closed"):
        writer.write(handle, b"", T0, T0)
    assert Bag(tmp_path / "run").ending == "complete"


def test_no_bag_is_started_where_the_reserve_does_not_fit_on_the_disk(tmp_path):
    with pytest.raises(RecordingError, match=r"The disk of .* is full: .* bytes are free"):
        BagWriter(tmp_path / "run", reserve_bytes=2**62)
    assert list((tmp_path / "run").iterdir()) == []


def what_it_says(script, folder):
    """Lines of a script that bounds the size of its own files, in a process of its own."""
    command = [sys.executable, "-c", script, str(folder)]
    run = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert run.returncode == 0, run.stderr
    return run.stdout.splitlines()


FULL_DISK = """
import resource, sys
from squeal_rig.errors import DiskError, RecordingError
from squeal_rig.recording import Bag, BagWriter, MessageSchema
writer = BagWriter(sys.argv[1], chunk_size=20_000, compression="none")
handle = writer.add_topic("/raw", "far_away/msg/Thing", schema=MessageSchema("far_away/msg/Thing"))
_, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
resource.setrlimit(resource.RLIMIT_FSIZE, (250_000, hard))
try:
    for number in range(1000):
        writer.write(handle, number.to_bytes(1000, "little"), number, number)
except RecordingError as error:
    print(error)
resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))
writer.close("disk full")
print(number)
"""


@pytest.mark.skipif(not hasattr(resource, "RLIMIT_FSIZE"), reason="needs a limit on file sizes")
def test_a_refused_write_is_told_and_the_bag_still_closes_valid(tmp_path):
    """The limit on file sizes stands for a full disk: the operating system writes a part, then refuses."""
    sentence, last = what_it_says(FULL_DISK, tmp_path / "run")
    assert sentence.startswith("Cannot write to ")
    records_of(tmp_path / "run" / "run_0.mcap")
    bag = Bag(tmp_path / "run")
    assert bag.ending == "disk full"
    assert [message.data for message in bag.messages()] == [
        number.to_bytes(1000, "little") for number in range(int(last) + 1)
    ]


LAST_CHUNK = """
import resource, sys
from squeal_rig.errors import DiskError, RecordingError
from squeal_rig.recording import BagWriter, MessageSchema
writer = BagWriter(sys.argv[1], compression="none", flush_interval=3600.0)
handle = writer.add_topic("/raw", "far_away/msg/Thing", schema=MessageSchema("far_away/msg/Thing"))
for number in range(100):
    writer.write(handle, bytes(1000), number, number)
soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, hard))
try:
    writer.close("complete")
except RecordingError as error:
    print(error)
"""


@pytest.mark.skipif(not hasattr(resource, "RLIMIT_FSIZE"), reason="needs a limit on file sizes")
def test_a_last_chunk_that_does_not_fit_is_told_by_the_ending(tmp_path):
    (sentence,) = what_it_says(LAST_CHUNK, tmp_path / "run")
    assert sentence.startswith("Cannot write to ")
    bag = Bag(tmp_path / "run")
    assert bag.ending.startswith("stopped: the last 100 messages are lost: Cannot write to ")
    assert (bag.message_count, bag.custom_data["messages_lost_at_end"]) == (0, "100")


UNFINISHED = """
import resource, sys
from squeal_rig.errors import DiskError
from squeal_rig.recording.session import RecordingSession
from squeal_rig.recording.settings import RecorderSettings
from tests.messages import string_cdr
session = RecordingSession(RecorderSettings(directory=sys.argv[1], compression="none"))
session.start(1)
topic = session.add_topic("/text", "std_msgs/msg/String", [])
for number in range(100):
    session.write(topic, string_cdr(f"{number:03d}" * 1000), number, number)
session.flush()
_, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
resource.setrlimit(resource.RLIMIT_FSIZE, (session.bytes_written + 50, hard))
try:
    session.split()
except DiskError as error:
    print(error)
resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))
session.stop("stopped: the disk", {"lost_messages": "0"})
"""


@pytest.mark.skipif(not hasattr(resource, "RLIMIT_FSIZE"), reason="needs a limit on file sizes")
def test_a_file_that_cannot_be_finished_ends_the_bag_in_the_next_one(tmp_path):
    (sentence,) = what_it_says(UNFINISHED, tmp_path / "run")
    assert sentence.startswith("Cannot write to ")
    told = read_metadata(tmp_path / "run")
    assert [(file.path, file.message_count) for file in told.files] == [("run_0.mcap", 100), ("run_1.mcap", 0)]
    assert (told.custom_data["ending"], told.custom_data["lost_messages"]) == ("stopped: the disk", "0")
    with pytest.raises(RecordingError, match=r"run_0.mcap was not closed: .* can be recovered"):
        Bag(tmp_path / "run")
    assert recover(tmp_path / "run", tmp_path / "out").messages == 100


HALF_BEGUN = """
import resource, sys
from squeal_rig.errors import DiskError
from squeal_rig.recording.session import RecordingSession
from squeal_rig.recording.settings import RecorderSettings
from tests.messages import string_cdr
session = RecordingSession(RecorderSettings(directory=sys.argv[1]))
session.start(1)
begun = session.bytes_written
topic = session.add_topic("/text", "std_msgs/msg/String", [])
session.parameters_at_start("/rig", {"text": "x" * 2000}, 1, {})
session.stop("complete")
_, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
resource.setrlimit(resource.RLIMIT_FSIZE, (begun + 500, hard))
try:
    session.start(2)
except DiskError as error:
    print(error)
resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))
print(session.state)
print(session.fault)
session.write(topic, string_cdr("between"), 3, 3)
session.start(4)
session.write(topic, string_cdr("after"), 5, 5)
session.stop("complete")
"""


@pytest.mark.skipif(not hasattr(resource, "RLIMIT_FSIZE"), reason="needs a limit on file sizes")
def test_a_bag_that_cannot_be_begun_is_given_up_and_the_next_one_is_whole(tmp_path):
    sentence, state, fault = what_it_says(HALF_BEGUN, tmp_path / "run")
    assert sentence.startswith("Cannot write to ")
    assert (state, fault) == ("not recording", sentence)
    assert [message.log_time for message in Bag(tmp_path / "run_3").messages()] == [5]


def test_a_file_of_a_split_bag_describes_itself(tmp_path):
    with BagWriter(tmp_path / "run", max_file_duration=1.0) as writer:
        handle = writer.add_topic("/raw", "far_away/msg/Thing", schema=MessageSchema("far_away/msg/Thing"))
        for number in range(6):
            writer.write(handle, bytes(100), number * 10**9, number * 10**9)
    for number in range(6):
        with open(tmp_path / "run" / f"run_{number}.mcap", "rb") as stream:
            records = list(make_reader(stream).iter_metadata())
        told = [record.metadata["serialized_metadata"] for record in records if record.name == "rosbag2"][-1]
        assert [f"run_{other}.mcap" in told for other in range(6)] == [other == number for other in range(6)]
        assert "message_count: 1" in told


def test_bags_begun_in_one_second_have_folders_of_their_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folders = [new_directory() for _ in range(8)]
    assert len(set(folders)) == 8
    assert all(folder.parent == Path("bags") and not any(folder.iterdir()) for folder in folders)


def test_where_no_folder_can_be_made_the_writer_says_so(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("bags").write_text("a file")
    with pytest.raises(DiskError, match=r"Cannot create the bag directory .*: Not a directory"):
        BagWriter(new_directory())
