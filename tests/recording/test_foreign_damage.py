"""Damaged bags of other writers: definitions in the first chunk only, checksums or none."""

import pytest
from bag_making import START, chunk_places
from mcap.opcode import Opcode
from mcap.writer import CompressionType, IndexType, Writer

from squeal_rig.errors import RecordingError
from squeal_rig.recording import Bag
from squeal_rig.recording.records import HEAD, MAGIC, iter_records
from squeal_rig.recording.recover import recover
from squeal_rig.recording.verify import verify
from tests.messages import schema_of, string_cdr

COUNT = 200


def words():
    return [string_cdr(f"word {number} " + "x" * 100) for number in range(COUNT)]


def write_foreign(path, crcs, compression=CompressionType.ZSTD, chunks=True, **options):
    definition = schema_of("std_msgs/msg/String")
    with open(path, "wb") as stream:
        writer = Writer(
            stream, chunk_size=2000, compression=compression, enable_crcs=crcs, use_chunking=chunks, **options
        )
        writer.start("ros2", "somebody")
        schema = writer.register_schema(definition.type_name, "ros2msg", definition.text.encode())
        channel = writer.register_channel("/words", "cdr", schema)
        for number, data in enumerate(words()):
            writer.add_message(channel, START + number, data, START + number, number)
        writer.finish()
    return path


def payloads(bag):
    return [message.data for message in Bag(bag).messages()]


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4, CompressionType.NONE])
@pytest.mark.parametrize("crcs", [True, False])
def test_a_cut_file_is_saved_and_what_no_checksum_vouches_for_is_counted(tmp_path, crcs, compression):
    path = write_foreign(tmp_path / "a_0.mcap", crcs, compression)
    end = chunk_places(path)[4][1]
    path.write_bytes(path.read_bytes()[: end + 5])
    report = recover(path, tmp_path / "out")
    got = payloads(tmp_path / "out")
    assert got == words()[: len(got)]
    assert report.chunks == 5
    assert report.messages == len(got) > 0
    assert report.unproved == (0 if crcs else len(got))
    assert ("nothing vouches for them" in " ".join(report.sentences())) is not crcs


def test_definitions_lost_with_the_first_chunk_come_from_the_summary(tmp_path):
    path = write_foreign(tmp_path / "a_0.mcap", crcs=True)
    places = chunk_places(path)
    data = bytearray(path.read_bytes())
    data[places[0][1] - 3] ^= 0xFF
    path.write_bytes(bytes(data))
    report = recover(path, tmp_path / "out")
    got = payloads(tmp_path / "out")
    assert got == words()[-len(got) :]
    assert report.lost == COUNT - len(got) > 0


def test_messages_whose_definition_is_lost_are_not_guessed(tmp_path):
    path = write_foreign(tmp_path / "a_0.mcap", crcs=True)
    places = chunk_places(path)
    data = bytearray(path.read_bytes()[: places[5][1]])
    data[places[0][1] - 3] ^= 0xFF
    path.write_bytes(bytes(data))
    with pytest.raises(RecordingError, match="nothing can be recovered"):
        recover(path, tmp_path / "out")


def test_messages_outside_chunks_are_saved_without_proof(tmp_path):
    path = write_foreign(tmp_path / "a_0.mcap", crcs=True, chunks=False)
    path.write_bytes(path.read_bytes()[:12000])
    report = recover(path, tmp_path / "out")
    got = payloads(tmp_path / "out")
    assert got == words()[: len(got)]
    assert report.unproved == len(got) > 50


def test_a_bag_without_any_index_is_sound_since_readers_go_from_front_to_back(tmp_path):
    write_foreign(tmp_path / "a_0.mcap", crcs=False, index_types=IndexType.NONE)
    assert verify(tmp_path / "a_0.mcap").sound


def test_a_channel_whose_schema_is_gone_from_the_data_is_no_sound_bag(tmp_path):
    path = write_foreign(tmp_path / "a_0.mcap", crcs=False, chunks=False)
    assert verify(path).sound
    data = path.read_bytes()
    start = next(start for opcode, start, _ in iter_records(data, len(MAGIC)) if opcode == Opcode.SCHEMA)
    # A record of nobody's in its place: every offset behind stays as it is.
    path.write_bytes(data[: start - HEAD.size] + b"\x80" + data[start - HEAD.size + 1 :])
    verdict = verify(path)
    assert not verdict.sound
    assert "channel 1 comes before its schema 1" in " ".join(verdict.sentences())
