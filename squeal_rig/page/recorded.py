"""A bag on the page: what it shows at any of its times, read as it is asked for."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from squeal_rig.errors import RecordingError, SquealRigError
from squeal_rig.instruments.channels import DAQ_CHANNELS, FRICTION_WINDOW_NEEDED, block_from_cdr
from squeal_rig.instruments.description import RigDescription
from squeal_rig.page.packing import packed
from squeal_rig.page.picture import COLUMN_LINES, COLUMNS_PER_SECOND, TREND, Picture, column
from squeal_rig.recording import Bag, RawMessage, decoder_of
from squeal_rig.recording.messages import statuses
from squeal_rig.samples.blocks import DAQ, DESCRIPTION, rig_topic, text_reader

_WINDOW = 0.25  # a time shows the samples of so long before it [s]
# Columns of a spectrogram read at one asking: each costs a chunk of the bag.
_MOST_COLUMNS = 60
_OTHERS = {
    "squeal": "squeal/state",
    "stability": "stability/summary",
    "windows": "friction/windows",
    "run": "run/events",
}


class RecordedPicture:
    """Fills a `Picture` from a bag.

    Raises:
        RecordingError: it is no bag of the rig.
    """

    def __init__(self, path: Path) -> None:
        self.bag = Bag(path)
        samples, description = rig_topic(self.bag, DAQ), rig_topic(self.bag, DESCRIPTION)
        if samples is None or description is None:
            raise RecordingError(f"{path} has no samples of the rig with its description")
        self._samples, self._description = samples, description
        self._text = text_reader(self.bag, description)
        self._others = {what: topic for what, name in _OTHERS.items() if (topic := rig_topic(self.bag, name))}
        self._decoders = {
            what: decoder_of(self.bag.topics[topic].schema) for what, topic in self._others.items() if what != "windows"
        }
        self._analysed: RawMessage | None = None  # the last analysis that was looked for
        self._time = 0.0  # of what is being taken, and then of what is shown [s since the epoch]
        self.picture = Picture(False, path.name, self.bag.duration, clock=lambda: self._time)
        self._columns: dict[int, NDArray[np.uint8]] = {}
        self._repeat = math.ceil(self.picture.trend * COLUMNS_PER_SECOND / _MOST_COLUMNS)  # of each column that is read
        # Told once, mostly before the first sample: kept from the beginning of the bag on.
        wanted = [description, *([self._others["run"]] if "run" in self._others else [])]
        self._latched = [(m.log_time, m.topic, m.data) for m in self.bag.messages(wanted)]

    def at(self, time: float) -> list[bytes]:
        """The messages for a time [s after the bag's first message]; without anything where it cannot be read."""
        time = min(time, self.bag.duration)
        now = self.bag.start_time + round(time * 1e9)
        self.picture.forget()
        try:
            frame, trouble = self._read(now), ""
        except SquealRigError as error:
            frame, trouble = None, str(error)
        except (TypeError, ValueError) as error:  # a message that is not what its topic is for
            frame, trouble = None, f"what was recorded here cannot be shown: {error}"
        if trouble:
            self.picture.forget()
        self.picture.take_shown(time, trouble)
        self._time = now * 1e-9
        if frame is None:  # no samples here: nothing of another time is left to be seen
            frame = packed("frame", {}, {"x": np.zeros(0), "y": np.zeros(0)})
        return [frame, self.picture.state()]

    def _read(self, now: int) -> bytes | None:
        """Fill the picture; the frame of the time [ns], None where there are no samples."""
        picture = self.picture
        self._take_latched(now)
        analysed: RawMessage | None = None
        topics = [self._others[what] for what in ("squeal", "windows", "stability") if what in self._others]
        begin = now - round(TREND * 1e9)
        for message in self.bag.messages(topics, begin, now + 1) if topics else []:
            if message.topic == self._others.get("stability"):
                analysed = message
            else:
                self._time = message.log_time * 1e-9
                self._take(message)
        self._take_analysed(analysed, begin)
        for samples in self._blocks(now, _WINDOW):
            picture.take_block(samples)
        frame = picture.frame()
        picture.replace_columns(self._spectrogram(now))
        return frame

    def _take_latched(self, now: int) -> None:
        told = [(log_time, topic, data) for log_time, topic, data in self._latched if log_time <= now]
        last = {topic: data for _, topic, data in told}
        first = next((data for _, topic, data in self._latched if topic == self._description), None)
        data = last.get(self._description, first)
        if data is not None:
            self.picture.take_rig(RigDescription.from_yaml(self._text(data)))
        run = self._others.get("run")
        for log_time, topic, data in told:
            if topic == run:
                for _, status in statuses(self._decoders["run"](data)):
                    self.picture.take_run(log_time * 1e-9, status)

    def _take_analysed(self, last: RawMessage | None, begin: int) -> None:
        """Take the last analysis, which may be older than what is shown: it is told on changes, and with friction."""
        topic = self._others.get("stability")
        if last is None and topic:
            # Not from the beginning of the bag at each time that is asked for.
            known = self._analysed if self._analysed and self._analysed.log_time < begin else None
            for message in self.bag.messages([topic], known and known.log_time, begin):
                known = message
            last = self._analysed = known
        if last is not None:
            self.picture.take_stability(dict(statuses(self._decoders["stability"](last.data))))

    def _take(self, message: RawMessage) -> None:
        if message.topic == self._others.get("windows"):
            window = block_from_cdr(message.data, FRICTION_WINDOW_NEEDED).samples[0]
            self.picture.take_window(*(float(window[n]) for n in ("t_end", "mu", "mu_ratio_of_means", "mu_true")))
            return
        for _, status in statuses(self._decoders["squeal"](message.data)):
            self.picture.take_squeal(message.log_time * 1e-9, status)

    def _blocks(self, now: int, length: float) -> Iterator[Any]:
        for message in self.bag.messages([self._samples], now - round(length * 1e9), now + 1):
            yield block_from_cdr(message.data, DAQ_CHANNELS).samples

    def _spectrogram(self, now: int) -> list[NDArray[np.uint8]]:
        """Columns on a grid of times that stays, so that moving on reads the new ones only."""
        rig = self.picture.rig
        if rig is None:
            return []
        spacing = self._repeat / COLUMNS_PER_SECOND
        last = math.floor((now - self.bag.start_time) * 1e-9 / spacing)
        columns = []
        for number in range(max(0, last - _MOST_COLUMNS + 1), last + 1):
            if number not in self._columns:
                end = min(self.bag.start_time + round((number + 0.5) * spacing * 1e9), self.bag.end_time)
                blocks = [block["x"] for block in self._blocks(end, _WINDOW / 2)]
                samples = np.concatenate(blocks) if blocks else np.zeros(0)
                sound = len(samples) > 1 and np.isfinite(samples).all()
                # A time without samples is dark: those before it keep their distance from now.
                self._columns[number] = column(samples, rig.sample_rate) if sound else np.zeros(COLUMN_LINES, np.uint8)
            columns += [self._columns[number]] * self._repeat
        return columns
