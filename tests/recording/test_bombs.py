"""Small files and messages that stand for much work or memory are refused in a sentence before the work is done."""

import os
import resource
import subprocess
import sys
import time
import zlib
from struct import pack

import lz4.frame
import pytest
import zstandard
from bag_making import schema_of, string_cdr, write_bag
from mcap.opcode import Opcode
from mcap.writer import Writer

from squeal_rig.configuration.files import load_yaml
from squeal_rig.errors import ConfigurationError, RecordingError
from squeal_rig.instruments.description import RigDescription
from squeal_rig.recording import (
    Bag,
    BagWriter,
    MessageSchema,
    chunks,
    decoder_of,
    qos_from_yaml,
    reader,
    samples_from_cdr,
)
from squeal_rig.recording.records import iter_records
from squeal_rig.recording.recover import recover
from squeal_rig.recording.verify import verify

NINES = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"{new}: &{new} [{','.join(['*' + old] * 9)}]\n" for old, new in zip("abcdefg", "bcdefgh", strict=True)
)
ZEROS = 1 << 29


@pytest.fixture
def bounded():
    """No more than 200 MB beyond what the process has, and some seconds."""
    with open("/proc/self/statm") as stream:
        taken = int(stream.read().split()[0]) * resource.getpagesize()
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (taken + 200_000_000, hard))
    began = time.process_time()
    yield
    resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
    assert time.process_time() - began < 5.0


def zeros(compression):
    """A compressed stream of half a gigabyte of zeros; zstd's tells its size or not."""
    piece = bytes(1 << 24)
    if compression == "lz4":
        packer = lz4.frame.LZ4FrameCompressor()
        return packer.begin() + b"".join(packer.compress(piece) for _ in range(ZEROS >> 24)) + packer.flush()
    size = ZEROS if compression == "zstd" else -1
    packer = zstandard.ZstdCompressor().compressobj(size=size)
    return b"".join(packer.compress(piece) for _ in range(ZEROS >> 24)) + packer.flush()


@pytest.mark.parametrize("told", [1000, ZEROS])
@pytest.mark.parametrize("compression", ["zstd", "zstd of unknown size", "lz4"])
def test_a_chunk_that_expands_beyond_its_size_or_the_bound_is_refused(request, compression, told):
    packed, name = zeros(compression), compression[:4].encode().strip()
    request.getfixturevalue("bounded")
    body = pack("<QQQI", 0, 0, told, 0) + pack("<I", len(name)) + name + pack("<Q", len(packed)) + packed
    with pytest.raises(RecordingError, match=r"^the chunk"):
        chunks.unpack_chunk(body)


def test_a_chunk_of_too_many_messages_is_refused(monkeypatch, tmp_path):
    write_bag(tmp_path / "run", blocks=10)
    monkeypatch.setattr(chunks, "MAX_CHUNK_MESSAGES", 3)
    with pytest.raises(RecordingError, match="more than 3 messages"):
        list(Bag(tmp_path / "run").messages())


def test_chunks_that_all_overlap_are_refused_where_they_would_fill_the_memory(monkeypatch, tmp_path):
    text = schema_of("std_msgs/msg/String")
    with BagWriter(tmp_path / "run", chunk_size=1000) as writer:
        handle = writer.add_topic("/words", text.type_name, schema=text)
        for number in range(20):
            writer.write(handle, string_cdr("x" * 2000), 0, 0)
            writer.write(handle, string_cdr("x"), 100 + number, 0)
    monkeypatch.setattr(reader, "_MAX_WAITING", 10_000)
    assert sum(1 for _ in Bag(tmp_path / "run").messages()) == 40
    with BagWriter(tmp_path / "odd", chunk_size=10_000) as writer:
        handle = writer.add_topic("/words", text.type_name, schema=text)
        for number in range(20):
            for time_ns in (0, 100 + number):
                writer.write(handle, string_cdr("x" * 4000), time_ns, 0)
    with pytest.raises(RecordingError, match="overlap so far that more than 10000 bytes"):
        list(Bag(tmp_path / "odd").messages())


@pytest.mark.usefixtures("bounded")
@pytest.mark.parametrize(
    "read", [RigDescription.from_yaml, qos_from_yaml], ids=["rig/description", "quality of service"]
)
def test_aliases_in_a_text_are_refused(read):
    with pytest.raises((ConfigurationError, RecordingError), match=r"not valid YAML: aliases \(\*name\) are not read"):
        read(NINES)


@pytest.mark.usefixtures("bounded")
def test_aliases_in_a_file_and_in_the_metadata_of_a_bag_are_refused(tmp_path):
    (tmp_path / "plan.yaml").write_text(NINES)
    with pytest.raises(ConfigurationError, match="aliases"):
        load_yaml(tmp_path / "plan.yaml")
    write_bag(tmp_path / "run", blocks=2)
    path = tmp_path / "run" / "metadata.yaml"
    path.write_text(NINES.replace("\n", "\n  ") + "\n" + path.read_text())
    with pytest.raises(RecordingError, match="aliases"):
        Bag(tmp_path / "run")


@pytest.mark.usefixtures("bounded")
def test_yaml_that_is_too_long_is_refused_unread(tmp_path):
    with pytest.raises(ConfigurationError, match=r"^rig/description: 18000 characters of YAML; at most 16384"):
        RigDescription.from_yaml("mass: 1.0\n" * 1800)
    (tmp_path / "plan.yaml").write_text("- x\n" * 20_000)
    with pytest.raises(ConfigurationError, match=r"plan.yaml: it has more than 65536 bytes"):
        load_yaml(tmp_path / "plan.yaml")
    write_bag(tmp_path / "run", blocks=2)
    with open(tmp_path / "run" / "metadata.yaml", "a", encoding="utf-8") as stream:
        stream.write("  - x: y\n" * 500_000)
    with pytest.raises(RecordingError, match="it has more than 4194304 bytes"):
        Bag(tmp_path / "run")


def test_an_error_repeats_no_more_than_the_beginning_of_a_value():
    with pytest.raises(RecordingError) as refusal:
        qos_from_yaml("- history: " + "x" * 100_000 + "\n  depth: 1\n")
    assert len(str(refusal.value)) < 1100


@pytest.mark.usefixtures("bounded")
def test_a_file_of_too_many_topics_is_refused(tmp_path):
    path = tmp_path / "many_0.mcap"
    with open(path, "wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "another recorder")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
        for number in range(65_535):
            writer.register_channel(f"/t{number}", "cdr", schema)
        writer.finish()
    with pytest.raises(RecordingError, match=r"has 65535 topics; at most 4096 are read\.$"):
        Bag(path)


@pytest.mark.usefixtures("bounded")
@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("".join(f"int8 f{number}\n" for number in range(20_000)), "has 20000 fields; at most 4000"),
        ("".join(f"float64 field_{number}\n" for number in range(100_000)), "characters; at most 262144"),
        (f"a/Nothing[] many\n{'=' * 80}\nMSG: a/Nothing\nint8 A=1\n", "array of Nothing, which has no fields"),
        (f"a/Outer[9] many\n{'=' * 80}\nMSG: a/Outer\nN n\n{'=' * 80}\nMSG: a/N\nint8[0] x\n", "array of Outer"),
    ],
)
def test_definitions_that_cannot_be_parsed_or_filled_in_bounded_time_are_refused(text, words):
    with pytest.raises(RecordingError, match=words):
        decoder_of(MessageSchema("a/msg/B", text))


@pytest.mark.usefixtures("bounded")
def test_a_point_of_too_many_fields_is_refused_before_they_are_parsed():
    field = pack("<I", 2) + b"x\0\0\0" + pack("<I", 0) + b"\x08\0\0\0" + pack("<I", 1)
    data = b"\0\1\0\0" + bytes(8) + pack("<I", 1) + bytes(4) + pack("<III", 1, 1, 60_000) + field * 60_000 + bytes(64)
    with pytest.raises(RecordingError, match=r"^A PointCloud2 has 60000 fields; at most 1024 are read\.$"):
        samples_from_cdr(data)


FIFO = """
import sys
from pathlib import Path
from squeal_rig.configuration.files import load_yaml
from squeal_rig.errors import SquealRigError
from squeal_rig.recording import Bag
from squeal_rig.recording.records import iter_records
from squeal_rig.recording.recover import recover
from squeal_rig.recording.verify import verify
folder = Path(sys.argv[1])
for read in (Bag, verify, load_yaml, lambda path: recover(path, folder / "out")):
    for path in (folder / "run_0.mcap", folder, Path("/dev/zero")):
        try:
            print(read(path))
        except SquealRigError as error:
            print(error)
"""


@pytest.mark.parametrize("name", ["run_0.mcap", "metadata.yaml"])
def test_a_pipe_in_the_place_of_a_file_keeps_nobody_waiting(tmp_path, name):
    folder = tmp_path / "run"
    folder.mkdir()
    os.mkfifo(folder / name)
    command = [sys.executable, "-c", FIFO, str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.splitlines()) == 12
    assert "Not a regular file" in done.stdout


def test_sizes_and_places_beyond_every_file_are_refused(tmp_path):
    write_bag(tmp_path / "run", blocks=10)
    path = tmp_path / "run" / "run_0.mcap"
    sound = path.read_bytes()
    start = int.from_bytes(sound[-28:-20], "little")
    bodies = {opcode: body for opcode, body, _ in iter_records(sound, start, len(sound) - 37)}
    chunk, metadata = bodies[Opcode.CHUNK_INDEX], bodies[Opcode.METADATA_INDEX]
    for place in (start + 1, chunk + 16, chunk + 24, metadata, metadata + 8, len(sound) - 28, len(sound) - 20):
        for value in (2**40, 2**63, 2**64 - 1):
            data = bytearray(sound)
            data[place : place + 8] = value.to_bytes(8, "little")
            data[-12:-8] = zlib.crc32(data[start:-12]).to_bytes(4, "little")
            path.write_bytes(data)
            assert not verify(path).sound, place
            assert recover(path, tmp_path / f"out_{place}_{value}").messages == 21
