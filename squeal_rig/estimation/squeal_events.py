"""Squeal as events: tones followed from window to window, each with onset, end, track, harmonics, growth and decay.

One code for live blocks and for bags: windows are counted in samples, so it does not matter how samples come in blocks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from squeal_rig.estimation.envelope import Rate, decay_rate, growth_rate
from squeal_rig.estimation.harmonics import Harmonic, superharmonics
from squeal_rig.estimation.settings import SquealSettings, ToneSettings
from squeal_rig.estimation.spectra import amplitude_spectrum
from squeal_rig.estimation.tones import Tone, ToneFinder
from squeal_rig.instruments.driver import Samples
from squeal_rig.instruments.numbering import SEQ_MODULUS

Values = NDArray[np.float64]

# A tone's lines of two windows are one tone where they are this near, as a share of the frequency.
_SAME_TONE = 0.03
# Signal kept, to look back for growth and decay [s].
_HISTORY = 1.0
# Windows a tone may be missed before it has ended; and how long its decay is listened to then [s].
_MISSED = 1
_LISTENED = 0.3
_HIGHEST_ORDER = 16


@dataclass
class SquealEvent:
    """One tone from its onset to its end.

    - onset, end: [s] since the first sample given; `end` is nan while it lasts. Onset is known within a hop
    - times [s], frequencies [Hz], levels [dB re 1 um]: one a window, at the window's middle
    - tonality: the highest [dB]
    - harmonics: of the loudest window
    - growth, decay: where the amplitude is an exponential, before and after
    - harmonic_of: frequency [Hz] of the louder tone that this is a multiple of, nan where it is none's
    """

    number: int
    onset: float
    end: float = math.nan
    times: list[float] = field(default_factory=list)
    frequencies: list[float] = field(default_factory=list)
    levels: list[float] = field(default_factory=list)
    tonality: float = -math.inf
    harmonics: list[Harmonic] = field(default_factory=list)
    growth: Rate = field(default_factory=Rate)
    decay: Rate = field(default_factory=Rate)
    harmonic_of: float = math.nan

    @property
    def duration(self) -> float:
        """Length [s]; up to the last window while it lasts."""
        return (self.times[-1] if math.isnan(self.end) else self.end) - self.onset

    @property
    def level(self) -> float:
        """Highest level [dB re 1 um]."""
        return max(self.levels)

    @property
    def frequency(self) -> float:
        """Frequency of the loudest window [Hz]."""
        return self.frequencies[int(np.argmax(self.levels))]


class SquealEvents:
    """Takes blocks of `daq/samples`; keeps the events that last, and gives those that have ended.

    An event that has ended is given `_LISTENED` later, with its decay, or where samples end. A gap in the samples ends
    every event: what was not seen is not called squeal.

    Raises:
        ParameterError: as `ToneFinder`.
    """

    def __init__(self, sample_rate: int, band: SquealSettings, settings: ToneSettings) -> None:
        self._rate, self._band = sample_rate, band
        self._hop = max(1, round(0.5 * settings.tone_window * sample_rate))
        self._length = 2 * self._hop
        self._finder = ToneFinder(sample_rate, self._length, band, settings)
        self._least = max(1, math.ceil(settings.least_duration * sample_rate / self._hop))
        self._keep = max(self._length, round(_HISTORY * sample_rate))
        self._history = np.empty(0)
        self._taken = 0  # samples since the first, missing ones not counted
        self._since_hop = 0
        self._expected: int | None = None
        self._number = self._lasting = 0
        self._unseen: dict[int, int] = {}
        self._dying: list[SquealEvent] = []
        self.current: list[SquealEvent] = []
        self.tones: list[Tone] = []

    @property
    def threshold(self) -> float:
        """Tonality a tone must have [dB]."""
        return self._finder.threshold

    @property
    def count(self) -> int:
        """Events so far that have lasted long enough, those that go on included."""
        return self._lasting

    def add_samples(self, daq: Samples) -> list[SquealEvent]:
        """Take a block; returns the events that have ended in it."""
        seq = int(daq["seq"][0])
        ended = []
        if self._expected is not None and seq != self._expected:
            ended = self.finish()
        self._expected = (seq + len(daq)) % SEQ_MODULUS
        return ended + self.add_signal(np.asarray(daq["x"], dtype=np.float64))

    def add_signal(self, x: Values) -> list[SquealEvent]:
        """Take samples (n,) [m] that follow the last ones; returns the events that have ended in them."""
        ended: list[SquealEvent] = []
        taken = 0
        while taken < len(x):
            count = min(len(x) - taken, self._hop - self._since_hop)
            self._history = np.concatenate([self._history[-(self._keep - count) :], x[taken : taken + count]])
            taken += count
            self._taken += count
            self._since_hop += count
            if self._since_hop == self._hop:
                self._since_hop = 0
                if len(self._history) >= self._length:
                    ended += self._judge()
        return ended

    def finish(self) -> list[SquealEvent]:
        """End every event where the samples end; returns them."""
        ended = self._died(math.inf)
        lasting = [event for event in self.current if len(event.times) >= self._least]
        for event in lasting:
            event.end = self._taken / self._rate
        ended += lasting
        self.current, self.tones, self._unseen = [], [], {}
        self._history, self._since_hop = np.empty(0), 0
        return ended

    def _judge(self) -> list[SquealEvent]:
        signal = self._history[-self._length :]
        if not np.isfinite(signal).all():
            return self.finish()
        end = self._taken / self._rate
        middle = end - 0.5 * self._length / self._rate
        tones = self._finder.tones(signal, self._band.off_level)
        self.tones = tones
        free = list(tones)
        for event in sorted(self.current, key=lambda event: -event.levels[-1]):
            near = [t for t in free if abs(t.frequency - event.frequencies[-1]) <= _SAME_TONE * event.frequencies[-1]]
            if near:
                free.remove(near[0])
                self._extend(event, near[0], middle, signal)
                self._unseen[event.number] = 0
            else:
                self._unseen[event.number] += 1
        for tone in free:
            if tone.level >= self._band.on_level:
                self._number += 1
                event = SquealEvent(self._number, max(0.0, middle - 0.5 * self._hop / self._rate))
                event.growth = growth_rate(self._history, self._rate, tone.frequency)
                event.harmonic_of = _fundamental(tone, tones)
                self._unseen[event.number] = 0
                self.current.append(event)
                self._extend(event, tone, middle, signal)
        return self._close(middle)

    def _close(self, middle: float) -> list[SquealEvent]:
        closed = [event for event in self.current if self._unseen[event.number] > _MISSED]
        self.current = [event for event in self.current if event not in closed]
        for event in closed:
            missed = self._unseen.pop(event.number)
            if len(event.times) < self._least:
                self._number -= event.number == self._number
                continue
            event.end = middle - (missed - 0.5) * self._hop / self._rate
            self._dying.append(event)
        return self._died(middle)

    def _died(self, now: float) -> list[SquealEvent]:
        """Events whose decay was listened to, with it."""
        died = [event for event in self._dying if now >= event.end + _LISTENED]
        self._dying = [event for event in self._dying if event not in died]
        for event in died:
            event.decay = decay_rate(self._history, self._rate, event.frequencies[-1])
        return died

    def _extend(self, event: SquealEvent, tone: Tone, middle: float, signal: Values) -> None:
        loudest = not event.levels or tone.level > event.level
        event.times.append(middle)
        self._lasting += len(event.times) == self._least
        event.frequencies.append(tone.frequency)
        event.levels.append(tone.level)
        event.tonality = max(event.tonality, tone.tonality)
        if loudest:
            near = (0.98 * tone.frequency, 1.02 * tone.frequency)
            event.harmonics = superharmonics(*amplitude_spectrum(signal, self._rate), near, _HIGHEST_ORDER)[1]


def event_values(events: SquealEvents, ended: SquealEvent | None) -> dict[str, object]:
    """What `squeal/state` tells of tones and events: those of now, the loudest that lasts, the last ended."""
    lasting = max(events.current, key=lambda event: event.levels[-1], default=None)
    values: dict[str, object] = {
        "tones [Hz]": " ".join(f"{tone.frequency:.2f}" for tone in events.tones) or "none",
        "tone levels [dB re 1 um]": " ".join(f"{tone.level:.2f}" for tone in events.tones) or "none",
        "tonality [dB]": max((tone.tonality for tone in events.tones), default=math.nan),
        "events": events.count,
        "event": 0 if lasting is None else lasting.number,
        "event growth [1/s]": math.nan if lasting is None else lasting.growth.rate,
        "event harmonics": "none" if lasting is None else " ".join(str(h.order) for h in lasting.harmonics) or "none",
    }
    if ended is None:
        return {**values, "ended event": 0}
    return {
        **values,
        "ended event": ended.number,
        "ended duration [s]": ended.duration,
        "ended frequency [Hz]": ended.frequency,
        "ended level [dB re 1 um]": ended.level,
        "ended growth [1/s]": ended.growth.rate,
        "ended decay [1/s]": ended.decay.rate,
    }


def _fundamental(tone: Tone, tones: list[Tone]) -> float:
    """Frequency of a louder tone of which this is a multiple, within the width of both; nan where there is none."""
    for other in tones:
        order = round(tone.frequency / other.frequency)
        if order >= 2 and other.level > tone.level and abs(tone.frequency / order - other.frequency) < 2.0:
            return other.frequency
    return math.nan
