"""The rig's sound for whoever listens: one resampler a rate, whatever the number of listeners."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import numpy as np

from squeal_rig.errors import ParameterError
from squeal_rig.instruments.driver import Samples
from squeal_rig.instruments.numbering import SEQ_MODULUS
from squeal_rig.page.packing import packed
from squeal_rig.view.sound import Resampler

#: Rates of sound cards [Hz].
SOUND_RATES = (8000, 16000, 22050, 24000, 32000, 44100, 48000, 88200, 96000, 176400, 192000)
_MICROMETRES = 1e6


class _Stream:
    def __init__(self, sample_rate: int, rate: int, begin: int) -> None:
        self.sample_rate, self.resampler = sample_rate, Resampler(sample_rate, rate)
        self.begin = begin
        self.given = 0


class Sound:
    """The pad's displacement along the belt [um] at the rates that are listened to.

    Each piece tells the number of the sample with which its stream began (`origin`) and its own place in the stream
    (`first`): an offline resampling from that sample on is the same numbers. A sample that is lost or not finite begins
    a stream anew.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._streams: dict[int, _Stream | None] = {}
        self._expected: int | None = None

    def listen(self, rates: set[int]) -> None:
        """Make sound of these rates from now on, and of no other.

        Raises:
            ParameterError: no sound card has such a rate.
        """
        for rate in rates:
            if rate not in SOUND_RATES:
                raise ParameterError(f"sound at {rate} Hz: it must be one of {', '.join(map(str, SOUND_RATES))} Hz")
        with self._lock:
            self._streams = {rate: self._streams.get(rate) for rate in rates}

    def take_block(self, daq: Samples, sample_rate: int) -> Iterator[tuple[int, bytes]]:
        """Take a block; yields (rate, message) of what can be heard now."""
        seq = int(daq["seq"][0])
        with self._lock:
            sound = bool(np.isfinite(daq["x"]).all())
            if seq != self._expected or not sound:
                self._streams = dict.fromkeys(self._streams)
            self._expected = (seq + len(daq)) % SEQ_MODULUS
            if not sound:  # filters of a browser would never forget it
                return
            for rate, known in self._streams.items():
                stream = known if known and known.sample_rate == sample_rate else _Stream(sample_rate, rate, seq)
                self._streams[rate] = stream
                heard = stream.resampler.add(_MICROMETRES * daq["x"])
                if len(heard):
                    values = {"rate": rate, "origin": stream.begin, "first": stream.given}
                    stream.given += len(heard)
                    yield rate, packed("sound", values, {"sound": heard})
