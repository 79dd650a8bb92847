"""What the node `view` publishes, from the rig's blocks: pure, so that a test needs no ROS."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator

import numpy as np

from squeal_rig.instruments.channels import DAQ_CHANNELS
from squeal_rig.instruments.driver import Samples
from squeal_rig.recording.cdr import float64_message, multi_array_message
from squeal_rig.view.pictures import decimated, envelope, spectrum_lines
from squeal_rig.view.settings import ViewSettings
from squeal_rig.view.window import LastSamples

Message = tuple[str, bytes]  # relative topic, serialised

#: The channels that are shown: all but time and number.
SHOWN = tuple(channel for channel in DAQ_CHANNELS if channel.name not in ("t", "seq"))
ENVELOPE, SCOPE_RATE = "view/envelope", "view/scope_rate"
SPECTRUM, SPECTRUM_AXIS = "view/spectrum", "view/spectrum_axis"
#: Topic of one number -> what it is.
NUMBERS = {
    "view/mu": "friction coefficient, ratio of means of the last window",
    "view/mu_windows": "friction coefficient, Eq. (2.2) of the last window",
    "view/mu_true": "friction coefficient of the law in force, where truth is published",
    "view/margin": "stability margin (k_cr - k)/k_cr of what is in force",
    "view/smallest_hit": "smallest hit that starts squeal at the set point [N s]; 0 where it squeals by itself",
    "view/squeal_level": "level of the squeal [dB re 1 um]",
    "view/squeal_frequency": "frequency of the squeal [Hz], where there is one",
    "view/off_belt_share": "share of the time off the belt since the last value, where truth is published",
}
#: Of these, what is told once and holds until it changes.
LASTING = ("view/margin", "view/smallest_hit")
_OLD = 3.0  # what is said again and again is not so any more after this time [s]
#: Topic -> (value, when it came [s, monotonic]).
Numbers = dict[str, tuple[float, float]]
#: Topics of arrays.
ARRAYS = (ENVELOPE, SPECTRUM, SPECTRUM_AXIS, *(f"view/scope/{channel.name}" for channel in SHOWN))


class ViewFollower:
    """Takes blocks; gives an envelope for each, and `rate` times a second of sampled time everything else.

    `numbers` holds the last value of each topic of one number, and when it came [s, monotonic]. What is not finite is
    not published, and what is old only where it is told once and holds until it changes.
    """

    def __init__(self, settings: ViewSettings, sample_rate: int, numbers: Numbers | None = None) -> None:
        self._settings, self._rate = settings, sample_rate
        self._window = LastSamples(max(2, round(settings.spectrum_window * sample_rate)))
        self._since = math.inf  # samples since the last pictures: the first come at once
        self._off = self._truths = 0
        self.numbers: Numbers = {} if numbers is None else numbers

    def take_truth(self, truth: Samples) -> None:
        """Take a block of `truth/samples`."""
        self._off += int(np.count_nonzero(truth["normal_force"] <= 0.0))
        self._truths += len(truth)

    def take_block(self, daq: Samples) -> Iterator[Message]:
        """Take a block of `daq/samples`; yields what is to be published."""
        self._window.add(int(daq["seq"][0]), daq["x"])
        rows = [envelope(daq[channel.name]) for channel in SHOWN]
        yield ENVELOPE, multi_array_message(rows, ", ".join(_title(c.name, c.unit) for c in SHOWN), "min, max, mean")
        self._since += len(daq)
        period = self._rate / self._settings.rate
        if self._since < period:
            return
        # What is over counts, so that the rate is kept.
        self._since = 0.0 if math.isinf(self._since) else min(self._since - period, period)
        yield from self._scope(daq)
        yield from self._spectrum()
        now = time.monotonic()
        self.numbers["view/off_belt_share"] = self._off / self._truths if self._truths else math.nan, now
        self._off = self._truths = 0
        for topic, (value, came) in self.numbers.items():
            if math.isfinite(value) and (topic in LASTING or now - came < _OLD):
                yield topic, float64_message(value)

    def _scope(self, daq: Samples) -> Iterator[Message]:
        for channel in SHOWN:
            values, step = decimated(daq[channel.name], self._settings.points)
            label = f"at {self._rate / step:g} Hz"
            yield (
                f"view/scope/{channel.name}",
                multi_array_message([values.tolist()], _title(channel.name, channel.unit), label),
            )
        yield SCOPE_RATE, float64_message(self._rate / step)

    def _spectrum(self) -> Iterator[Message]:
        samples = self._window.whole()
        if samples is None or not np.isfinite(samples).all():
            return
        lines = spectrum_lines(samples, self._rate, self._settings.spectrum_high, self._settings.points)
        yield SPECTRUM, multi_array_message([lines.levels.tolist()], "x [dB re 1 um]", f"lines of {SPECTRUM_AXIS}")
        yield SPECTRUM_AXIS, multi_array_message([lines.frequencies.tolist()], "frequency [Hz]", f"lines of {SPECTRUM}")


def _title(name: str, unit: str) -> str:
    return f"{name} [{unit}]"
