"""Exports and readers: every sample in its row, bit for bit, with its unit."""

import json
import sys
import tracemalloc

import numpy as np
import pytest
from recorded_rig import record

from squeal_rig.errors import RecordingError
from squeal_rig.recording import Bag
from squeal_rig.samples.columns import SampleColumns
from squeal_rig.samples.export import export_bag
from squeal_rig.samples.frames import read_array, read_frame, read_table


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """(bag, published samples of daq and truth)."""
    directory = tmp_path_factory.mktemp("export") / "run"
    recording = record(directory, blocks=60)
    return directory, np.concatenate(recording.daq), np.concatenate(recording.truth)


def assert_same(columns, published):
    """Every field of every sample, bit for bit."""
    for name in published.dtype.names:
        got = np.asarray(columns[name])
        assert got.dtype == published[name].dtype, name
        assert got.tobytes() == np.ascontiguousarray(published[name]).tobytes(), name


def test_parquet_loaded_back_equals_the_published_samples(run, tmp_path):
    pq = pytest.importorskip("pyarrow.parquet")
    directory, daq, truth = run
    files = {file.topic: file for file in export_bag(directory, "parquet", tmp_path / "out")}
    for topic, published in (("/daq/samples", daq), ("/truth/samples", truth)):
        frame = pq.read_table(files[topic].path).to_pandas()
        assert_same(frame, published)
        assert files[topic].rows == len(frame) == len(published)
    assert (np.diff(np.unique(frame["stamp"])) == 10_000_000).all()


def test_parquet_says_units_provenance_and_the_rigs_constants(run, tmp_path):
    pq = pytest.importorskip("pyarrow.parquet")
    (file,) = export_bag(run[0], "parquet", tmp_path / "daq.parquet", ["daq/samples"])
    schema = pq.read_schema(file.path)
    assert schema.field("motor_torque").metadata[b"unit"] == b"N m"
    assert schema.field("stamp").metadata[b"unit"] == b"ns"
    assert json.loads(schema.metadata[b"provenance"])["ending"] == "complete"
    descriptions = json.loads(schema.metadata[b"descriptions"])
    assert ["preload: 120" in told["yaml"] for told in descriptions] == [False, True]


def test_csv_reads_back_bit_for_bit(run, tmp_path):
    directory, daq, _ = run
    (file,) = export_bag(directory, "csv", tmp_path / "daq.csv", ["daq/samples"])
    with open(file.path) as stream:
        titles = stream.readline().strip().split(",")
        rows = [line.strip().split(",") for line in stream]
    assert titles[:3] == ["stamp [ns]", "t [s]", "x [m]"]
    names = [title.split(" [")[0] for title in titles]
    columns = {name: [row[place] for row in rows] for place, name in enumerate(names)}
    assert_same(
        {n: np.array([float(v) for v in c]) for n, c in columns.items() if n != "seq"}
        | {"seq": np.array([int(v) for v in columns["seq"]], np.uint32)},
        daq,
    )


def test_hdf5_holds_a_group_for_each_topic(run, tmp_path):
    h5py = pytest.importorskip("h5py")
    directory, daq, truth = run
    files = export_bag(directory, "hdf5", tmp_path / "run.h5")
    with h5py.File(files[0].path) as file:
        assert_same({name: file["/daq/samples"][name][:] for name in daq.dtype.names}, daq)
        assert_same({name: file["/truth/samples"][name][:] for name in truth.dtype.names}, truth)
        assert file["/daq/samples/preload"].attrs["unit"] == "N"


def test_wav_is_the_signal_up_to_its_scale(run, tmp_path):
    from scipy.io import wavfile

    directory, daq, _ = run
    (file,) = export_bag(directory, "wav", tmp_path / "squeal.wav", columns=["y"])
    rate, samples = wavfile.read(file.path)
    assert rate == 51200
    assert samples.dtype == np.float32
    scale = float(file.note.split("full scale = ")[1].split()[0])
    # float32 keeps 24 bits
    assert np.allclose(samples.astype(float) * scale, daq["y"], rtol=2**-23, atol=0.0)
    assert np.max(np.abs(samples)) == pytest.approx(0.9)


def test_lost_samples_are_silence_in_a_wav(run, tmp_path):
    from scipy.io import wavfile

    from squeal_rig.samples.wav import write_wav

    seq = np.r_[0:100, 150:200]
    values = np.ones((150, 1))
    frames, note = write_wav(tmp_path / "gap.wav", 1000, [("x", "m")], lambda: iter([(seq, values)]))
    _, samples = wavfile.read(tmp_path / "gap.wav")
    assert frames == len(samples) == 200
    assert (samples[100:150] == 0.0).all()
    assert (samples[150:] != 0.0).all()
    assert "50 lost samples are silence" in note


def test_the_readers_give_the_published_samples(run):
    pytest.importorskip("pandas")
    directory, daq, _ = run
    array = read_array(directory)
    assert_same(array, daq)
    frame = read_frame(directory, columns=["x", "preload"])
    assert list(frame.columns) == ["x", "preload"]
    assert frame.attrs["units"] == {"x": "m", "preload": "N"}
    assert frame["x"].to_numpy().tobytes() == np.ascontiguousarray(daq["x"]).tobytes()
    table = read_table(directory, "truth/samples")
    assert table.schema.field("vx").metadata[b"unit"] == b"m/s"


def test_a_part_of_the_time_is_read_alone(run):
    directory, _daq, _ = run
    part = read_array(directory, start=0.2, end=0.3)
    assert len(part) == 10 * 512
    assert set(np.diff(part["seq"].astype(int))) == {1}


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"topic": "nothing"}, "0 topics of samples 'nothing'"),
        ({"columns": ["z"]}, "no column 'z'"),
        ({"start": 100.0}, "no samples"),
    ],
)
def test_what_is_not_there_is_refused_in_a_sentence(run, arguments, sentence):
    with pytest.raises(RecordingError, match=sentence):
        read_array(run[0], **arguments)


def test_nothing_is_overwritten(run, tmp_path):
    export_bag(run[0], "csv", tmp_path / "a.csv", ["friction/windows"])
    with pytest.raises(RecordingError, match="exists already"):
        export_bag(run[0], "csv", tmp_path / "a.csv", ["friction/windows"])


@pytest.mark.parametrize(("form", "package"), [("parquet", "pyarrow"), ("hdf5", "h5py")])
def test_a_missing_package_is_named(run, tmp_path, monkeypatch, form, package):
    for name in [name for name in sys.modules if name.split(".")[0] == package]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(RecordingError, match=rf"package {package}, which is not installed"):
        export_bag(run[0], form, tmp_path / "out")
    assert not [path for path in (tmp_path / "out").rglob("*") if path.is_file()]


def peak_of_reading(directory):
    """Most memory [bytes] that Python takes while a bag is read in pieces of 1024 rows."""
    samples = SampleColumns(Bag(directory), "daq/samples")
    for _ in samples.pieces(1024):  # caches fill on the first pass
        pass
    tracemalloc.start()
    for _ in samples.pieces(1024):
        pass
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return peak


def test_a_bag_four_times_as_long_takes_no_more_memory_to_read(tmp_path):
    record(tmp_path / "short", blocks=100, live=False)
    record(tmp_path / "long", blocks=400, live=False)
    # An eighth more for what is counted in chunks; four times is what a reader of the whole would take.
    assert peak_of_reading(tmp_path / "long") < 1.125 * peak_of_reading(tmp_path / "short")
