"""Bags of others, and bags made to harm: commands answer in a sentence, and nothing steers the terminal."""

from itertools import pairwise

import numpy as np
import pytest
from recorded_rig import record

from squeal_rig.analysis import estimate
from squeal_rig.errors import DiskError, RecordingError
from squeal_rig.recording import Bag, BagWriter, MessageSchema, QosProfile, cdr_from_samples
from squeal_rig.report.bag_info import bag_info
from squeal_rig.report.terminal import PlainConsole
from squeal_rig.samples.export import export_bag
from squeal_rig.samples.frames import read_array
from tests.command_line import in_this_process
from tests.messages import schema_of, string_cdr

CLOUD = schema_of("sensor_msgs/msg/PointCloud2")
STEERING = "\x1b[2J\x1b]0;title\x07"


def squeal_rig(*arguments):
    """(exit code, what was printed) of the command line."""
    code, output, errors = in_this_process(*arguments)
    assert "\x1b" not in output + errors
    assert "\x07" not in output + errors
    return code, output + errors


def cloud_bag(directory, names, topic="/cloud", formats=None, offsets=None, count=3):
    """A bag of samples whose fields have these names."""
    record_type = {"names": names, "formats": formats or ["<f8"] * len(names)}
    dtype = np.dtype(record_type | ({"offsets": offsets} if offsets else {}))
    with BagWriter(directory) as writer:
        handle = writer.add_topic(topic, CLOUD.type_name, schema=CLOUD)
        for number in range(count):
            samples = np.zeros(4, dtype)
            samples[names[0]] = number
            writer.write(handle, cdr_from_samples(samples, number * 10**9), number, number)
    return directory


@pytest.fixture(scope="module")
def rig_bag(tmp_path_factory, compiled_zones):
    directory = tmp_path_factory.mktemp("odd") / "run"
    record(directory, blocks=60)
    return directory


@pytest.fixture
def steering_bag(tmp_path, compiled_zones):
    """Every text of a bag that a command prints is a sequence for the terminal, or rich's markup."""
    odd = f"/[/x]{STEERING}"
    text = schema_of("std_msgs/msg/String")
    facts = {STEERING: f"[/red]{STEERING}", "preset": STEERING}
    with BagWriter(tmp_path / "run", custom_data=facts) as writer:
        cloud = writer.add_topic(f"{odd}/cloud", CLOUD.type_name, schema=CLOUD)
        words = writer.add_topic(odd, text.type_name, schema=text)
        samples = np.zeros(4, np.dtype([(f"[/x]{STEERING}", "<f8"), ("seq", "<u4")]))
        for number in range(3):
            writer.write(cloud, cdr_from_samples(samples, number), number, number)
        writer.write(words, b"\0\1\0\0\xff", 3, 3)
        writer.add_metadata("parameters", {"node": STEERING, "time_ns": "0", "values": STEERING})
        writer.add_metadata("snapshot", {"reason": f"[/x]{STEERING}", "seconds": STEERING})
        writer.close(f"[/x]{STEERING}")
    return tmp_path / "run"


@pytest.mark.parametrize(
    ("command", "code"),
    [
        (["info"], 0),
        (["bag", "verify"], 1),
        (["analyse"], 2),
        (["bag", "cut", "{bag}", "{out}", "--topic", "none*"], 2),
        (["bag", "recover", "{bag}", "{out}"], 0),
        (["bag", "estimate", "{bag}", "{out}"], 2),
        (["bag", "export", "{bag}", "{out}", "--to", "csv"], 0),
        (["bag", "export", "{bag}", "{out}", "--to", "csv", "--column", "none"], 2),
        (["bag", "export", "{bag}", "{out}", "--to", "wav"], 2),
    ],
)
def test_nothing_in_a_bag_steers_the_terminal(steering_bag, tmp_path, command, code):
    places = {"{bag}": steering_bag, "{out}": tmp_path / "out"}
    arguments = [places.get(part, part) for part in command]
    if "{bag}" not in command:
        arguments.append(steering_bag)
    got, text = squeal_rig(*arguments)
    assert got == code, text


def test_a_rate_is_that_of_the_topic_and_not_of_the_bag(tmp_path):
    """100 Hz for half a second, in a bag that goes on for ten."""
    text = schema_of("std_msgs/msg/String")
    with BagWriter(tmp_path / "run") as writer:
        short, long = (writer.add_topic(name, text.type_name, schema=text) for name in ("/short", "/long"))
        for number in range(51):
            writer.write(short, string_cdr("x"), 5 * 10**9 + number * 10**7, 0)
        for number in range(101):
            writer.write(long, string_cdr("x"), number * 10**8, 0)
        once = writer.add_topic("/once", text.type_name, schema=text)
        writer.write(once, string_cdr("x"), 7 * 10**9, 0)
    bag = Bag(tmp_path / "run")
    assert bag.time_span("/short") == (5 * 10**9, 5_500_000_000)
    assert bag.time_span("/once") == (7 * 10**9, 7 * 10**9)
    with open(tmp_path / "told", "w") as stream:
        PlainConsole(file=stream, width=120).print(bag_info(bag.path, quick=True))
    rows = [line.split("│") for line in (tmp_path / "told").read_text().splitlines() if "std_msgs" in line]
    assert {row[1].strip(): row[4].strip() for row in rows} == {"/short": "100.0", "/long": "10.0", "/once": "-"}


def test_a_bag_of_the_last_moment_is_told_and_estimated_in_sentences(rig_bag, tmp_path):
    end = 2**63 - 1
    bag = Bag(rig_bag)
    with BagWriter(tmp_path / "late") as writer:
        for name in ("/rig/description", "/daq/samples"):
            topic = bag.topics[name]
            handle = writer.add_topic(name, topic.type_name, topic.qos, topic.schema)
            for message in bag.messages([name]):
                writer.write(handle, message.data, end, end)
        for name in ("/friction/mu", "/friction/model", "/stability/summary"):
            writer.add_topic(name, bag.topics[name].type_name, schema=bag.topics[name].schema)
    assert squeal_rig("info", tmp_path / "late")[0] == 0
    code, text = squeal_rig("bag", "estimate", tmp_path / "late", tmp_path / "out")
    assert (code, "32-bit seconds" in text.replace("\n", " ")) == (2, True)


@pytest.mark.parametrize("name", ["/rig/description", "/stability/summary", "/daq/samples"])
def test_topics_of_another_type_are_refused(rig_bag, tmp_path, name):
    bag = Bag(rig_bag)
    other = MessageSchema("std_msgs/msg/UInt8", "uint8 data\n")
    with BagWriter(tmp_path / "run") as writer:
        handles = {
            topic.name: writer.add_topic(topic.name, other.type_name, schema=other)
            if topic.name == name
            else writer.add_topic(topic.name, topic.type_name, topic.qos, topic.schema)
            for topic in bag.topics.values()
        }
        for message in bag.messages():
            data = b"\0\1\0\0\1" if message.topic == name else message.data
            writer.write(handles[message.topic], data, message.log_time, message.publish_time)
    code, text = squeal_rig("bag", "estimate", tmp_path / "run", tmp_path / "out")
    assert code == 2, text
    code, text = squeal_rig("analyse", tmp_path / "run", "--picture", tmp_path / "picture.png")
    assert code == (0 if name == "/stability/summary" else 2), text


def test_an_error_of_the_disk_is_not_counted_as_refused(rig_bag, tmp_path, monkeypatch):
    def refuse(*_, **__):
        raise DiskError("The disk is full.")

    monkeypatch.setattr(estimate.BagWriter, "write", refuse)
    with pytest.raises(DiskError):
        estimate.estimate_bag(rig_bag, tmp_path / "out")


@pytest.mark.parametrize("form", ["csv", "parquet", "hdf5"])
@pytest.mark.parametrize(
    "names", [["."], ["stamp"], ["a/b"], ["a,b\n"], ["_topic"], ["a", ".."], ["\0"], ["x" * 5000], ["x", "x/y"]]
)
def test_fields_of_odd_names_are_exported_or_refused(tmp_path, form, names):
    bag = cloud_bag(tmp_path / "run", names)
    try:
        (file,) = export_bag(bag, form, tmp_path / "out")
    except RecordingError as error:
        assert len(str(error)) > 20  # noqa: PT017
        assert not list((tmp_path / "out").glob("*"))
        return
    assert file.rows == 12
    assert [path.name for path in (tmp_path / "out").iterdir()] == [file.path.name]
    if form == "csv":
        import csv

        with open(file.path, newline="") as stream:
            assert next(csv.reader(stream))[1:] == names


def test_a_field_that_would_be_a_second_column_is_refused(tmp_path):
    with pytest.raises(RecordingError, match="two columns 'stamp'"):
        read_array(cloud_bag(tmp_path / "run", ["stamp"]), "/cloud")
    bag = cloud_bag(tmp_path / "two", ["x", "x_1"], formats=[("<f8", (2,)), "<f8"])
    with pytest.raises(RecordingError, match="two columns 'x_1'"):
        read_array(bag, "/cloud")


@pytest.mark.parametrize("form", ["csv", "parquet", "hdf5"])
def test_fields_that_overlap_are_exported_as_they_are(tmp_path, form):
    bag = cloud_bag(tmp_path / "run", ["whole", "low"], formats=["<u4", "<u2"], offsets=[0, 0])
    assert export_bag(bag, form, tmp_path / "out")[0].rows == 12
    array = read_array(bag, "/cloud")
    assert (array["whole"] == array["low"]).all()


@pytest.mark.parametrize("form", ["csv", "parquet", "hdf5"])
@pytest.mark.parametrize("topic", ["/a\0b", "/" + "x" * 5000, "/..", "/", "/[/x]", "/\x1b[2J", "/a/./b", "//"])
def test_topics_of_odd_names_are_exported_or_refused(tmp_path, form, topic):
    bag = cloud_bag(tmp_path / "run", ["x"], topic)
    code, text = squeal_rig("bag", "export", bag, tmp_path / "out", "--to", form)
    assert code in (0, 2), text
    inside = {tmp_path / "run", tmp_path / "out"}
    assert set(tmp_path.iterdir()) <= inside, "nothing is written elsewhere"


def test_topics_that_would_share_a_file_are_refused_before_one_is_written(tmp_path):
    with BagWriter(tmp_path / "run") as writer:
        samples = np.zeros(4, np.dtype([("x", "<f8")]))
        for topic in ("/a/b", "/a_b"):
            writer.write(writer.add_topic(topic, CLOUD.type_name, schema=CLOUD), cdr_from_samples(samples, 0), 0, 0)
    with pytest.raises(RecordingError, match=r"Several topics would be written to .*a_b.csv"):
        export_bag(tmp_path / "run", "csv", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_offered_qos_of_odd_numbers_is_refused_in_a_sentence(tmp_path):
    with BagWriter(tmp_path / "deep") as writer:
        writer.add_topic("/cloud", CLOUD.type_name, [QosProfile(depth=7)], CLOUD)
    sound = (tmp_path / "deep" / "metadata.yaml").read_text()
    for depth in (".inf", ".nan", "1e400", "9" * 5000, "[7]", "-1"):
        (tmp_path / "deep" / "metadata.yaml").write_text(sound.replace("depth: 7", f"depth: {depth}"))
        code, text = squeal_rig("info", tmp_path / "deep")
        assert (code, "QoS" in text) == (2, True), depth


def test_a_file_name_with_a_zero_byte_is_refused(tmp_path):
    cloud_bag(tmp_path / "run", ["x"])
    path = tmp_path / "run" / "metadata.yaml"
    path.write_text(path.read_text().replace("run_0.mcap", '"run_0\\0.mcap"'))
    code, text = squeal_rig("info", tmp_path / "run")
    assert (code, "Cannot read" in text) == (2, True), text


def test_a_name_that_would_steer_the_terminal_is_written_out_within_its_table(tmp_path):
    cloud_bag(tmp_path / "run", ["x"], topic="/\x1b[31mred")
    _, text = squeal_rig("info", tmp_path / "run")
    rows = [line for line in text.splitlines() if "PointCloud2" in line or "/daq" in line]
    assert all(len(a) == len(b) for a, b in pairwise(rows))
    assert r"/\x1b[31mred" in text
