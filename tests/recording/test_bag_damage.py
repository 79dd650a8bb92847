"""What `recover` gives back of a file cut short or with flipped bits: every intact chunk, and nothing wrong."""

import random
import shutil
from bisect import bisect_right
from collections import Counter

import pytest
from bag_making import chunk_places, messages_of, write_bag
from mcap.reader import make_reader

from squeal_rig.errors import RecordingError
from squeal_rig.recording import Bag
from squeal_rig.recording.recover import recover
from squeal_rig.recording.verify import verify


class Original:
    """A sound bag of many chunks: its bytes, its chunks and what is in each."""

    def __init__(self, directory, compression):
        self.sent = write_bag(directory, blocks=100, compression=compression)
        self.path = directory / f"{directory.name}_0.mcap"
        self.bytes = self.path.read_bytes()
        self.places = chunk_places(self.path)
        with open(self.path, "rb") as stream:
            ordered = [(m.log_time, c.topic) for _, c, m in make_reader(stream).iter_messages(log_time_order=False)]
        assert [(s.log_time, s.topic) for s in self.sent] == ordered


@pytest.fixture(scope="module", params=["zstd", "none"])
def original(request, tmp_path_factory):
    return Original(tmp_path_factory.mktemp("original") / request.param, request.param)


def recovered(data, directory):
    """(report, messages) that `recover` makes of these bytes; (None, []) where it refuses in a sentence."""
    broken, out = directory / "broken_0.mcap", directory / "out"
    shutil.rmtree(out, ignore_errors=True)
    broken.write_bytes(data)
    try:
        report = recover(broken, out)
    except RecordingError:
        return None, []
    bag = Bag(out)
    assert verify(out).sound or report.lost, [finding.sentence for finding in verify(out).findings]
    return report, messages_of(bag)


def check_truncation(original, offset, directory):
    report, got = recovered(original.bytes[:offset], directory)
    whole = sum(end <= offset for _, end in original.places)
    assert got == original.sent[: len(got)], "what was sent, from the beginning, without a gap or a wrong byte"
    # Messages of the whole chunks before the cut: by how many chunks were saved, and nothing in between.
    assert (report.chunks if report else 0) == whole
    if report is not None and offset < len(original.bytes):
        assert not report.closed
        assert not report.complete
        assert Bag(directory / "out").ending.startswith("aborted")


def check_flip(original, bit, directory):
    data = bytearray(original.bytes)
    data[bit // 8] ^= 1 << bit % 8
    report, got = recovered(bytes(data), directory)
    assert report is not None
    assert not Counter(got) - Counter(original.sent), "a message that was never sent"
    place = bisect_right([start for start, _ in original.places], bit // 8) - 1
    inside = place >= 0 and bit // 8 < original.places[place][1]
    assert report.chunks >= len(original.places) - inside, "an intact chunk was lost"
    assert len(got) == len(original.sent) or report.lost == len(original.sent) - len(got)
    assert len(got) == len(original.sent) or inside
    assert report.unproved == 0


def offsets(count, seed, limit):
    return random.Random(seed).sample(range(1, limit), count)


def test_a_whole_file_comes_back_whole(original, tmp_path):
    report, got = recovered(original.bytes, tmp_path)
    assert got == original.sent
    assert report.complete
    assert report.sentences()[-1] == "nothing is missing"
    copy = Bag(tmp_path / "out")
    assert copy.custom_data["seed"] == "7"
    assert copy.ending == "complete"
    assert [(r.name, r.values["node"]) for r in copy.metadata_records] == [("parameters", "/rig")]
    assert copy.topics["/rig/description"].qos[0].durability == "transient_local"


def test_a_damaged_metadata_record_is_missing(original, tmp_path):
    report, got = recovered(original.bytes.replace(b"preload: 50.0", b"preload: 60.0"), tmp_path)
    assert got == original.sent
    assert not report.complete
    assert report.sentences()[-1] == "1 damaged metadata records were left out"


def test_truncation_keeps_every_whole_chunk_and_nothing_else(original, tmp_path):
    for offset in offsets(20, 11, len(original.bytes)):
        check_truncation(original, offset, tmp_path)


def test_a_flipped_bit_costs_its_own_chunk_at_most(original, tmp_path):
    for bit in offsets(20, 12, 8 * len(original.bytes)):
        check_flip(original, bit, tmp_path)


def test_verify_finds_every_flipped_bit(original, tmp_path):
    """The checksums of chunks, data section and summary leave no byte uncovered but the header's and the magic."""
    for bit in offsets(20, 13, 8 * len(original.bytes)):
        data = bytearray(original.bytes)
        data[bit // 8] ^= 1 << bit % 8
        broken = tmp_path / "broken_0.mcap"
        broken.write_bytes(bytes(data))
        assert not verify(broken).sound, bit


@pytest.mark.bench
def test_500_truncations(original, tmp_path):
    for offset in offsets(500, 21, len(original.bytes)):
        check_truncation(original, offset, tmp_path)


@pytest.mark.bench
def test_500_flipped_bits(original, tmp_path):
    for bit in offsets(500, 22, 8 * len(original.bytes)):
        check_flip(original, bit, tmp_path)


def test_lost_messages_and_seconds_are_reported(original, tmp_path):
    start, end = original.places[3]
    data = bytearray(original.bytes)
    data[(start + end) // 2] ^= 0xFF
    report, got = recovered(bytes(data), tmp_path)
    missing = [m for m in original.sent if m not in set(got)]
    assert report.damaged_chunks == 1
    assert report.lost == len(missing) > 0
    times = [m.log_time for m in got]
    before = max(t for t in times if t < missing[0].log_time)
    after = min(t for t in times if t > missing[-1].log_time)
    assert report.lost_seconds == pytest.approx((after - before) * 1e-9)
    assert f"lost {report.lost} messages" in " ".join(report.sentences())
    assert Bag(tmp_path / "out").custom_data["recovered_lost_messages"] == str(len(missing))


@pytest.mark.parametrize("lost", [0, 1])
def test_nothing_is_called_complete_where_the_count_is_lost(original, tmp_path, lost):
    """Without the beginning nobody knows that the messages are numbered, without the summary how many there were."""
    data = bytearray(original.bytes[original.places[lost][0] :])
    data[-40] ^= 1  # within the summary, the footer as it was
    report, got = recovered(bytes(data), tmp_path)
    assert report.chunks == len(original.places) - lost
    assert (len(got) < len(original.sent)) == (lost > 0)
    assert (report.complete, report.lost) == (False, 0)
    assert report.sentences()[-1] == "1 of the files have lost the count of what they should hold: more may be missing"
    assert "count of what they should hold" in verify(tmp_path / "out").findings[0].sentence


def test_several_damaged_chunks_in_a_row_hide_nothing_after_them(original, tmp_path):
    data = bytearray(original.bytes)
    for start, end in original.places[2:5]:
        data[start + 1 : start + 5] = b"\xff\xff\xff\x7f"  # the length itself
        data[(start + end) // 2] ^= 0x55
    report, got = recovered(bytes(data), tmp_path)
    assert report.chunks == len(original.places) - 3
    assert report.lost == len(original.sent) - len(got)


@pytest.mark.parametrize("content", [b"", b"\x89MCAP0\r\n", b"no bag at all" * 100, bytes(5000)])
def test_a_file_without_a_chunk_is_refused_in_a_sentence(content, tmp_path):
    path = tmp_path / "odd.mcap"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=r"nothing to recover|no intact chunk"):
        recover(path, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("place", [0, -1])
def test_an_empty_file_keeps_no_other_of_its_folder_from_being_saved(tmp_path, place):
    sent = write_bag(tmp_path / "run", max_file_size=100_000)
    files = sorted((tmp_path / "run").glob("*.mcap"), key=lambda path: int(path.stem.split("_")[-1]))
    files[place].write_bytes(b"")
    report = recover(tmp_path / "run", tmp_path / "out")
    got = messages_of(Bag(tmp_path / "out"))
    assert 0 < len(got) < len(sent)
    assert report.empty_files == [files[place].name]
    assert not report.complete
    assert f"1 files of the bag are empty ({files[place].name}): what was in them is lost" in report.sentences()
    assert Bag(tmp_path / "out").custom_data["recovered_was_closed"] == "false"


def test_a_folder_of_empty_files_is_refused_in_a_sentence(tmp_path):
    for number in range(2):
        (tmp_path / f"run_{number}.mcap").write_bytes(b"")
    with pytest.raises(RecordingError, match="no intact chunk"):
        recover(tmp_path, tmp_path.parent / "out")


def test_all_files_of_a_folder_are_recovered_together(tmp_path):
    sent = write_bag(tmp_path / "run", max_file_size=100_000)
    files = sorted((tmp_path / "run").glob("*.mcap"), key=lambda path: int(path.stem.split("_")[-1]))
    assert len(files) > 2
    last = files[-1].read_bytes()
    files[-1].write_bytes(last[: len(last) // 2])
    (tmp_path / "run" / "metadata.yaml").unlink()
    report = recover(tmp_path / "run", tmp_path / "out")
    got = messages_of(Bag(tmp_path / "out"))
    assert got == sent[: len(got)]
    assert len(got) > len(sent) // 2
    assert not report.closed
    assert report.lost == 0
