"""Samples of a bag as columns, one row a sample, in pieces of bounded size: what every export and reader is made of."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from squeal_rig.errors import RecordingError
from squeal_rig.instruments.channels import (
    DAQ_CHANNELS,
    FRICTION_SAMPLE_CHANNELS,
    FRICTION_WINDOW_CHANNELS,
    TRUTH_CHANNELS,
)
from squeal_rig.recording import Bag, samples_from_cdr
from squeal_rig.recording.gaps import CLOUD_TYPE

_TABLES = {
    "daq/samples": DAQ_CHANNELS,
    "truth/samples": TRUTH_CHANNELS,
    "friction/samples": FRICTION_SAMPLE_CHANNELS,
    "friction/windows": FRICTION_WINDOW_CHANNELS,
}
#: The first column: stamp of the sample's block.
STAMP = "stamp"
PIECE_ROWS = 1 << 17
_MAX_COLUMNS = 2048

Column = NDArray[Any]
Columns = dict[str, Column]


@dataclass(frozen=True)
class ColumnInfo:
    """Name, numpy type, unit and meaning of a column."""

    name: str
    dtype: np.dtype[Any]
    unit: str = ""
    description: str = ""

    @property
    def title(self) -> str:
        """Name with its unit, for the head of a table."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name


def sample_topics(bag: Bag) -> list[str]:
    """Topics of a bag that carry samples, the ones without a message left out."""
    return [name for name, topic in bag.topics.items() if topic.type_name == CLOUD_TYPE and topic.message_count]


def one_topic(bag: Bag, wanted: str) -> str:
    """The bag's topic of samples of an absolute name, or of a relative one in whatever namespace.

    Raises:
        RecordingError: there is none, or more than one.
    """
    topics = sample_topics(bag)
    found = [name for name in topics if name == wanted or name.endswith("/" + wanted)]
    if len(found) != 1:
        raise RecordingError(
            f"{bag.path} has {len(found)} topics of samples {wanted!r}; it has {', '.join(topics) or 'none at all'}."
        )
    return found[0]


class SampleColumns:
    """The samples of one topic, `columns` of it or all, from start to end [s after the bag's first message].

    `infos` describe the columns in order: `stamp` [ns], then the fields. A field of several values is several columns.

    Raises:
        RecordingError: no such column, no samples, or (while iterating) a message is damaged or of another layout.
    """

    def __init__(
        self,
        bag: Bag,
        topic: str,
        columns: Sequence[str] = (),
        start: float | None = None,
        end: float | None = None,
    ) -> None:
        self.bag, self.topic = bag, one_topic(bag, topic)
        self._start = None if start is None else bag.start_time + round(start * 1e9)
        self._end = None if end is None else bag.start_time + round(end * 1e9)
        first = next(bag.messages([self.topic], self._start, self._end), None)
        if first is None:
            raise RecordingError(f"{bag.path} has no samples on {self.topic} in that time.")
        block = samples_from_cdr(first.data)
        self.frame_id = block.frame_id
        self._dtype = block.samples.dtype
        every = [ColumnInfo(STAMP, np.dtype(np.int64), "ns", "stamp of the block: time of its first sample")]
        every += _infos(self.topic, self._dtype)
        names = [info.name for info in every]
        if len(names) > _MAX_COLUMNS:
            raise RecordingError(f"{self.topic} has {len(names)} columns; at most {_MAX_COLUMNS} are taken.")
        if len(set(names)) < len(names):
            twice = next(name for name in names if names.count(name) > 1)
            raise RecordingError(f"{self.topic} would have two columns {twice!r}.")
        missing = [name for name in columns if name not in names]
        if missing:
            raise RecordingError(f"{self.topic} has no column {missing[0]!r}; it has {', '.join(names)}.")
        self.infos = [info for info in every if not columns or info.name in columns]

    def pieces(self, rows: int = PIECE_ROWS) -> Iterator[Columns]:
        """Yield the columns in pieces of about so many rows."""
        blocks: list[tuple[int, Column]] = []
        count = 0
        for message in self.bag.messages([self.topic], self._start, self._end):
            stamp, _, samples = samples_from_cdr(message.data)
            if samples.dtype != self._dtype:
                raise RecordingError(f"{self.bag.path}: the fields of {self.topic} change within the bag.")
            blocks.append((stamp, samples))
            count += len(samples)
            if count >= rows:
                yield self._joined(blocks)
                blocks, count = [], 0
        if count:
            yield self._joined(blocks)

    def whole(self) -> Columns:
        """All rows at once."""
        pieces = list(self.pieces())
        return {info.name: np.concatenate([piece[info.name] for piece in pieces]) for info in self.infos}

    def _joined(self, blocks: list[tuple[int, Column]]) -> Columns:
        joined: Columns = {}
        for info in self.infos:
            if info.name == STAMP:
                stamps = np.array([stamp for stamp, _ in blocks], np.int64)
                joined[STAMP] = np.repeat(stamps, [len(samples) for _, samples in blocks])
            else:
                joined[info.name] = np.concatenate([_values(samples, info.name) for _, samples in blocks])
        return joined


def _infos(topic: str, dtype: np.dtype[Any]) -> list[ColumnInfo]:
    table = next((channels for name, channels in _TABLES.items() if topic.endswith("/" + name)), ())
    known = {channel.name: channel for channel in table}
    infos = []
    for name in dtype.names or ():
        part = dtype.fields[name][0]  # type: ignore[index]  # there are names, so there are fields
        channel = known.get(name)
        unit, text = (channel.unit, channel.description) if channel is not None else ("", "")
        native = part.base.newbyteorder("=")
        names = [name] if not part.shape else [f"{name}_{number}" for number in range(part.shape[0])]
        infos += [ColumnInfo(column, native, unit, text) for column in names]
    return infos


def _values(samples: Column, name: str) -> Column:
    if name in (samples.dtype.names or ()):
        return samples[name]
    field, _, number = name.rpartition("_")
    return np.asarray(samples[field][:, int(number)])
