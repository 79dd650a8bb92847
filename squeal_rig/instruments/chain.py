"""From true values to what the acquisition hands over: sensors, inverter and front end, sample by sample with state.

Every stage gives the same samples however they are divided into blocks, and leaves out what its data sheet does not
have, so that ideal instruments change no bit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy  # loads its parts when they are used: ideal rigs need none, and `signal` takes a second
from numpy.typing import NDArray

from squeal_rig.instruments.data_sheets import DataSheets, Sensor, TorqueReport
from squeal_rig.instruments.driver import Samples
from squeal_rig.model.core.kernel import kernel

Values = NDArray[np.float64]

#: The play operator's half width as a share of the range; smaller motions close no loop.
PLAY = 0.1
#: A sensor's low-pass beyond this share of the sample rate is left out: a sampled one cannot have it.
HIGHEST_BANDWIDTH = 0.45
_PPM = 1e-6
# A section that changes no bit.
_AS_IT_IS = np.array([[1.0, 0.0, 0.0, 1.0, 0.0, 0.0]])


@dataclass(frozen=True)
class Specimen:
    """What one instrument has of its tolerances: shares, the offset in the channel's unit, drifts of both per K."""

    sensitivity_error: float
    offset: float
    zero_drift: float
    sensitivity_drift: float


class Filter:
    """Second-order sections, (s, 6) for every row or (rows, s, 6), that start settled on their first sample.

    SciPy's `sosfilt` in one compiled call for all rows: at 512 samples a block its checks cost more than its filtering.
    """

    def __init__(self, sections: Values) -> None:
        self.sections = sections
        self._state: Values | None = None

    def __call__(self, rows: Values) -> Values:
        """Filter the next samples (rows, n) in place, and return them."""
        if self._state is None:
            each = np.broadcast_to(self.sections, (len(rows), *self.sections.shape[-2:]))
            self.sections = np.ascontiguousarray(each)
            self._state = np.array([scipy.signal.sosfilt_zi(own) * row[0] for own, row in zip(each, rows, strict=True)])
        cascade(self.sections, self._state, rows)
        return rows


def sensor_low_pass(bandwidth: float, sample_rate: float) -> Values | None:
    """Sections of a sensor's second-order low-pass; None where there is none or the sample rate cannot show it.

    Butterworth by the bilinear transform, prewarped, so that -3 dB lies at the bandwidth [Hz]:
    |H|^2 = 1 / (1 + (tan(pi f/fs) / tan(pi bandwidth/fs))^4).
    """
    if not 0.0 < bandwidth < HIGHEST_BANDWIDTH * sample_rate:
        return None
    return np.asarray(scipy.signal.butter(2, bandwidth, fs=sample_rate, output="sos"))


def report_low_pass(filter_time: float, sample_rate: float) -> Values | None:
    """Sections of the inverter's low-pass y += (1 - exp(-dt/filter_time)) (x - y), exact for held x; None without."""
    if not filter_time:
        return None
    share = -math.expm1(-1.0 / (sample_rate * filter_time))
    return np.array([[share, 0.0, 0.0, 1.0, share - 1.0, 0.0]])


def noise_gain(sections: Values | None) -> float:
    """Variance of filtered white noise over that of white noise: the mean of |H|^2 over the circle.

    By Parseval the sum of the impulse response's squares; the mean over equidistant points is exact but for what of
    the response is longer than these points: nothing that shows, down to cutoffs of a thousandth of the sample rate.
    """
    if sections is None:
        return 1.0
    _, response = scipy.signal.sosfreqz(sections, 1 << 14, whole=True)
    return float(np.mean(np.abs(response) ** 2))


def report_noise_gain(filter_time: float, sample_rate: float) -> float:
    """`noise_gain` of the inverter's low-pass, a / (2 - a) for y += a (x - y)."""
    share = -math.expm1(-1.0 / (sample_rate * filter_time)) if filter_time else 1.0
    return share / (2.0 - share)


class Chain:
    """All instruments of a rig.

    Args:
        sheets: their data sheets.
        sample_rate: samples per second [Hz].
        seed: of noise, gaps and what each specimen has of its tolerances.
    """

    def __init__(self, sheets: DataSheets, sample_rate: int, seed: int) -> None:
        self._rate, self._taken = sample_rate, 0
        # One stream for each purpose: a sheet with more noise draws the same gaps.
        streams = [np.random.default_rng(sequence) for sequence in np.random.SeedSequence(seed).spawn(4)]
        tolerances, self._sensor_noise, self._report_noise, gaps = streams
        self._environment, daq = sheets.environment, sheets.daq
        sensors = sheets.analog
        self.channels = tuple(sensors)
        self.specimens = {channel: _specimen(sensor, tolerances) for channel, sensor in sensors.items()}
        report = sheets.motor_torque
        self.specimens["motor_torque"] = _specimen(report, tolerances)
        #: What the clock's rate is off, as a share.
        self.clock_error = daq.clock_error * _PPM * tolerances.uniform(-1.0, 1.0)
        self.gaps = Gaps(daq.drop_rate / sample_rate, round(daq.drop_length * sample_rate), gaps)
        self._report = Report(report, self.specimens["motor_torque"], sample_rate, self._report_noise)

        def column(values: list[float]) -> Values:
            return np.array(values)[:, None]

        rows, specimens = list(sensors.values()), [self.specimens[channel] for channel in self.channels]
        self._low_pass = _low_pass(rows, sample_rate)
        self._ends = column([sensor.range or math.inf for sensor in rows])
        self._linearity = column([4.0 * sensor.linearity for sensor in rows])
        self._play_width = np.array([PLAY * sensor.range for sensor in rows])
        self._play_share = column([sensor.hysteresis / (2.0 * PLAY) for sensor in rows])
        self._play: Values | None = None
        self._error = column([s.sensitivity_error for s in specimens])
        self._offset = column([s.offset for s in specimens])
        self._zero_drift = column([s.zero_drift for s in specimens])
        self._sensitivity_drift = column([s.sensitivity_drift for s in specimens])
        self._noise = np.array([sensor.noise_density for sensor in rows]) * math.sqrt(0.5 * sample_rate)
        self._anti_alias = (
            Filter(anti_alias(daq.anti_alias_order, daq.anti_alias_cutoff)) if daq.anti_alias_order else None
        )
        self._codes = 2.0 ** (daq.bits - 1) if daq.bits else 0.0
        self._step = column([step_of(sensor, daq.bits, daq.headroom) for sensor in rows])
        self._ideal = not (
            self._low_pass
            or np.isfinite(self._ends).any()
            or self._noise.any()
            or self._anti_alias
            or any(s != Specimen(0.0, 0.0, 0.0, 0.0) for s in specimens)
        )

    def measure(self, samples: Samples) -> None:
        """Turn the next true values of a record (n,) into what is measured, in place; `seq` and `t` are left alone."""
        self._report(samples)
        if self._ideal:
            return
        rows = np.empty((len(self.channels), len(samples)))
        for row, channel in zip(rows, self.channels, strict=True):
            row[:] = samples[channel]
        for row, channel in zip(self._read(rows), self.channels, strict=True):
            samples[channel] = row

    def _read(self, v: Values) -> Values:
        n = v.shape[1]
        if self._low_pass is not None:
            v = self._low_pass(v)
        if self._play_share.any():
            if self._play is None:
                self._play = v[:, 0].copy()
            lagging = np.empty_like(v)
            play(v, self._play_width, self._play, lagging)
            v = v + self._play_share * (lagging - v)
        if self._linearity.any():
            share = np.divide(v, self._ends)
            v = v + self._linearity * v * (1.0 - np.abs(share))
        if self._error.any() or self._sensitivity_drift.any() or self._offset.any() or self._zero_drift.any():
            rise = self._temperature_rise(n)
            v = v * (1.0 + self._error + self._sensitivity_drift * rise) + (self._offset + self._zero_drift * rise)
        self._taken += n
        if self._noise.any():
            v = v + (self._sensor_noise.standard_normal((n, len(v))) * self._noise).T
        v = np.clip(v, -self._ends, self._ends)
        if self._anti_alias is not None:
            v = self._anti_alias(v)
        if self._codes:
            v = np.clip(np.rint(v / self._step), -self._codes, self._codes - 1.0) * self._step
        return v

    def _temperature_rise(self, n: int) -> Values:
        """Temperature above that of the calibration at the next n samples [K]."""
        time = (self._taken + np.arange(n)) / self._rate
        return np.asarray(-self._environment.temperature_rise * np.expm1(-time / self._environment.temperature_time))


class Report:
    """The motor's torque as its inverter tells it."""

    def __init__(self, sheet: TorqueReport, specimen: Specimen, sample_rate: int, random: np.random.Generator) -> None:
        self._sheet, self._specimen, self._rate, self._random = sheet, specimen, sample_rate, random
        sections = report_low_pass(sheet.filter_time, sample_rate)
        self._filter = Filter(sections) if sections is not None else None
        self._noise = sheet.noise_density * math.sqrt(0.5 * sample_rate)
        self._late = round(sheet.delay * sample_rate)
        self._held = sheet.update_rate or sample_rate
        # Values that a later sample may still tell.
        self._keep = self._late + -(-sample_rate // self._held)
        self._passed: Values = np.empty(0)
        self._taken = 0

    def __call__(self, samples: Samples) -> None:
        """Turn the next true torques of a record (n,) into what is told, in place."""
        sheet, told = self._sheet, None
        torque = np.array(samples["motor_torque"])
        if self._specimen.sensitivity_error or self._specimen.offset:
            torque = told = torque * (1.0 + self._specimen.sensitivity_error) + self._specimen.offset
        if self._noise:
            torque = told = torque + self._noise * self._random.standard_normal(len(torque))
        if self._filter is not None:
            torque = told = self._filter(np.array(torque[None, :]))[0]
        # After the low-pass: noise that it takes away must not pull the mean from the limit.
        if sheet.range:
            torque = told = np.clip(torque, -sheet.range, sheet.range)
        if self._late or sheet.update_rate:
            torque = told = self._hold(torque)
        if sheet.resolution:
            told = np.rint(torque / sheet.resolution) * sheet.resolution
        if told is not None:
            samples["motor_torque"] = told

    def _hold(self, torque: Values) -> Values:
        """Late by `delay`, each value held until the next: values are taken at multiples of 1/update_rate."""
        known = np.concatenate((self._passed, torque))
        first = self._taken - len(self._passed)  # number of known[0] among all samples
        moment = np.arange(self._taken, self._taken + len(torque)) - self._late
        value = moment * self._held // self._rate
        source = -(-value * self._rate // self._held)  # the first sample at or after the moment a value is taken
        self._taken += len(torque)
        self._passed = known[max(0, len(known) - self._keep) :] if self._keep else known[:0]
        return np.asarray(known[np.maximum(source, 0) - first])


class Gaps:
    """Samples that are lost, at random.

    Args:
        chance: gaps per sample.
        length: samples of a gap.
        random: what they are drawn from.
    """

    def __init__(self, chance: float, length: int, random: np.random.Generator) -> None:
        self._chance, self._length, self._random = chance, length, random
        self._next = random.exponential(1.0 / chance) if chance and length else math.inf
        self._taken = self._pending = 0

    def take(self, n: int) -> int:
        """How many of the next n samples are lost, those at the beginning; at most half of them, the rest later."""
        self._taken += n
        while self._next < self._taken:
            self._pending += self._length
            self._next += self._random.exponential(1.0 / self._chance)
        lost = min(self._pending, n // 2)
        self._pending -= lost
        return lost


def anti_alias(order: int, cutoff: float) -> Values:
    """Sections of the front end's Butterworth low-pass; the cutoff is a share of the sample rate."""
    return np.asarray(scipy.signal.butter(order, cutoff, fs=1.0, output="sos"))


def step_of(sensor: Sensor, bits: int, headroom: float) -> float:
    """Step of a quantised channel [its unit]: 2 * input range / 2^bits; 0 where it is not quantised."""
    return 2.0 * sensor.range * headroom / 2.0**bits if bits else 0.0


@kernel
def cascade(sections: Values, state: Values, v: Values) -> None:
    """Filter rows `v` (r, n) in place through sections (r, s, 6), a0 = 1; `state` (r, s, 2) goes on.

    Transposed direct form II (Oppenheim and Schafer, Discrete-Time Signal Processing, section 6.3).
    """
    for r in range(v.shape[0]):
        for s in range(sections.shape[1]):
            b0, b1, b2 = sections[r, s, 0], sections[r, s, 1], sections[r, s, 2]
            a1, a2 = sections[r, s, 4], sections[r, s, 5]
            z0, z1 = state[r, s, 0], state[r, s, 1]
            for i in range(v.shape[1]):
                x = v[r, i]
                y = b0 * x + z0
                z0 = b1 * x - a1 * y + z1
                z1 = b2 * x - a2 * y
                v[r, i] = y
            state[r, s, 0], state[r, s, 1] = z0, z1


@kernel
def play(v: Values, width: Values, state: Values, out: Values) -> None:
    """Play operator of half widths (c,): `out` (c, n) follows `v` (c, n) only when it is further away than that.

    `state` (c,) is the last value of `out`, carried from block to block. Source: Brokate and Sprekels, Hysteresis and
    Phase Transitions, 1996, section 2.1.
    """
    for c in range(len(v)):
        last, w = state[c], width[c]
        for i in range(v.shape[1]):
            last = min(max(last, v[c, i] - w), v[c, i] + w)
            out[c, i] = last
        state[c] = last


def _specimen(sheet: Sensor | TorqueReport, random: np.random.Generator) -> Specimen:
    """One instrument of a kind: each tolerance drawn evenly within its bounds; always as many draws."""
    draw = random.uniform(-1.0, 1.0, 4)
    drift, gain_drift = (sheet.zero_drift, sheet.sensitivity_drift) if isinstance(sheet, Sensor) else (0.0, 0.0)
    return Specimen(
        sheet.sensitivity_error * draw[0],
        sheet.offset * sheet.range * draw[1],
        drift * sheet.range * draw[2],
        gain_drift * draw[3],
    )


def _low_pass(sensors: list[Sensor], sample_rate: int) -> Filter | None:
    """The low-passes of all sensors, a row each; None where no sensor has one."""
    found = [sensor_low_pass(sensor.bandwidth, sample_rate) for sensor in sensors]
    if all(sections is None for sections in found):
        return None
    return Filter(np.array([_AS_IT_IS if sections is None else sections for sections in found]))
