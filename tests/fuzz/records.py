"""Messages and texts out of bags and off the graph, one by one, in the hands of everything that reads them."""

import struct
from pathlib import Path

import numpy as np
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from squeal_rig.configuration.files import dump_yaml
from squeal_rig.instruments.channels import (
    DAQ_CHANNELS,
    DAQ_RECORD,
    FRICTION_SAMPLE_CHANNELS,
    FRICTION_WINDOW_CHANNELS,
    FRICTION_WINDOW_RECORD,
    TRUTH_CHANNELS,
    TRUTH_RECORD,
    block_from_cdr,
)
from squeal_rig.instruments.description import RigDescription
from squeal_rig.model.parameters import RigParameters
from squeal_rig.recording import (
    MessageSchema,
    QosProfile,
    as_mapping,
    cdr_from_samples,
    decoder_of,
    qos_from_yaml,
    qos_to_yaml,
    samples_from_cdr,
)
from tests.messages import schema_of

from . import Case
from .bounded import Notes
from .yaml_files import bombs, encoded, odd_texts

TYPES = get_typestore(Stores.ROS2_JAZZY)
RECORDS = {
    "daq/samples": (DAQ_RECORD, DAQ_CHANNELS),
    "truth/samples": (TRUTH_RECORD, TRUTH_CHANNELS),
    "friction/windows": (FRICTION_WINDOW_RECORD, FRICTION_WINDOW_CHANNELS),
}
ODD_NUMBERS = (0, 1, 2, 3, 7, 8, 255, 2**15, 2**16 - 1, 2**16, 2**31 - 1, 2**31, 2**32 - 1)
ODD_FLOATS = (
    0.0,
    -0.0,
    1e-320,
    1e-12,
    1.0,
    -1.0,
    50.0,
    1e6,
    1e12,
    1e20,
    1e154,
    1e308,
    -1e308,
    *map(float, ("nan", "inf", "-inf")),
)
ODD_NAMES = (
    "",
    "\0",
    "x",
    "y",
    "t",
    "seq",
    "preload",
    "stamp",
    ".",
    "..",
    "a/b",
    "a" * 300,
    "[/x]",
    "\x1b[31m",
    "\u00e9",
    "rgb",
)
STOCK = ("std_msgs/msg/String", "sensor_msgs/msg/PointCloud2", "diagnostic_msgs/msg/DiagnosticArray",
         "rcl_interfaces/msg/ParameterEvent", "std_msgs/msg/Float64MultiArray", "rosgraph_msgs/msg/Clock",
         "sensor_msgs/msg/JointState", "geometry_msgs/msg/WrenchStamped", "std_msgs/msg/Float64")  # fmt: skip
_PARAMETERS = RigParameters.preset("yavuz_sen_2023").replace(damping_x=20.0, damping_y=20.0)
DESCRIPTION = RigDescription(_PARAMETERS, preset="yavuz_sen_2023", sample_rate=6400).to_yaml()
STAMP = 1_700_000_000 * 10**9


# --- PointCloud2


class _Cdr:
    """Packs a message by hand: what a serialiser would not write as well."""

    def __init__(self, order="<"):
        self.out = bytearray(b"\0\0\0\0" if order == ">" else b"\0\1\0\0")
        self._order = order

    def add(self, code, value):
        size = struct.calcsize(code)
        self.out += bytes(-(len(self.out) - 4) % size)
        self.out += struct.pack(self._order + code, value)

    def text(self, value, size=None):
        data = encoded(value) + b"\0"
        self.add("I", len(data) if size is None else size)
        self.out += data


@st.composite
def odd_clouds(draw):
    """A PointCloud2 with a layout that nobody would choose, its lengths right or not."""
    cdr = _Cdr(draw(st.sampled_from("<<<>")))
    cdr.add("i", draw(st.sampled_from((0, 1, 1_700_000_000, -1, 2**31 - 1, -(2**31)))))
    cdr.add("I", draw(st.sampled_from((0, 999_999_999, 10**9, 2**32 - 1))))
    cdr.text(draw(st.sampled_from(("rig", "", "\x1b]0;x\7", "f" * 1000))))
    size = draw(st.sampled_from((0, 1, 8, 24, 88, 88, 88, 1000, 65536, 65537, 2**32 - 1)))
    width = draw(st.sampled_from((0, 1, 2, 64, 64, 2**16, 2**31, 2**32 - 1)))
    height = draw(st.sampled_from((0, 1, 1, 1, 2, 2**16, 2**32 - 1)))
    cdr.add("I", height)
    cdr.add("I", width)
    names = draw(st.lists(st.sampled_from((*DAQ_RECORD.names, *ODD_NAMES)), max_size=14))
    cdr.add("I", draw(st.sampled_from((*(5 * (len(names),)), 2**32 - 1))))
    for place, name in enumerate(names):
        cdr.text(name)
        cdr.add("I", draw(st.sampled_from((place * 8, place * 8, place * 8, 0, 80, 2**32 - 8))))
        cdr.add("B", draw(st.sampled_from((8, 8, 8, 8, 1, 2, 6, 7, 0, 9, 255))))
        cdr.add("I", draw(st.sampled_from((1, 1, 1, 1, 0, 2, 3, 65536, 2**32 - 1))))
    cdr.add("B", draw(st.sampled_from((0, 0, 0, 0, 1, 2))))
    cdr.add("I", size)
    cdr.add("I", draw(st.sampled_from((size * width % 2**32, size * width % 2**32, 0, *ODD_NUMBERS))))
    points = min(size * width * height, draw(st.sampled_from((0, 88 * 64, 88 * 64, 1 << 17))))
    cdr.add("I", draw(st.sampled_from((points, points, points, *ODD_NUMBERS))))
    cdr.out += draw(st.sampled_from((b"\0", b"\x3f", b"\xff"))) * points + b"\1" * draw(st.integers(0, 9))
    return bytes(cdr.out)


@st.composite
def odd_blocks(draw, topic=None):
    """A block of one of our own topics whose values no rig has."""
    record, _ = RECORDS[draw(st.sampled_from(sorted(RECORDS)) if topic is None else st.just(topic))]
    count = draw(st.sampled_from((0, 1, 2, 64, 64, 64, 1000)))
    samples = np.zeros(count, record)
    usual = {
        "preload": 50.0,
        "belt_speed": 1.0,
        "t": np.arange(count) / 6400,
        "seq": np.arange(count),
        "arm_left": 50.0,
    }
    for name in set(usual) & set(record.names):
        samples[name] = usual[name]
    for name in draw(st.lists(st.sampled_from(record.names), max_size=4)):
        number = draw(st.sampled_from(ODD_NUMBERS if name == "seq" else ODD_FLOATS))
        where = slice(None) if draw(st.booleans()) else slice(count // 2, count // 2 + 1)
        samples[name][where] = number % 2**32 if name == "seq" else number
    if draw(st.integers(0, 5)) == 0:  # fewer columns, or others
        kept = draw(st.lists(st.sampled_from(record.names), min_size=1, max_size=6, unique=True))
        fewer = np.zeros(count, [(name, record[name].str) for name in kept])
        for name in kept:
            fewer[name] = samples[name]
        samples = fewer
    stamp = draw(st.sampled_from((STAMP, STAMP, 0, 1, 2**31 * 10**9 - 1, 10**18, -(10**9))))
    return cdr_from_samples(samples, stamp, draw(st.sampled_from(("rig", "rig", ""))))


@st.composite
def spoilt(draw, data):
    """Bytes with a few numbers in them overwritten, cut off, or with more behind them."""
    out = bytearray(data)
    for _ in range(draw(st.integers(1, 3))):
        how = draw(st.sampled_from(("number", "number", "byte", "cut", "more")))
        at = draw(st.integers(0, max(len(out) - 1, 0)))
        if how == "number":
            at -= at % 4
            out[at : at + 4] = struct.pack("<I", draw(st.sampled_from(ODD_NUMBERS)))
        elif how == "byte" and out:
            out[at] = draw(st.integers(0, 255))
        elif how == "cut":
            del out[at:]
        else:
            out += draw(st.binary(max_size=40))
    return bytes(out)


def clouds(topic=None):
    """PointCloud2 of every kind."""
    blocks = odd_blocks(topic)
    return st.one_of(
        odd_clouds(), blocks, blocks, blocks.flatmap(spoilt), odd_clouds().flatmap(spoilt), st.binary(max_size=200)
    )


def many_fields(count=60_000):
    """A PointCloud2 with that many fields."""
    cdr = _Cdr()
    for code, value in (("i", 0), ("I", 0)):
        cdr.add(code, value)
    cdr.text("rig")
    for value in (1, 1, count):
        cdr.add("I", value)
    for number in range(count):
        cdr.text(f"f{number}")
        cdr.add("I", number % 60_000)
        cdr.add("B", 2)
        cdr.add("I", 1)
    cdr.add("B", 0)
    for value in (65_535, 65_535, 65_535):
        cdr.add("I", value)
    return bytes(cdr.out) + bytes(65_535)


def heavy_clouds():
    """Clouds whose layout stands for more work or memory than their bytes do."""
    wide = np.zeros(1, [("a", "<u1", (60_000,))])
    return {"many_fields": many_fields(), "wide_field": cdr_from_samples(wide, STAMP)}


# --- serialised messages of other types, definitions, texts


def messages_of(type_name):
    """CDR bytes of a stock type: what is no such message, and what is one with odd numbers in it."""
    head = b"\0\1\0\0"
    numbers = st.lists(st.sampled_from(ODD_NUMBERS).map(lambda n: struct.pack("<I", n)), max_size=30).map(b"".join)
    texts = st.sampled_from(("", "rig", "/rig", "[/x]", "\x1b[2J", "x" * 3000)).map(
        lambda t: struct.pack("<I", len(t) + 1) + t.encode() + b"\0"
    )
    loose = st.lists(st.one_of(numbers, texts, st.binary(max_size=12)), max_size=8).map(
        lambda parts: head + b"".join(parts)
    )
    if type_name == "sensor_msgs/msg/PointCloud2":
        return clouds()
    if type_name == "std_msgs/msg/String":
        return st.one_of(loose, odd_texts(DESCRIPTION).map(string_cdr), st.text(max_size=100).map(string_cdr))
    return st.one_of(loose, st.binary(max_size=100))


def string_cdr(text):
    """A std_msgs/String, of what is no text as well."""
    data = encoded(text) + b"\0"
    return b"\0\1\0\0" + struct.pack("<I", len(data)) + data


def definitions():
    """(type name, definition) as a channel of a bag would have them."""
    names = st.sampled_from(
        (*STOCK, "a/msg/B", "a/b", "", "/", "msg", "../os/msg/path", "std_msgs/msg/", "x" * 3000, "\0")
    )
    stock = st.sampled_from(STOCK).map(lambda name: schema_of(name).text)
    odd = (
        *("", "float64 x", "a/B b", "float64[<=1e9] x", "string<=9999999999 s", "int32[99999999] x", "===\nMSG: a/B"),
        *("float64 x\nfloat64 x", "uint8 X=300", "B b\n===\nMSG: a/B\nB b", "[/x] y", "\0"),
    )
    more = st.sampled_from(odd)
    return st.tuples(names, st.one_of(stock, more, stock.flatmap(odd_texts)))


# --- the class


def make_corpus(folder):
    """Texts to spoil."""
    qos = qos_to_yaml([QosProfile(), QosProfile(depth=1, durability="transient_local", deadline_ns=10**7)])
    texts = {
        "qos": qos,
        "description": DESCRIPTION,
        "parameters": dump_yaml({"preload": 50.0, "topics": ["a", "b"], "use_sim_time": False, "none": None}),
    }
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")


def made(_corpus):
    """Bombs, and clouds with many fields."""
    for name, text in bombs().items():
        for kind in ("qos", "description", "parameters"):
            yield Case({kind: encoded(text)}, {"made": name})
    for name, data in heavy_clouds().items():
        yield Case({"cloud": data}, {"made": name})
    wide = "\n".join(f"float64 f{number}" for number in range(100_000))
    nested = "A a\n" + "".join(
        f"===\nMSG: p/{a}\n{b} x\n{b} y\n"
        for a, b in zip("ABCDEFGHIJKLMNOPQRSTUVWX", "BCDEFGHIJKLMNOPQRSTUVWXY", strict=True)
    )
    for name, text in (("wide", wide), ("nested", nested)):
        yield Case({"definition": text.encode(), "message": bytes(100)}, {"type": "a/msg/B", "made": name})


def cases(corpus):
    """One message or text."""
    texts = [path.name for path in sorted(corpus.iterdir())]
    text = st.sampled_from(texts).flatmap(
        lambda name: odd_texts((corpus / name).read_text(encoding="utf-8")).map(lambda t: Case({name: encoded(t)}))
    )
    cloud = clouds().map(lambda data: Case({"cloud": data}))
    message = st.sampled_from(STOCK).flatmap(
        lambda name: messages_of(name).map(lambda data: Case({"message": data}, {"stock": name}))
    )
    defined = st.builds(
        lambda d, data: Case({"definition": encoded(d[1]), "message": data}, {"type": d[0].replace("\0", "<NUL>")}),
        definitions(),
        st.binary(max_size=64),
    )
    return st.one_of(cloud, cloud, cloud, text, text, message, defined)


def prepare(_corpus):
    """Compile what a block runs through."""
    good = np.zeros(64, DAQ_RECORD)
    good["preload"], good["belt_speed"] = 50.0, 1.0
    _follow(cdr_from_samples(good, STAMP), Notes(lambda _: None))


def examine(case, notes):
    """Read the message or the text with everything that reads its kind."""
    for name, data in case.files.items():
        if name == "cloud":
            _examine_cloud(data, notes)
        elif name == "definition":
            schema = MessageSchema(
                case.facts["type"].replace("<NUL>", "\0"), data.decode("utf-8", "replace"), "", "ros2msg"
            )
            _decode(schema, case.files["message"], notes)
            notes.step("conflict", schema.conflict, schema_of("std_msgs/msg/String"))
        elif name == "message" and "stock" in case.facts:
            _decode(schema_of(case.facts["stock"]), data, notes)
        elif name != "message":
            _examine_text(name, data, notes)


def _decode(schema, data, notes):
    decode = notes.step("decoder_of", decoder_of, schema)
    if decode is not None:
        message = notes.step("decode", decode, data)
        notes.step("as_mapping", as_mapping, message)


def _examine_text(name, data, notes):
    from squeal_rig.recording.parameter_log import parameters_of
    from squeal_rig.recording.reader import read_metadata

    text = data.decode("utf-8", "replace")
    if name == "qos":
        profiles = notes.step("qos_from_yaml", qos_from_yaml, text)
        if profiles is not None:
            again = notes.step("qos_to_yaml", lambda: qos_from_yaml(qos_to_yaml(profiles)))
            if again != profiles:
                notes.wrong("QoS profiles that are other ones once they are written and read")
    elif name == "description":
        _describe(text, notes)
    else:
        notes.step("parameters_of", parameters_of, {"values": text, "node": "/rig", "time_ns": "1"})
        notes.step("parameters_of", parameters_of, {"values": "a: 1", "node": "/rig", "time_ns": text[:100]})
    Path("bag").mkdir(exist_ok=True)
    Path("bag/metadata.yaml").write_bytes(data)
    notes.step("read_metadata", read_metadata, Path("bag"))


def _describe(text, notes):
    """A description that is taken is one that the estimators can work with."""
    from squeal_rig.estimation.friction_follower import FrictionFollower
    from squeal_rig.estimation.settings import FrictionSettings, SquealSettings
    from squeal_rig.estimation.squeal import SquealDetector
    from squeal_rig.estimation.stability_follower import StabilityFollower

    rig = notes.step("RigDescription.from_yaml", RigDescription.from_yaml, text)
    if rig is None:
        return
    again = notes.step("RigDescription.to_yaml", lambda: RigDescription.from_yaml(rig.to_yaml()))
    if again != rig:
        notes.wrong("a description that is another one once it is written and read")
    stability = StabilityFollower()
    notes.step("stability", stability.take_rig, rig)
    notes.step("summary", stability.summary, 0.0, STAMP)
    notes.step("friction", FrictionFollower(FrictionSettings()).take_rig, rig)
    notes.step("squeal", SquealDetector, rig.sample_rate, SquealSettings())


def _examine_cloud(data, notes):
    from squeal_rig.recording.gaps import SampleCount

    block = notes.step("samples_from_cdr", samples_from_cdr, data)
    notes.step("SampleCount", SampleCount().add, data)
    for channels in (DAQ_CHANNELS, TRUTH_CHANNELS, FRICTION_WINDOW_CHANNELS, FRICTION_SAMPLE_CHANNELS):
        notes.step("block_from_cdr", block_from_cdr, data, channels)
    if block is not None:
        _compare(data, block, notes)
    _follow(data, notes)


def _compare(data, block, notes):
    """What we take for samples, another reader of CDR takes for the same message."""
    try:
        other = TYPES.deserialize_cdr(data, "sensor_msgs/msg/PointCloud2")
    except Exception as error:
        if "size mismatch" in str(error):  # bytes behind a message are padding to us and to Fast CDR
            return
        notes.wrong(f"a PointCloud2 that rosbags cannot read ({type(error).__name__})")
        return
    stamp = other.header.stamp.sec * 10**9 + other.header.stamp.nanosec
    if (stamp, other.header.frame_id) != (block.stamp_ns, block.frame_id):
        notes.wrong("a PointCloud2 with another stamp or frame than rosbags reads")
    if len(block.samples) != other.height * other.width:
        notes.wrong("a PointCloud2 with another number of points than rosbags reads")
    elif len(block.samples):
        last = other.data[(other.height - 1) * other.row_step * (other.height > 1) :][
            (other.width - 1) * other.point_step :
        ]
        for field in other.fields:
            dtype = block.samples.dtype[field.name]
            expected = np.frombuffer(last.tobytes(), dtype, 1, field.offset)[0]
            if np.asarray(expected).tobytes() != np.asarray(block.samples[field.name][-1]).tobytes():
                notes.wrong("a PointCloud2 with other values than rosbags reads")


def _follow(data, notes):
    """Send a block through all that computes on blocks, as the nodes and offline estimation do."""
    from squeal_rig.estimation.friction_follower import FrictionFollower
    from squeal_rig.estimation.settings import FrictionSettings, SquealSettings
    from squeal_rig.estimation.squeal import SquealDetector
    from squeal_rig.estimation.stability_follower import Estimate, InForce, StabilityFollower

    rig = RigDescription.from_yaml(DESCRIPTION)
    friction, stability = FrictionFollower(FrictionSettings(window=0.01)), StabilityFollower()
    detector = SquealDetector(rig.sample_rate, SquealSettings(window=0.02, band_high=3000.0))
    friction.take_rig(rig)
    stability.take_rig(rig)

    def daq():
        stamp, _, samples = block_from_cdr(data, DAQ_CHANNELS)
        for _ in range(2):
            friction.take_block(stamp, samples)
            detector.add_samples(stamp, samples)
        stability.take_block(InForce.after(samples))

    def truth():
        friction.take_truth(block_from_cdr(data, TRUTH_CHANNELS).samples)

    def window():
        stability.take_estimate(Estimate.of(block_from_cdr(data, FRICTION_WINDOW_CHANNELS).samples[0]))

    notes.step("daq/samples", daq)
    notes.step("truth/samples", truth)
    notes.step("friction/windows", window)
    notes.step("summary", stability.summary, 1.0, STAMP)
