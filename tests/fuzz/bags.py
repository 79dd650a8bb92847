"""Bags: damaged, with records that lie, crafted; in the hands of every command and every reader of bags.

Two things hold of whatever `verify` calls sound. Its messages are what was written, where the bag came from us and was
only damaged. And whoever reads it along its index, we or `mcap`, gets what is there from front to back.
"""

import dataclasses
import functools
import io
import pickle
import shutil
import struct
import zlib
from collections import Counter
from pathlib import Path

import lz4.frame
import zstandard
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import AttachmentIndex, Channel, ChunkIndex, Message, MetadataIndex
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, IndexType, Writer

from squeal_rig.errors import RecordingError
from squeal_rig.instruments.acquisition import Acquisition
from squeal_rig.instruments.description import RigDescription
from squeal_rig.instruments.settings import RigSettings
from squeal_rig.instruments.virtual import VirtualRig
from squeal_rig.recording import Bag, BagWriter, QosProfile, as_mapping, cdr_from_samples, decoder_of, qos_to_yaml
from squeal_rig.recording.records import FOOTER, HEAD, MAGIC, iter_records, record_bytes
from squeal_rig.recording.rewrite import merge
from tests.messages import schema_of

from . import Case
from .bounded import Notes, command
from .records import DESCRIPTION, STOCK, definitions, heavy_clouds, messages_of, string_cdr
from .yaml_files import ODD_VALUES, bombs, encoded, odd_texts

START = 1_700_000_000 * 10**9
OURS = ("zstd", "plain", "split")
#: Damage to these shows: every message has a checksum, and is listed under one.
PROTECTED = (*OURS, "lz4")
ODD_TOPICS = (
    *("/daq/samples", "/daq/samples", "/rig/description", "/truth/samples", "/squeal/state", "/stability/summary"),
    *("/friction/windows", "/x", "", "/", "x", "//", "/../../x", "/a b", "/[/x]", "/\x1b[31m", "/\0", "/" + "t" * 5000),
    *("/stamp", "/."),
)
ODD_TIMES = (START, START, START + 10**7, START + 10**8, 0, 1, 2**63 - 1, 2**63, 2**64 - 1)
_NUMBERS = (0, 1, 2, 9, 255, 2**16 - 1, 2**31, 2**32 - 1, 2**40, 2**63 - 1, 2**63, 2**64 - 1)
_BOMB = 3 << 30


# --- what the inputs are made from


def _write_rig(folder, **options):
    """A bag of half a second of the rig, in squeal, as our recorder writes it."""
    rig = RigDescription.from_yaml(DESCRIPTION)
    p = rig.parameters.replace(preload=300.0)
    acquisition = Acquisition(VirtualRig(), p, RigSettings(sample_rate=6400))
    acquisition.start(START)
    acquisition.impact()
    string, cloud = schema_of("std_msgs/msg/String"), schema_of("sensor_msgs/msg/PointCloud2")
    latched = QosProfile(depth=1, durability="transient_local")
    with BagWriter(folder, **options) as writer:
        handles = {
            name: writer.add_topic(f"/{name}", schema.type_name, [profile], schema)
            for name, schema, profile in (
                ("rig/description", string, latched),
                ("daq/samples", cloud, QosProfile(depth=100)),
                ("truth/samples", cloud, QosProfile(depth=100)),
            )
        }
        text = dataclasses.replace(rig, parameters=p).to_yaml()
        writer.write(handles["rig/description"], string_cdr(text), START, START)
        for _ in range(50):
            block = acquisition.next_block()
            for name, samples in (("daq/samples", block.daq), ("truth/samples", block.truth)):
                writer.write(handles[name], cdr_from_samples(samples, block.stamp), block.stamp, block.stamp)
        writer.add_metadata("parameters", {"node": "/rig", "time_ns": str(START), "values": "preload: 300.0\n"})
        writer.add_metadata(
            "parameters", {"node": "/friction_estimator", "time_ns": str(START), "values": "window: 0.1\n"}
        )
    acquisition.close()


def _write_foreign(path, bag, **options):
    """The messages of a bag as another recorder would write them."""
    with open(path, "wb") as stream:
        writer = Writer(stream, chunk_size=16384, **options)
        writer.start("ros2", "another recorder")
        channels = {}
        for name, topic in bag.topics.items():
            schema = writer.register_schema(topic.type_name, "ros2msg", topic.schema.text.encode())
            metadata = {"offered_qos_profiles": qos_to_yaml(topic.qos)}
            channels[name] = writer.register_channel(name, "cdr", schema, metadata)
        for m in bag.messages():
            writer.add_message(channels[m.topic], m.log_time, m.data, m.publish_time, m.sequence)
        writer.add_attachment(START, START, "note.txt", "text/plain", b"a note")
        writer.finish()


def make_corpus(folder):
    """Whole bags of our recorder and of others, and what is in each; the rig's with estimates computed from it."""
    from squeal_rig.analysis.estimate import estimate_bag

    _write_rig(folder / "rig", chunk_size=32768)
    estimate_bag(folder / "rig", folder / "estimated")
    merge([folder / "rig", folder / "estimated"], folder / "zstd")
    for name in ("rig", "estimated"):
        shutil.rmtree(folder / name)
    _write_rig(folder / "plain", chunk_size=8192, compression="none")
    _write_rig(folder / "split", chunk_size=16384, max_file_size=60_000)
    bag = Bag(folder / "plain")
    for name, options in (
        ("lz4", {"compression": CompressionType.LZ4, "enable_crcs": True}),
        ("loose", {"use_chunking": False}),
        ("bare", {"compression": CompressionType.NONE, "index_types": IndexType.NONE, "enable_crcs": False}),
    ):
        (folder / name).mkdir()
        _write_foreign(folder / name / f"{name}_0.mcap", bag, **options)
    for path in list(folder.iterdir()):
        (folder / f"{path.name}.messages").write_bytes(pickle.dumps(_read(path)))


def _read(path):
    """All messages of a bag as we read them."""
    return [tuple(m) for m in Bag(path).messages()]


@functools.cache
def _files_of(folder):
    return {path.name: path.read_bytes() for path in sorted(Path(folder).iterdir())}


# --- damage to bytes


@st.composite
def damaged(draw, data):
    """The bytes of a file, a few of them changed, gone, doubled or moved."""
    out = bytearray(data)
    for _ in range(draw(st.integers(1, 3))):
        how = draw(st.sampled_from(("flip", "flip", "number", "cut", "drop", "double", "zero", "insert", "swap")))
        where = st.one_of(
            st.integers(0, max(len(out) - 1, 0)), st.integers(max(len(out) - 3000, 0), max(len(out) - 1, 0))
        )
        at, size = draw(where), draw(st.sampled_from((1, 8, 100, 4096)))
        if how == "flip" and out:
            out[at] ^= 1 << draw(st.integers(0, 7))
        elif how == "number":
            number = struct.pack("<Q", draw(st.sampled_from(_NUMBERS)))[: draw(st.sampled_from((2, 4, 8)))]
            out[at : at + len(number)] = number
        elif how == "cut":
            del out[at:]
        elif how == "drop":
            del out[at : at + size]
        elif how == "double":
            out[at:at] = out[at : at + size]
        elif how == "zero":
            out[at : at + size] = bytes(len(out[at : at + size]))
        elif how == "insert":
            out[at:at] = draw(st.binary(min_size=1, max_size=20))
        else:
            other = draw(where)
            piece = out[at : at + size]
            out[at : at + size] = out[other : other + size]
            out[other : other + size] = piece
    return bytes(out)


# --- records that lie


@dataclasses.dataclass
class Record:
    """One record of a file."""

    opcode: int
    body: bytes
    place: int | None = None  # in the file it came from


def _records(data, start=0, end=None):
    return [
        Record(opcode, data[first:last], first - HEAD.size) for opcode, first, last in iter_records(data, start, end)
    ]


def records_in(data):
    """The records of a whole file."""
    return _records(data, len(MAGIC), len(data) - len(MAGIC))


def _joined(records):
    return b"".join(HEAD.pack(record.opcode, len(record.body)) + record.body for record in records)


@st.composite
def _changed(draw, records, inner=False):
    """Records with one of them changed, gone, doubled or moved, of every kind as often."""
    kinds = sorted({record.opcode for record in records})
    kind = draw(st.sampled_from(kinds))
    places = [place for place, record in enumerate(records) if record.opcode == kind]
    at = draw(st.sampled_from((*places[:3], *places[-3:], places[len(places) // 2])))
    record, out = records[at], list(records)
    how = draw(st.sampled_from(("number", "number", "number", "drop", "double", "move", "kind", "body")))
    if how == "number" and record.body:
        limit = min(len(record.body), 64) - 1
        place = draw(st.one_of(st.integers(0, limit), st.integers(0, len(record.body) - 1)))
        number = struct.pack("<Q", draw(st.sampled_from(_NUMBERS)))[: draw(st.sampled_from((1, 2, 4, 8)))]
        body = record.body[:place] + number + record.body[place + len(number) :]
        out[at] = dataclasses.replace(record, body=body)
    elif how == "drop":
        del out[at]
    elif how == "double":
        out.insert(draw(st.integers(0, len(out))), dataclasses.replace(record, place=None))
    elif how == "move":
        out.insert(draw(st.integers(0, len(out) - 1)), out.pop(at))
    elif how == "kind":
        out[at] = dataclasses.replace(record, opcode=draw(st.integers(0, 255)))
    elif inner and record.opcode == Opcode.MESSAGE:
        body = record.body[:22] + draw(messages_of(draw(st.sampled_from(STOCK))))
        out[at] = dataclasses.replace(record, body=body)
    return out


@st.composite
def _changed_chunk(draw, record):
    """A chunk with other records in it, and a checksum that fits."""
    head = struct.Struct("<QQQI")
    start, end, size, _ = head.unpack_from(record.body)
    length = struct.unpack_from("<I", record.body, head.size)[0]
    name = record.body[head.size + 4 : head.size + 4 + length]
    packed = record.body[head.size + 12 + length :]
    raw = (
        packed if not name else zstandard.decompress(packed, size) if name == b"zstd" else lz4.frame.decompress(packed)
    )
    records = _records(raw)
    for _ in range(draw(st.integers(1, 2))):
        records = draw(_changed(records, inner=True)) if records else records
    return dataclasses.replace(record, body=_chunk(_joined(records), name, start, end))


def _chunk(raw, name, start, end, crc=True):
    packed = raw if not name else zstandard.compress(raw, 1) if name == b"zstd" else lz4.frame.compress(raw)
    body = struct.pack("<QQQI", start, end, len(raw), zlib.crc32(raw) if crc else 0)
    return body + struct.pack("<I", len(name)) + name + struct.pack("<Q", len(packed)) + packed


def rebuilt(records, relocate):
    """A file of these records, its footer and checksum right; its indexes too where they are relocated."""
    moved, lengths, at = {}, {}, len(MAGIC)
    for record in records:
        if record.place is not None:
            moved.setdefault(record.place, at)
            lengths.setdefault(record.place, HEAD.size + len(record.body))
        at += HEAD.size + len(record.body)
    summary = offsets = 0
    out, ended = bytearray(MAGIC), False
    for record in records:
        if ended and not summary and record.opcode != Opcode.FOOTER:
            summary = len(out)
        if not offsets and record.opcode == Opcode.SUMMARY_OFFSET:
            offsets = len(out)
        ended = ended or record.opcode == Opcode.DATA_END
        body = _relocated(record, moved, lengths) if relocate else record.body
        if record.opcode == Opcode.FOOTER and len(body) == FOOTER.size:
            body = FOOTER.pack(summary, offsets, 0)[:-4]
            checked = bytes(out[summary:]) + HEAD.pack(record.opcode, FOOTER.size) + body
            body += struct.pack("<I", zlib.crc32(checked) if summary else 0)
        out += HEAD.pack(record.opcode, len(body)) + body
    return bytes(out) + MAGIC


def _relocated(record, moved, lengths):
    kinds = {
        Opcode.CHUNK_INDEX: ChunkIndex,
        Opcode.METADATA_INDEX: MetadataIndex,
        Opcode.ATTACHMENT_INDEX: AttachmentIndex,
    }
    kind = kinds.get(record.opcode)
    if kind is None:
        return record.body
    from mcap.data_stream import ReadDataStream

    try:
        index = kind.read(ReadDataStream(io.BytesIO(record.body)))
        if isinstance(index, ChunkIndex):
            old = index.chunk_start_offset
            offsets = {key: moved.get(place, place) for key, place in index.message_index_offsets.items()}
            index = dataclasses.replace(
                index,
                chunk_start_offset=moved.get(old, old),
                chunk_length=lengths.get(old, index.chunk_length),
                message_index_offsets=offsets,
            )
        else:
            index = dataclasses.replace(index, offset=moved.get(index.offset, index.offset))
        return record_bytes(index)[HEAD.size :]
    except Exception:  # it was changed into what mcap cannot read or write
        return record.body


@st.composite
def lying(draw, data):
    """A file whose records were changed and whose checksums were made to fit."""
    records = records_in(data)
    for _ in range(draw(st.integers(1, 2))):
        chunks = [at for at, record in enumerate(records) if record.opcode == Opcode.CHUNK]
        if chunks and draw(st.integers(0, 2)) == 0:
            at = draw(st.sampled_from(chunks))
            try:
                records[at] = draw(_changed_chunk(records[at]))
            except (struct.error, RecordingError, zstandard.ZstdError, RuntimeError, ValueError):
                pass  # it was changed before
        else:
            records = draw(_changed(records))
    return rebuilt(records, draw(st.booleans()))


# --- bags that nobody recorded


@st.composite
def crafted(draw):
    """A whole file by mcap's own writer: names, definitions, times and payloads as nobody has them."""
    stream = io.BytesIO()
    compression = draw(st.sampled_from((CompressionType.NONE, CompressionType.ZSTD, CompressionType.LZ4)))
    writer = Writer(
        stream,
        chunk_size=draw(st.sampled_from((1, 1000, 1 << 20))),
        compression=compression,
        use_chunking=draw(st.integers(0, 3)) > 0,
        use_statistics=draw(st.integers(0, 5)) > 0,
        repeat_channels=draw(st.integers(0, 5)) > 0,
        enable_crcs=draw(st.booleans()),
    )
    writer.start(
        draw(st.sampled_from(("ros2", "", "\x1b[31m"))), draw(st.sampled_from(("another", "squeal_rig 0.1.0", "")))
    )
    channels = [draw(_channels(writer)) for _ in range(draw(st.integers(1, 4)))]
    for sequence in range(draw(st.integers(0, 12))):
        channel, type_name = draw(st.sampled_from(channels))
        payload = draw(messages_of(type_name if type_name in STOCK else draw(st.sampled_from(STOCK))))
        number = draw(st.sampled_from((sequence, sequence, 0, 2**32 - 1)))
        writer.add_message(channel, draw(st.sampled_from(ODD_TIMES)), payload, draw(st.sampled_from(ODD_TIMES)), number)
    for name in draw(
        st.lists(
            st.sampled_from(("rosbag2", "parameters", "parameter_change", "provenance", "snapshot", "x")), max_size=3
        )
    ):
        keys = st.sampled_from(
            ("serialized_metadata", "node", "time_ns", "values", "ending", "seconds", "reason", "crc32")
        )
        values = st.one_of(
            st.sampled_from(ODD_VALUES), odd_texts("custom_data:\n  ending: complete\n  lost_messages: 0")
        )
        metadata = draw(st.dictionaries(keys, values, max_size=4))
        writer.add_metadata(name, {key: value.encode("utf-8", "replace").decode() for key, value in metadata.items()})
    if draw(st.integers(0, 5)) == 0:
        writer.add_attachment(0, 0, "../x", "\0", draw(st.binary(max_size=100)))
    writer.finish()
    return stream.getvalue()


@st.composite
def _channels(draw, writer):
    type_name, text = draw(definitions())
    if draw(st.integers(0, 2)):
        type_name = draw(st.sampled_from(STOCK))
        text = schema_of(type_name).text
    encoding = draw(st.sampled_from(("ros2msg", "ros2msg", "ros2msg", "ros2idl", "", "protobuf")))
    schema = writer.register_schema(type_name, encoding, encoded(text))
    qos = draw(
        st.one_of(
            st.just(qos_to_yaml([QosProfile()])), odd_texts(qos_to_yaml([QosProfile()])), st.sampled_from(ODD_VALUES)
        )
    )
    metadata = {"offered_qos_profiles": qos.encode("utf-8", "replace").decode()}
    topic, serialization = draw(st.sampled_from(ODD_TOPICS)), draw(st.sampled_from(("cdr", "cdr", "cdr", "json", "")))
    return writer.register_channel(topic, serialization, schema, metadata), type_name


def _bag_of(channels=((1, "/x"),), schemas=(), messages=(), chunk=None):
    """A file of one chunk by mcap's writer, or with a chunk of these bytes in its place."""
    stream = io.BytesIO()
    writer = Writer(stream, compression=CompressionType.NONE)
    writer.start("ros2", "another recorder")
    for type_name, text in schemas or (("std_msgs/msg/String", schema_of("std_msgs/msg/String").text),):
        writer.register_schema(type_name, "ros2msg", text.encode())
    for schema, topic in channels:
        writer.register_channel(topic, "cdr", schema)
    for channel, data in messages:
        writer.add_message(channel, START, data, START)
    writer.finish()
    data = stream.getvalue()
    if chunk is None:
        return data
    records = records_in(data)
    records = [dataclasses.replace(r, body=chunk) if r.opcode == Opcode.CHUNK else r for r in records]
    return rebuilt(records, relocate=True)


@functools.cache
def _zeros(compression):
    """Gigabytes of zeros, packed."""
    compressor = (
        zstandard.ZstdCompressor(level=1).compressobj() if compression == "zstd" else lz4.frame.LZ4FrameCompressor()
    )
    parts = [compressor.begin()] if compression == "lz4" else []
    zeros = bytes(1 << 24)
    parts += [compressor.compress(zeros) for _ in range(_BOMB >> 24)]
    return b"".join([*parts, compressor.flush()])


def _zero_bomb(compression, claimed):
    packed = _zeros(compression)
    head = struct.pack("<QQQII", START, START, claimed, 0, len(compression)) + compression.encode()
    return _bag_of(messages=[(1, string_cdr("x"))], chunk=head + struct.pack("<Q", len(packed)) + packed)


def _many_channels():
    return _bag_of([(1, f"/t{number}") for number in range(65_535)], messages=[(1, string_cdr("x"))])


def _many_schemas():
    names = [f"a/msg/B{number}" for number in range(9000)]
    return _bag_of(
        [(n + 1, f"/t{n}") for n in range(9000)], [(name, "string x") for name in names], [(1, string_cdr("x"))]
    )


def _wide_schema():
    wide = "\n".join(f"float64 f{number}" for number in range(100_000))
    return _bag_of(schemas=[("a/msg/B", wide)], messages=[(1, string_cdr("x"))])


def _heavy_cloud(name):
    cloud = ("sensor_msgs/msg/PointCloud2", schema_of("sensor_msgs/msg/PointCloud2").text)
    return _bag_of([(1, "/daq/samples")], [cloud], [(1, heavy_clouds()[name])] * 5)


#: Files that stand for far more than their bytes, by name.
BOMBS = {
    **{
        f"{name} {size}": functools.partial(_zero_bomb, name, size)
        for name in ("zstd", "lz4")
        for size in (_BOMB, 1 << 30, 1000)
    },
    "many_channels": _many_channels,
    "many_schemas": _many_schemas,
    "wide_schema": _wide_schema,
    **{name: functools.partial(_heavy_cloud, name) for name in ("many_fields", "wide_field")},
}


# --- the class


def _bomb_case(make, facts):
    return Case({"bag_0.mcap": make()}, facts)


def made(corpus):
    """Bags that stand for more than they hold, and folders that are none."""
    for name, make in BOMBS.items():
        for readers in ("verify, info", "recover, cut, merge", "export csv, estimate", "analyse, read_array, decode"):
            yield functools.partial(_bomb_case, make, {"readers": readers, "made": name})
    whole = _files_of(corpus / "plain")
    for name, text in bombs().items():
        yield Case({**whole, "metadata.yaml": encoded(text)}, {"readers": "verify, info, cut", "made": name})
    for name in (*OURS, "lz4", "loose", "bare"):
        facts = {"readers": ", ".join(READERS), "of": name, "whole": "yes"}
        yield Case(dict(_files_of(corpus / name)), facts)


@st.composite
def cases(draw, corpus):
    """One bag, and three of the commands that it is given to after `verify` and `recover`."""
    readers = draw(
        st.lists(
            st.sampled_from([name for name in READERS if name not in ("verify", "recover")]),
            min_size=3,
            max_size=3,
            unique=True,
        )
    )
    facts = {"readers": ", ".join(("verify", "recover", *readers))}
    how = draw(st.sampled_from(("damaged", "damaged", "lying", "lying", "metadata", "crafted", "crafted")))
    if how == "crafted":
        files = {"bag_0.mcap": draw(crafted())}
        if draw(st.integers(0, 9)) == 0:
            files["bag_1.mcap"] = draw(crafted())
        return Case(files, facts)
    name = draw(st.sampled_from(OURS if how == "metadata" else (*OURS, "lz4", "loose", "bare")))
    files = dict(_files_of(corpus / name))
    if how == "metadata":
        files["metadata.yaml"] = encoded(draw(odd_texts(files["metadata.yaml"].decode())))
    else:
        chosen = draw(st.sampled_from(sorted(file for file in files if file.endswith(".mcap"))))
        files[chosen] = draw((damaged if how == "damaged" else lying)(files[chosen]))
        if draw(st.integers(0, 9)) == 0:
            files.pop(draw(st.sampled_from(sorted(files))))
        if draw(st.integers(0, 3)) == 0:
            files.pop("metadata.yaml", None)
    if how != "lying":
        facts["of"] = name
    return Case(files, facts)


_EXPECTED = {}


def prepare(corpus):
    """Know what was written, and try a whole bag: that compiles and imports what is needed."""
    for path in corpus.glob("*.messages"):
        _EXPECTED[path.stem] = pickle.loads(path.read_bytes())
    _EXPECTED["good"] = corpus / "plain"
    notes = Notes(lambda _: None)
    facts = {"readers": ", ".join(READERS), "of": "zstd", "whole": "yes"}
    examine(Case(dict(_files_of(corpus / "zstd")), facts), notes)
    assert not notes.found, notes.found


def examine(case, notes):
    """Give the bag to the commands, and hold what they say of it against what is in it."""
    for name in ("bag", "out"):
        shutil.rmtree(name, ignore_errors=True)
    Path("bag").mkdir()
    Path("out").mkdir()
    for name, data in case.files.items():
        Path("bag", name).write_bytes(data)
    expected = _EXPECTED.get(case.facts.get("of"))
    for name in case.facts["readers"].split(", "):
        READERS[name](notes, expected if case.facts.get("of") in PROTECTED else None)
    if "whole" in case.facts and notes.step("verify", command, "bag", "verify", "bag") != 0:
        notes.wrong("a whole bag, unsound")


def _verify(notes, expected):
    code = notes.step("verify", command, "bag", "verify", "bag")
    if code != 0:
        return
    read = notes.step("messages", _read, Path("bag"))
    if read is None:
        notes.wrong("verify says sound of a bag that cannot be read")
        return
    if expected is not None and Counter(_sent(read)) != Counter(_sent(expected)):
        notes.wrong("verify says sound of a damaged bag whose messages are not what was written")
    files = Bag("bag").files
    for name, others in (("from front to back", _linear), ("along its index", _indexed)):
        try:
            there = [message for file in files for message in others(file)]
        except Exception as error:
            notes.wrong(f"verify says sound of a bag that mcap cannot read {name}: {type(error).__name__}")
        else:
            if Counter(read) != Counter(there):
                notes.wrong(f"verify says sound of a bag that holds other messages {name}")


def _sent(messages):
    return [(m[0], m[1], m[2], m[3]) for m in messages]


def _linear(file):
    """All messages of a file as mcap comes upon them."""
    channels = {}
    with open(file, "rb") as stream:
        for record in StreamReader(stream, validate_crcs=True).records:
            if isinstance(record, Channel):
                channels[record.id] = record
            elif isinstance(record, Message):
                channel = channels[record.channel_id]
                yield channel.topic, record.data, record.log_time, record.publish_time, record.sequence


def _indexed(file):
    with open(file, "rb") as stream:
        for _, channel, m in make_reader(stream, validate_crcs=True).iter_messages():
            yield channel.topic, m.data, m.log_time, m.publish_time, m.sequence


def _recover(notes, expected):
    code = notes.step("recover", command, "bag", "recover", "bag", "out/recovered")
    if code is None or not Path("out/recovered").exists():
        return
    saved = notes.step("recovered messages", _read, Path("out/recovered"))
    if saved is None:
        notes.wrong("recover wrote a bag that cannot be read")
        return
    if expected is None:
        return
    more = Counter(_sent(saved)) - Counter(_sent(expected))
    if more:
        notes.wrong("recover saved messages that were not written")
    if code == 0 and Counter(_sent(saved)) != Counter(_sent(expected)):
        notes.wrong("recover says that nothing is missing, and messages are")


def _cut(notes, _expected):
    if notes.step("cut", command, "bag", "cut", "bag", "out/cut") is None:
        return
    if _by_topic(notes, "bag") != _by_topic(notes, "out/cut"):
        notes.wrong("cut copied other messages than those there are")


def _merge(notes, _expected):
    good = _EXPECTED["good"]
    if notes.step("merge", command, "bag", "merge", "bag", good, "out/merged") is None:
        return
    both = _by_topic(notes, "bag")
    other = _by_topic(notes, good)
    if both is not None and both + other != _by_topic(notes, "out/merged"):
        notes.wrong("merge wrote other messages than those there are, or they decode otherwise")


def _by_topic(notes, path):
    """Messages of a bag with their content as the bag itself defines it, counted."""

    def read():
        bag, decoders, found = Bag(path), {}, Counter()
        for name, topic in bag.topics.items():
            try:
                decoders[name] = decoder_of(topic.schema)
            except RecordingError:
                decoders[name] = lambda data: data
        for m in bag.messages():
            try:
                content = repr(as_mapping(decoders[m.topic](m.data)))
            except RecordingError:
                content = repr(m.data)
            found[m.topic, m.log_time, m.publish_time, content] += 1
        return found

    return notes.step(f"messages of {'a bag' if path == 'bag' else 'what was written'}", read)


def _decode(notes, _expected):
    _by_topic(notes, "bag")


def _frames(notes, _expected):
    from squeal_rig.samples.frames import read_array, read_frame, read_table

    for read in (read_array, read_table, read_frame):
        notes.step(read.__name__, read, "bag")
        notes.step(read.__name__, read, "bag", "daq/samples", ["x"], 0.0, 0.1)


def _replay(notes, _expected):
    """What the player does before it speaks ROS."""
    from squeal_rig.recording.replay import last_before, matching_topics, remapped

    def run():
        bag = Bag("bag")
        topics = matching_topics(bag.topics, ["*", "daq/*"])
        remapped(topics, ["/daq/:=/again/"])
        last_before(bag, topics, bag.end_time)

    notes.step("replay", run)


def _runs(name, *words):
    def run(notes, _expected):
        notes.step(name, command, *words)

    return run


#: Everything that reads a bag; all are called with the notes and what was written, None where that is not known.
READERS = {
    "verify": _verify,
    "recover": _recover,
    "info": _runs("info", "info", "bag"),
    "info --quick": _runs("info --quick", "info", "--quick", "bag"),
    "cut": _cut,
    "merge": _merge,
    **{
        f"export {to}": _runs(f"export {to}", "bag", "export", "bag", f"out/{to}", "--to", to)
        for to in ("csv", "parquet", "hdf5", "wav")
    },
    "estimate": _runs("estimate", "bag", "estimate", "bag", "out/estimated"),
    "analyse": _runs("analyse", "analyse", "bag", "--picture", "out/picture.png"),
    "read_array": _frames,
    "decode": _decode,
    "replay": _replay,
}
