import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from squeal_rig.errors import RecordingError
from squeal_rig.recording import cdr_from_samples, clouds, samples_from_cdr

DAQ_FIELDS = ("t", "x", "y", "arm_left", "arm_right", "motor_torque", "belt_speed", "preload", "seq")
DAQ = np.dtype(
    {
        "names": DAQ_FIELDS,
        "formats": ["<f8"] * 8 + ["<u4"],
        "offsets": range(0, 72, 8),
        "itemsize": 72,  # a multiple of 8: the last 4 bytes are padding
    }
)


def daq_samples(count):
    samples = np.zeros(count, DAQ)
    generator = np.random.default_rng(1)
    for name in DAQ.names:
        samples[name] = generator.integers(0, 2**32, count) if name == "seq" else generator.normal(size=count)
    return samples


@st.composite
def sample_arrays(draw):
    """Structured arrays of any layout a PointCloud2 can describe: gaps, repeats, both byte orders."""
    order = draw(st.sampled_from("<>"))
    names = draw(st.lists(st.text(min_size=1, max_size=6).filter(encodable), min_size=1, max_size=6, unique=True))
    formats, offsets, at = [], [], 0
    for _ in names:
        code = draw(st.sampled_from(["i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8"]))
        repeat = draw(st.sampled_from([1, 1, 1, 3]))
        at += draw(st.integers(0, 5))
        formats.append(order + code if repeat == 1 else (order + code, (repeat,)))
        offsets.append(at)
        at += repeat * int(code[1])
    itemsize = at + draw(st.integers(0, 9))
    dtype = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": itemsize})
    count = draw(st.integers(0, 5))
    return np.frombuffer(draw(st.binary(min_size=count * itemsize, max_size=count * itemsize)), dtype, count)


def encodable(text):
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return not text.endswith("\0")  # numpy cannot hold such a name


def read_or_refusal(data):
    try:
        return samples_from_cdr(data), ""
    except RecordingError as error:
        return None, str(error)


def assert_same(read, written):
    assert read.dtype.names == written.dtype.names
    for name in written.dtype.names:
        assert read[name].tobytes() == written[name].tobytes()


@given(sample_arrays(), st.integers(-(2**31) * 10**9, 2**31 * 10**9 - 1), st.text(max_size=9))
def test_samples_come_back_from_their_message(samples, stamp_ns, frame_id):
    frame_id = frame_id.encode(errors="ignore").decode()
    block = samples_from_cdr(cdr_from_samples(samples, stamp_ns, frame_id))
    assert (block.stamp_ns, block.frame_id, len(block.samples)) == (stamp_ns, frame_id, len(samples))
    assert_same(block.samples, samples)


def test_rosbags_reads_and_writes_the_same_bytes(types):
    data = cdr_from_samples(daq_samples(512), 1_700_000_000_123_456_789)
    message = types.deserialize_cdr(data, "sensor_msgs/msg/PointCloud2")
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (1_700_000_000, 123_456_789)
    assert (message.height, message.width, message.point_step, message.row_step) == (1, 512, 72, 512 * 72)
    assert [(field.name, field.offset, field.datatype, field.count) for field in message.fields] == [
        (name, 8 * place, 6 if name == "seq" else 8, 1) for place, name in enumerate(DAQ.names)
    ]
    assert bytes(types.serialize_cdr(message, "sensor_msgs/msg/PointCloud2")) == data


def test_samples_of_a_foreign_big_endian_message_are_read(types):
    samples = daq_samples(7)
    message = types.deserialize_cdr(cdr_from_samples(samples, 5), "sensor_msgs/msg/PointCloud2")
    foreign = bytes(types.serialize_cdr(message, "sensor_msgs/msg/PointCloud2", little_endian=False))
    assert foreign[1] == 0
    assert_same(samples_from_cdr(foreign).samples, samples)


def test_padded_rows_are_joined(types):
    samples = daq_samples(6)
    message = types.deserialize_cdr(cdr_from_samples(samples, 5), "sensor_msgs/msg/PointCloud2")
    message.height, message.width, message.row_step = 2, 3, 3 * 72 + 16
    rows = message.data.reshape(2, 3 * 72)
    message.data = np.concatenate([rows, np.full((2, 16), 255, np.uint8)], axis=1).reshape(-1)
    data = bytes(types.serialize_cdr(message, "sensor_msgs/msg/PointCloud2"))
    assert_same(samples_from_cdr(data).samples, samples)


def test_samples_are_a_view_of_the_message_and_cannot_be_written():
    data = cdr_from_samples(daq_samples(512), 0)
    samples = samples_from_cdr(data).samples
    start = np.frombuffer(data, np.uint8).ctypes.data
    assert start <= samples.ctypes.data < start + len(data)
    assert not samples.flags.writeable


def test_messages_that_differ_only_in_their_fields_are_not_mixed_up():
    one = np.zeros(4, [("t", "<f8"), ("a", "<f8")])
    two = np.zeros(4, [("t", "<f8"), ("b", "<f8")])
    short = np.zeros(3, [("t", "<f8"), ("a", "<f8")])
    for samples in (one, two, short, one, two, short):
        read = samples_from_cdr(cdr_from_samples(samples, 0)).samples
        assert (read.dtype.names, len(read)) == (samples.dtype.names, len(samples))


def test_what_is_remembered_of_layouts_stays_bounded():
    for count in range(300):
        samples_from_cdr(cdr_from_samples(np.zeros(count, DAQ), 0))
    assert len(clouds._layouts) <= clouds._MAX_LAYOUTS


@settings(max_examples=400)
@given(st.data())
def test_damaged_messages_are_read_or_refused_with_a_sentence(types, data):
    whole = cdr_from_samples(daq_samples(3), 10**18)
    if data.draw(st.booleans()):
        message = types.deserialize_cdr(whole, "sensor_msgs/msg/PointCloud2")
        whole = bytes(types.serialize_cdr(message, "sensor_msgs/msg/PointCloud2", little_endian=False))
    damaged = bytearray(whole[: data.draw(st.integers(0, len(whole)))])
    for _ in range(data.draw(st.integers(0, 4))):
        if damaged:
            damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    block, refusal = read_or_refusal(bytes(damaged))
    assert refusal.endswith(".") if block is None else block.samples.nbytes <= len(damaged)


@settings(max_examples=300)
@given(st.binary(max_size=200))
def test_any_bytes_are_read_or_refused_with_a_sentence(noise):
    for data in (noise, b"\0\1\0\0" + noise, b"\0\0\0\0" + noise):
        block, refusal = read_or_refusal(data)
        assert refusal.endswith(".") if block is None else block.samples.nbytes <= len(data)


@pytest.mark.parametrize("cut", [0, 15, 60, 400, 1000])
def test_a_message_cut_short_is_refused(cut):
    with pytest.raises(RecordingError, match=r"cut short|bytes of points and has"):
        samples_from_cdr(cdr_from_samples(daq_samples(20), 0)[:cut])


@pytest.mark.parametrize(
    "samples",
    [
        np.zeros(3),
        np.zeros((2, 2), DAQ),
        np.zeros(2, [("a", "<f2")]),
        np.zeros(2, [("a", "<f8"), ("b", ">f8")]),
    ],
)
def test_samples_that_fit_no_cloud_are_refused(samples):
    with pytest.raises(RecordingError):
        cdr_from_samples(samples, 0)


def test_a_message_of_absurdly_many_fields_is_refused_by_their_number():
    from struct import pack

    fields = b"".join(pack("<I8sIBxxxI", 8, b"f%06d\0" % number, 8 * number, 8, 1) for number in range(60_000))
    data = b"\0\1\0\0" + bytes(8) + pack("<I4sIII", 4, b"rig\0", 1, 0, 60_000) + fields
    data += pack("<BxxxIII", 0, 1 << 16, 0, 0) + b"\1"
    with pytest.raises(RecordingError, match="60000 fields; at most 1024"):
        samples_from_cdr(data)
