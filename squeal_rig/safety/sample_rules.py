"""Rules on the samples: limits, spikes, saturation, numbers that are none, stuck channels, speed, order and time."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from squeal_rig.instruments.channels import DAQ_CHANNELS
from squeal_rig.instruments.description import RigDescription
from squeal_rig.instruments.driver import Samples
from squeal_rig.instruments.numbering import SEQ_MODULUS, samples_ahead
from squeal_rig.safety.levels import Finding, Level
from squeal_rig.safety.settings import SupervisorSettings

# Quantity -> (channels, unit).
_LIMITED = {
    "force": (("arm_left", "arm_right", "clip_left", "clip_right", "preload"), "N"),
    "displacement": (("x", "y"), "m"),
    "torque": (("motor_torque",), "N m"),
}
_UNITS = {channel.name: channel.unit for channel in DAQ_CHANNELS if channel.code == "<f8" and channel.name != "t"}
# The arms' forces are linear in the pad's motion: where one of these moves by so much, the other kind cannot rest.
_MOVES = {"x": 1e-7, "y": 1e-7, "arm_left": 4.0, "arm_right": 4.0}
_OTHERS = {"x": ("arm_left", "arm_right"), "y": ("arm_left", "arm_right"), "arm_left": ("x",), "arm_right": ("x",)}
# An inverter tells a torque that it rounds and holds: it rests by itself.
_MAY_REST = ("motor_torque",)
_SLACK = 0.01  # what a gap in the numbers may be longer than the time that has passed between the stamps [s]
_BACK = 1e-3  # clocks are set back by so much without harm [s]
_DISORDER_TIME = 10.0
# Samples beyond a limit are no spike where they are more than one in so many of a block, or in so many blocks in a row.
_SPIKE_SHARE, _SPIKES_IN_A_ROW = 20, 3
#: Deviations are judged beyond this many standard deviations of a block's mean.
SIGMAS = 5.0


class SampleRules:
    """Judges every block of `daq/samples`; all times are of samples, not of arrivals."""

    def __init__(self) -> None:
        self._time = 0.0
        self._bad_for: dict[tuple[str, str], float] = {}
        self._beyond_for: dict[tuple[str, Level], int] = {}
        self._last: dict[str, float] = {}
        self._lived: set[str] = set()
        self._speed = SpeedRule()
        self._order = OrderRules()

    @property
    def time(self) -> float:
        """Sampled time so far [s]."""
        return self._time

    def forget(self) -> None:
        """What comes next need not follow what came before: after a pause, or a rig started again."""
        self._order = OrderRules()
        self._last.clear()
        self._bad_for.clear()

    def take(
        self, stamp: int, daq: Samples, rig: RigDescription, belt: float | None, settings: SupervisorSettings
    ) -> list[Finding]:
        """Findings of a block; `belt` is the speed that the belt should have [m/s], None where nobody commands it."""
        duration = len(daq) / rig.sample_rate
        self._time += duration
        found = self._order.take(stamp, daq, rig.sample_rate, self._time, settings)
        finite: dict[str, NDArray[np.float64]] = {}
        for channel in _UNITS:
            values = daq[channel]
            sound = np.isfinite(values)
            if sound.all():
                finite[channel] = values
                self._clear("not finite", channel)
            else:
                finite[channel] = values[sound]
                self._lasting(
                    found,
                    ("not finite", channel),
                    duration,
                    settings.not_finite_time,
                    f"{channel} is not finite in {len(values) - int(np.count_nonzero(sound))} of {len(values)} samples",
                )
        largest = {channel: np.abs(values) for channel, values in finite.items()}
        for quantity in _LIMITED:
            found += self._beyond(quantity, largest, settings)
        self._saturated(found, largest, rig, duration, settings)
        self._stuck(found, finite, rig, duration, settings)
        speeds = finite["belt_speed"]
        if len(speeds) and belt is not None:
            slack = SIGMAS * rig.noise.get("belt_speed", 0.0) / math.sqrt(len(speeds)) + rig.ripple.get(
                "belt_speed", 0.0
            )
            found += self._speed.take(float(speeds.mean()), belt, slack, duration, self._time, settings)
        return found

    # --- one rule each

    def _beyond(
        self, quantity: str, largest: dict[str, NDArray[np.float64]], settings: SupervisorSettings
    ) -> list[Finding]:
        channels, unit = _LIMITED[quantity]
        limits = [getattr(settings, f"{quantity}_{name}") for name in ("warn", "ramp_down", "stop")]
        worst: Finding | None = None
        for channel in channels:
            values = largest[channel]
            top = float(values.max()) if len(values) else 0.0
            if top <= limits[0]:
                for higher in (Level.RAMP_DOWN, Level.STOP):
                    self._beyond_for.pop((channel, higher), None)
                continue
            level, limit = Level.WARN, limits[0]
            for higher, bound in ((Level.RAMP_DOWN, limits[1]), (Level.STOP, limits[2])):
                if self._is_beyond((channel, higher), values, bound, settings):
                    level, limit = higher, bound
            if worst is None or level > worst.level:
                spike = " (a spike)" if level == Level.WARN and top > limits[1] else ""
                sentence = f"{channel} reaches {top:.4g} {unit}{spike}, the limit is {limit:g} {unit}"
                worst = Finding(quantity, level, sentence)
        return [worst] if worst is not None else []

    def _is_beyond(
        self, key: tuple[str, Level], values: NDArray[np.float64], bound: float, settings: SupervisorSettings
    ) -> bool:
        """Whether so many samples exceed a bound that it is no spike: of one block, or of blocks one after another."""
        count = int(np.count_nonzero(values > bound))
        row = self._beyond_for[key] = self._beyond_for.get(key, 0) + 1 if count else 0
        spike = min(settings.spike_samples, max(1, len(values) // _SPIKE_SHARE))
        return count > spike or row >= _SPIKES_IN_A_ROW

    def _saturated(
        self,
        found: list[Finding],
        largest: dict[str, NDArray[np.float64]],
        rig: RigDescription,
        duration: float,
        settings: SupervisorSettings,
    ) -> None:
        for channel, end in rig.full_scale.items():
            values = largest.get(channel)
            if values is None:
                continue
            count = int(np.count_nonzero(values >= end * (1.0 - 1e-6)))
            if not count:
                self._clear("saturation", channel)
                continue
            told = f"{channel} is at its full scale of {end:g} {_UNITS[channel]} in {count} of {len(values)} samples"
            self._lasting(found, ("saturation", channel), duration, settings.saturation_time, told)

    def _stuck(
        self,
        found: list[Finding],
        finite: dict[str, NDArray[np.float64]],
        rig: RigDescription,
        duration: float,
        settings: SupervisorSettings,
    ) -> None:
        spans = {name: float(np.ptp(values)) if len(values) else math.nan for name, values in finite.items()}
        # Noise is no motion: its peaks on either side lie within so many standard deviations.
        moving = {n for n, least in _MOVES.items() if spans[n] > least + 2.0 * SIGMAS * rig.noise.get(n, 0.0)}
        for channel, values in finite.items():
            noisy = rig.noise.get(channel, 0.0) > 0.0 and channel not in _MAY_REST
            if not noisy and channel not in _MOVES:
                continue
            rests = spans[channel] == 0.0 and values[0] == self._last.get(channel)
            if spans[channel] > 0.0:
                self._lived.add(channel)
            if len(values):
                self._last[channel] = float(values[-1])
            key = "stuck", channel
            if not rests:
                self._bad_for.pop(key, None)
            elif (noisy and channel in self._lived) or moving.intersection(_OTHERS.get(channel, ())):
                self._bad_for[key] = self._bad_for.get(key, 0.0) + duration
                if self._bad_for[key] >= settings.stuck_time:
                    told = f"{channel} stands at {values[0]:.6g} {_UNITS[channel]} for {self._bad_for[key]:.2f} s"
                    found.append(Finding(f"stuck {channel}", Level.RAMP_DOWN, told))

    # --- how long

    def _lasting(self, found: list[Finding], key: tuple[str, str], duration: float, patience: float, told: str) -> None:
        """A finding that is warned of, and ramps down once it has lasted longer than `patience` [s]."""
        self._bad_for[key] = lasted = self._bad_for.get(key, 0.0) + duration
        level = Level.RAMP_DOWN if lasted > patience else Level.WARN
        rule, channel = key
        found.append(Finding(f"{rule} {channel}", level, f"{told}, for {lasted:.2f} s"))

    def _clear(self, rule: str, channel: str) -> None:
        self._bad_for.pop((rule, channel), None)


class SpeedRule:
    """The belt's speed beside its set point; on the way from one to the next it may lie in between, for a while."""

    def __init__(self) -> None:
        self._goal: float | None = None
        self._low = self._high = 0.0
        self._until = 0.0
        self._off_for = 0.0

    def take(
        self, speed: float, goal: float, slack: float, duration: float, now: float, s: SupervisorSettings
    ) -> list[Finding]:
        """Findings of a block of `duration` [s] that ends at `now` [s] of sampled time, of mean speed [m/s]."""
        if goal != self._goal:
            # From the set point before, or from wherever between two of them; the first one ever from what is there.
            before = (speed,) if self._goal is None else (self._low, self._high)
            self._low, self._high = min(goal, *before), max(goal, *before)
            self._goal, self._until = goal, now + s.speed_settling
        if abs(speed - goal) <= s.speed_deviation_warn + slack or now >= self._until:
            self._low = self._high = goal
        off = max(self._low - speed, speed - self._high, 0.0) - slack
        limits = (
            (Level.STOP, s.speed_deviation_stop),
            (Level.RAMP_DOWN, s.speed_deviation_ramp_down),
            (Level.WARN, s.speed_deviation_warn),
        )
        for level, limit in limits:
            if off > limit:
                self._off_for += duration
                if self._off_for <= s.speed_time:
                    return []
                told = f"the belt runs at {speed:.4g} m/s, {off:.3g} m/s off its set point of {goal:g} m/s"
                return [Finding("speed", level, f"{told}, the limit is {limit:g} m/s")]
        self._off_for = 0.0
        return []


class OrderRules:
    """Numbers and stamps of the samples: what is lost, out of order, or of a time that cannot be."""

    def __init__(self) -> None:
        self._end: int | None = None
        self._end_time = 0.0
        self._lost: deque[tuple[float, int]] = deque()
        self._disorder: deque[float] = deque()

    def take(self, stamp: int, daq: Samples, rate: int, now: float, s: SupervisorSettings) -> list[Finding]:
        """Findings of a block; `now` is the sampled time so far [s]."""
        seq, begin = int(daq["seq"][0]), stamp * 1e-9 + float(daq["t"][0])
        end = (seq + len(daq)) % SEQ_MODULUS, begin + len(daq) / rate
        found: list[Finding] = []
        if self._end is not None:
            gap = samples_ahead(seq, self._end)
            step = begin - self._end_time
            if gap < 0 and step < -_BACK:
                # One that comes late: what follows goes on from the latest, and what it brings is not lost after all.
                self._lost.append((now, -len(daq)))
                self._disorder.append(now)
                found.append(Finding("order", Level.WARN, f"a block came {-gap} samples late, or twice"))
                end = self._end, self._end_time
            elif gap < 0 or gap / rate > max(step, 0.0) + _SLACK:
                self._disorder.append(now)
                found.append(Finding("order", Level.WARN, f"the samples' numbers jump by {gap}: they begin anew"))
                self._lost.clear()
            elif step - gap / rate < -_BACK:
                told = f"the samples' time runs back by {gap / rate - step:.3g} s"
                found.append(Finding("time", Level.RAMP_DOWN, told))
            else:
                if gap > 0:
                    self._lost.append((now, gap))
                if step - gap / rate > s.time_jump:
                    told = f"the samples' time jumps ahead by {step - gap / rate:.3g} s, {s.time_jump:g} s is the limit"
                    found.append(Finding("time", Level.WARN, told))
        self._end, self._end_time = end
        return [*found, *self._counts(rate, now, s)]

    def _counts(self, rate: int, now: float, s: SupervisorSettings) -> list[Finding]:
        found: list[Finding] = []
        while self._lost and now - self._lost[0][0] > 1.0:
            self._lost.popleft()
        while self._disorder and now - self._disorder[0] > _DISORDER_TIME:
            self._disorder.popleft()
        if len(self._disorder) >= s.disorder:
            told = f"{len(self._disorder)} blocks out of order within {_DISORDER_TIME:g} s, the limit is {s.disorder}"
            found.append(Finding("order", Level.RAMP_DOWN, told))
        lost = sum(count for _, count in self._lost)
        if lost > 0:
            share = lost / rate
            level = Level.RAMP_DOWN if share >= s.lost_share else Level.WARN
            told = f"{lost} samples lost within a second, {100.0 * share:.3g} % of them"
            found.append(Finding("gap", level, f"{told}; the limit is {100.0 * s.lost_share:g} %"))
        return found
