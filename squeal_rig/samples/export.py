"""Samples of a bag as files of other tools: Parquet, CSV, HDF5, WAV. One row a sample, in bounded memory."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from squeal_rig.configuration.new_files import new_file
from squeal_rig.errors import RecordingError, printable
from squeal_rig.recording import Bag
from squeal_rig.samples.blocks import DESCRIPTION, rig_topic, text_reader
from squeal_rig.samples.columns import STAMP, SampleColumns, sample_topics
from squeal_rig.samples.frames import arrow_schema, needed
from squeal_rig.samples.wav import write_wav

FORMATS = ("parquet", "csv", "hdf5", "wav")
_ENDINGS = {"parquet": ".parquet", "csv": ".csv", "hdf5": ".h5", "wav": ".wav"}
_WAV_COLUMNS = ("x", "y")


@dataclass(frozen=True)
class Exported:
    """One file written: where, of which topic, how many rows and bytes; `note` is what else the user should know."""

    path: Path
    topic: str
    rows: int
    size: int
    note: str = ""


def export_bag(
    source: str | Path,
    form: str,
    out: str | Path,
    topics: Sequence[str] = (),
    columns: Sequence[str] = (),
    force: bool = False,
) -> list[Exported]:
    """Write the samples of a bag's topics (all that carry samples; `daq/samples` for WAV) in a format of `FORMATS`.

    `out` is a folder, with one file a topic; or, where its name has the format's ending, the file of the one topic.
    HDF5 holds all topics in one file, a group each. Only with `force` a file is overwritten.

    Raises:
        RecordingError: format, topic or column is not known, a file exists, a package is missing, the bag is damaged.
    """
    if form not in FORMATS:
        raise RecordingError(f"The format is {form!r}; it must be one of {', '.join(FORMATS)}.")
    bag, out = Bag(source), Path(out)
    default = ["daq/samples"] if form == "wav" else sample_topics(bag)
    chosen = [SampleColumns(bag, topic, _columns_for(form, columns)) for topic in topics or default]
    if not chosen:
        raise RecordingError(f"{bag.path} has no topic with samples.")
    ending = _ENDINGS[form]
    if form == "hdf5":
        path = out if out.suffix in (ending, ".hdf5") else out / f"{bag.path.stem}{ending}"
        with new_file(path, force) as draft:
            return _write_hdf5(draft, path, chosen)
    if out.suffix == ending and len(chosen) > 1:
        raise RecordingError(f"{out} is one file, and there are {len(chosen)} topics: choose one, or give a folder.")
    write: Callable[[Path, SampleColumns], tuple[int, str]] = {
        "parquet": _write_parquet,
        "csv": _write_csv,
        "wav": _write_wav,
    }[form]
    paths = [out if out.suffix == ending else out / (_file_name(samples.topic) + ending) for samples in chosen]
    twice = next((path for path in paths if paths.count(path) > 1), None)
    if twice is not None:
        raise RecordingError(f"Several topics would be written to {twice}: choose one at a time.")
    exported = []
    for samples, path in zip(chosen, paths, strict=True):
        with new_file(path, force) as draft:
            rows, note = write(draft, samples)
            exported.append(Exported(path, samples.topic, rows, draft.stat().st_size, note))
    return exported


def _file_name(topic: str) -> str:
    return printable(topic.strip("/").replace("/", "_"))


def facts_of(samples: SampleColumns) -> dict[str, str]:
    """What a file should say about itself: topic, frame, the bag's provenance, the rig's descriptions, all as texts."""
    bag = samples.bag
    facts = {"topic": samples.topic, "frame_id": samples.frame_id, "bag": bag.path.name}
    facts["provenance"] = json.dumps(dict(bag.custom_data))
    topic = rig_topic(bag, DESCRIPTION)
    if topic is not None:
        read = text_reader(bag, topic)
        told = [{"log_time": m.log_time, "yaml": read(m.data)} for m in bag.messages([topic])]
        facts["descriptions"] = json.dumps(told)
    return facts


def _columns_for(form: str, columns: Sequence[str]) -> Sequence[str]:
    if form == "wav":
        return (*(columns or _WAV_COLUMNS), "seq")
    return (STAMP, *columns) if columns else ()


def _write_parquet(path: Path, samples: SampleColumns) -> tuple[int, str]:
    pa, pq = needed("pyarrow"), needed("pyarrow.parquet")
    schema = arrow_schema(samples).with_metadata(facts_of(samples))
    # Floats of a sensor repeat nothing; split by bytes their exponents and leading bits do.
    encodings = {info.name: "BYTE_STREAM_SPLIT" for info in samples.infos if info.dtype.kind == "f"}
    encodings |= {
        info.name: "DELTA_BINARY_PACKED" for info in samples.infos if info.dtype.str[1:] in ("u4", "i4", "i8")
    }
    rows = 0
    with pq.ParquetWriter(
        path, schema, compression="zstd", compression_level=1, use_dictionary=False, column_encoding=encodings
    ) as writer:
        for piece in samples.pieces():
            table = pa.table(piece, schema=schema)
            writer.write_table(table)
            rows += table.num_rows
    return rows, ""


def _write_csv(path: Path, samples: SampleColumns) -> tuple[int, str]:
    rows = 0
    with open(path, "w", encoding="utf-8", newline="") as stream:
        csv.writer(stream, lineterminator="\n").writerow([info.title for info in samples.infos])
        for piece in samples.pieces(1 << 14):
            # repr of a float is the shortest text that reads back bit for bit
            columns = [map(repr, piece[info.name].tolist()) for info in samples.infos]
            lines = list(map(",".join, zip(*columns, strict=True)))
            stream.write("\n".join(lines) + "\n")
            rows += len(lines)
    return rows, ""


def _write_hdf5(draft: Path, path: Path, chosen: Sequence[SampleColumns]) -> list[Exported]:
    h5py = needed("h5py")
    counts: list[int] = []
    with h5py.File(draft, "w") as file:
        for samples in chosen:
            group = _hdf5_group(file, samples)
            counts.append(_append_hdf5(group, samples))
    size = draft.stat().st_size
    return [Exported(path, samples.topic, rows, size) for samples, rows in zip(chosen, counts, strict=True)]


def _hdf5_group(file: Any, samples: SampleColumns) -> Any:
    """A group with an empty dataset for each column, and what the samples should say about themselves beside them."""
    odd = next((info.name for info in samples.infos if "/" in info.name or info.name in (".", "..")), None)
    if odd is not None:
        raise RecordingError(f"{samples.topic} has a column {odd!r}, which no dataset of HDF5 can be named.")
    try:
        group = file.create_group(samples.topic)
    except TypeError:  # h5py's, where the topic is named as another one's column
        raise RecordingError(f"{samples.topic} cannot be a group of HDF5: a column has its name.") from None
    for key, value in facts_of(samples).items():
        # an attribute ends at 64 kB; long texts are datasets beside the columns
        group.create_dataset(f"_{key}", data=value)
    for info in samples.infos:
        dataset = group.create_dataset(
            info.name, (0,), info.dtype, maxshape=(None,), chunks=(1 << 14,), compression="lzf", shuffle=True
        )
        dataset.attrs["unit"], dataset.attrs["description"] = info.unit, info.description
    return group


def _append_hdf5(group: Any, samples: SampleColumns) -> int:
    rows = 0
    for piece in samples.pieces():
        count = len(next(iter(piece.values())))
        for name, values in piece.items():
            group[name].resize((rows + count,))
            group[name][rows:] = values
        rows += count
    return rows


def _write_wav(path: Path, samples: SampleColumns) -> tuple[int, str]:
    rate = _sample_rate(samples)
    channels = [info for info in samples.infos if info.name != "seq"]

    def pieces() -> Any:
        for piece in samples.pieces():
            yield piece["seq"].astype(np.int64), np.column_stack([piece[info.name] for info in channels])

    return write_wav(path, rate, [(info.name, info.unit) for info in channels], pieces)


def _sample_rate(samples: SampleColumns) -> int:
    """The sampling rate [Hz] as the rig's description tells it."""
    told = json.loads(facts_of(samples).get("descriptions", "[]"))
    for entry in told:
        for line in entry["yaml"].splitlines():
            key, _, value = line.partition(":")
            if key == "sample_rate":
                return int(value)
    raise RecordingError(f"{samples.bag.path} has no rig/description: the sampling rate is not known.")
