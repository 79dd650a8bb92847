"""What the page shows, kept up to date from the rig's messages and given out as messages to browsers."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from squeal_rig.configuration.declared import declarations
from squeal_rig.estimation import hard_squeal
from squeal_rig.estimation.stability_follower import IN_FORCE, SET_POINT
from squeal_rig.instruments.description import RigDescription
from squeal_rig.instruments.driver import Samples
from squeal_rig.page.commands import settable
from squeal_rig.page.packing import packed
from squeal_rig.page.progress import Progress
from squeal_rig.recording.messages import Status
from squeal_rig.safety.settings import LIMITED, SupervisorSettings
from squeal_rig.view.pictures import decimated, spectrum_lines
from squeal_rig.view.window import LastSamples

POINTS = 500
SPECTRUM_HIGH = 10_000.0  # Hz
_SPECTRUM_WINDOW = 0.2  # s
#: Length of the trends and of the spectrogram [s], columns a second, lines of a column.
TREND, COLUMNS_PER_SECOND, COLUMN_LINES = 60.0, 4, 125
#: Levels [dB re 1 um] between which a spectrogram has its colours.
DARK_DB, BRIGHT_DB = -90.0, 20.0
_GONE = 3.5  # a node whose health is older [s] is gone
_OLD = 3.0  # what is said again and again is not so any more after this time [s]
_AGAIN = ("squealing", "level", "frequency", "tones", "events")
_MOST_EVENTS = 50
_MOST_NODES = 64
_OURS = ("rig", "supervisor", "recorder", "squeal_detector", "friction_estimator", "stability", "view", "page")
# Quantities that the supervisor limits, each named <quantity>_<one of the levels> where it has a limit of that level.
_LIMITED, _LEVELS = (*LIMITED, "squeal", "stale"), ("warn", "ramp_down", "stop")


class Arrival:
    """When something last came that is told again and again, and whether it has stopped."""

    def __init__(self) -> None:
        self.last, self._every = -math.inf, 0.0

    def now(self, time: float) -> None:
        """It comes [s]."""
        self._every = time - self.last if math.isfinite(self.last) else 0.0
        self.last = time

    def is_old(self, time: float) -> bool:
        """Whether it should have come again by a time [s]; windows may be longer than `_OLD`."""
        return time - self.last > max(_OLD, 1.5 * self._every)


class SquealTable:
    """Squeals as rows: begin and end [s since the epoch], frequency [Hz], level [dB re 1 um], F [N], V [m/s].

    The level is the greatest, the frequency and the operating point are those at that time; `end` is None while it
    lasts.
    """

    def __init__(self) -> None:
        self.rows: deque[dict[str, float | None]] = deque(maxlen=_MOST_EVENTS)

    def take(
        self, stamp: float, begin: float, detected: bool, level: float, frequency: float, point: tuple[float, float]
    ) -> None:
        """Take a state of the squeal detector, and since when [s] it has been so."""
        last = self.rows[-1] if self.rows and self.rows[-1]["end"] is None else None
        if last is not None and not detected:
            last["end"] = stamp
        if not detected:
            return
        loudest = {"level": level, "frequency": frequency, "preload": point[0], "belt_speed": point[1]}
        if last is None:
            self.rows.append({"begin": begin, "end": None, **loudest})
        elif level > (last["level"] or -math.inf):
            last.update(loudest)


class Picture:
    """The rig as the page shows it. What feeds it and what asks it may be different threads.

    Args:
        control: whether commands are taken.
        bag: name of the bag that is shown; empty for a live rig.
        duration: length of the bag [s].
        namespace: the rig's, with a slash at its end where it is not empty; health of other rigs is only listed.
        clock: tells the time [s] by which what has come grows old; that of a bag is the bag's.
    """

    def __init__(
        self,
        control: bool,
        bag: str = "",
        duration: float = 0.0,
        namespace: str = "",
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._lock, self._clock = threading.RLock(), clock
        self._control, self._bag, self._duration, self._namespace = control, bag, duration, namespace
        self._description: RigDescription | None = None
        self._daq: Samples | None = None
        self._window: LastSamples | None = None
        self._columns: deque[NDArray[np.uint8]] = deque(maxlen=round(TREND * COLUMNS_PER_SECOND))
        self._sampled = self._next_column = 0.0
        self._mu: deque[tuple[float, float, float, float]] = deque(maxlen=round(TREND * 10))
        self._level: deque[tuple[float, float]] = deque(maxlen=round(TREND * 20))
        self._numbers: dict[str, Any] = {}
        self._nodes: dict[str, tuple[float, Status]] = {}
        self._squeals = SquealTable()
        self._told: dict[str, Any] = {}
        self._progress, self._run_is_heard = Progress(), True
        self._limits: dict[str, Any] = {}
        self._came, self._stamp = clock(), math.nan
        self._squeal_came, self._window_came = Arrival(), Arrival()
        self._trips: deque[dict[str, Any]] = deque(maxlen=20)
        self._blocks = 0
        self._shown = {"time": 0.0, "trouble": ""}

    # --- what comes in

    def take_rig(self, rig: RigDescription) -> None:
        """Take the rig's description."""
        with self._lock:
            if self._description is None or rig.sample_rate != self._description.sample_rate:
                self._window = LastSamples(max(2, round(_SPECTRUM_WINDOW * rig.sample_rate)))
            self._description = rig

    def take_block(self, daq: Samples, stamp: float = math.nan) -> None:
        """Take a block of `daq/samples`, sampled from a time on [s since the epoch]."""
        with self._lock:
            self._daq = daq
            self._blocks += 1
            # By stamps: what was only held up on its way is no pause.
            self._columns.extend(_dark_columns(stamp - self._stamp))
            self._stamp, self._came = stamp, self._clock()
            if self._window is None or self._description is None:
                return
            self._window.add(int(daq["seq"][0]), daq["x"])
            self._sampled += len(daq) / self._description.sample_rate
            if self._sampled >= self._next_column:
                self._next_column += 1.0 / COLUMNS_PER_SECOND
                samples = self._window.whole()
                sound = samples is not None and bool(np.isfinite(samples).all())
                # A column without samples is dark: those before it keep their distance from now.
                self._columns.append(
                    column(samples, self._description.sample_rate)
                    if sound and samples is not None
                    else np.zeros(COLUMN_LINES, np.uint8)
                )

    def take_window(self, t: float, mu: float, ratio_of_means: float, true: float) -> None:
        """Take friction of a window that ended at t [s]."""
        with self._lock:
            self._window_came.now(self._clock())
            self._mu.append((t, mu, ratio_of_means, true))

    def take_stability(self, statuses: Mapping[str, Status]) -> None:
        """Take a stability summary: name -> status."""
        found = statuses.get(IN_FORCE) or statuses.get(SET_POINT)
        with self._lock:
            if found is not None:
                self._numbers |= {
                    # Neither where there is no equilibrium: the message says so.
                    "unstable": {"unstable": True, "stable": False}.get(found[1]),
                    "stability": found[1],
                    "margin": number(found, "margin"),
                    "critical_stiffness": number(found, "k_cr [N/m]"),
                    "pad_stiffness": number(found, "k [N/m]"),
                }
            hard = statuses.get(hard_squeal.NAME)
            if hard is None:  # it is asked for no more: what it said was of another point
                for name in ("zone", "smallest_hit", "hit_direction"):
                    self._numbers.pop(name, None)
            else:
                self._numbers |= {
                    "zone": hard[2].get(hard_squeal.ZONE, hard[2].get(hard_squeal.STATE_KEY, "")),
                    "smallest_hit": number(hard, hard_squeal.SMALLEST_HIT),
                    "hit_direction": number(hard, hard_squeal.HIT_DIRECTION),
                }

    def take_squeal(self, stamp: float, status: Status) -> None:
        """Take a state of the squeal detector, of a time [s since the epoch]."""
        level, frequency = number(status, "level [dB re 1 um]"), number(status, "frequency [Hz]")
        detected = status[2].get("detected") == "true"
        since = number(status, "since [s]")
        with self._lock:
            self._squeal_came.now(self._clock())
            self._level.append((stamp, max(level, -200.0) if math.isfinite(level) else math.nan))
            self._numbers |= {"squealing": detected, "level": level, "frequency": frequency}
            self._numbers |= {
                "tones": status[2].get("tones [Hz]", "")[:100],
                "events": number(status, "events"),
            }
            begin = since if 0.0 <= since <= stamp else stamp
            self._squeals.take(stamp, begin, detected, level, frequency, self._point())

    def take_health(self, name: str, status: Status) -> None:
        """Take a node's health; where there are too many, the stranger goes that has been silent longest."""
        with self._lock:
            if name not in self._nodes and len(self._nodes) >= _MOST_NODES:
                strangers = [known for known in self._nodes if known.removeprefix(self._namespace) not in _OURS]
                del self._nodes[min(strangers, key=lambda known: self._nodes[known][0])]
            self._nodes[name] = (self._clock(), status)

    def take_told(self, what: str, status: Status) -> None:
        """Take the last word of `supervisor` or of `safe` (the rig's way to stop)."""
        with self._lock:
            self._told[what] = {"level": status[0], "message": status[1], "values": dict(status[2])}

    def take_run(self, stamp: float, status: Status) -> None:
        """Take what is told of a run, a plan or a campaign, at a time [s since the epoch]."""
        level, message, values = status
        with self._lock:
            self._progress.take(stamp, level, message, values)

    def take_run_is_heard(self, heard: bool) -> None:
        """Whether there is anybody who would tell more of a run."""
        self._run_is_heard = heard

    def take_limits(self, values: Mapping[str, Any]) -> None:
        """Take parameters of the supervisor, all of them or those that have changed."""
        known = [f"{quantity}_{level}" for quantity in _LIMITED for level in _LEVELS]
        with self._lock:
            self._limits |= {name: values[name] for name in known if isinstance(values.get(name), int | float)}

    def take_trip(self, stamp: float, level: str, sentence: str) -> None:
        """Take a finding, trip or reset of the supervisor, of a time [s since the epoch]."""
        with self._lock:
            self._trips.append({"time": stamp, "level": level, "sentence": sentence})

    def take_shown(self, time: float, trouble: str) -> None:
        """Take which time of a bag [s after its beginning] is shown, and why it cannot be; empty where it can."""
        self._shown = {"time": time, "trouble": trouble}

    def forget(self) -> None:
        """Forget what came, as before another piece of a bag is shown."""
        with self._lock:
            self._columns.clear()
            self._mu.clear()
            self._level.clear()
            self._squeals.rows.clear()
            self._numbers.clear()
            self._squeal_came, self._window_came = Arrival(), Arrival()
            self._daq = None
            self._progress = Progress()

    @property
    def trend(self) -> float:
        """How far back trends go [s]: a minute, or all of a bag that is shorter."""
        return min(TREND, max(self._duration, 1.0)) if self._bag else TREND

    @property
    def rig(self) -> RigDescription | None:
        """The rig's description, once it has come."""
        return self._description

    def replace_columns(self, columns: list[NDArray[np.uint8]]) -> None:
        """Show these columns as the spectrogram."""
        with self._lock:
            self._columns.clear()
            self._columns.extend(columns)

    # --- what goes out

    def hello(self) -> bytes:
        """What a browser is told first: what can be set, within which bounds, and whether it may."""
        declared = [
            {
                "name": name,
                "unit": found.unit,
                "what": found.description,
                "lower": found.lower,
                "upper": found.upper,
                "options": list(found.options),
                "bounds": found.bounds if found.kind is not str else "",
            }
            for name, found in settable().items()
        ]
        values = {
            "control": self._control,
            "live": not self._bag,
            "source": self._bag or "live",
            "namespace": self._namespace,
            "duration": self._duration,
            "declared": declared,
            "dark": DARK_DB,
            "bright": BRIGHT_DB,
            "high": SPECTRUM_HIGH,
            "trend": self.trend,
        }
        return packed("hello", values)

    def frame(self) -> bytes | None:
        """Traces of the newest block and the spectrum; None where nothing new has come."""
        with self._lock:
            daq, rig, window = self._daq, self._description, self._window
            if daq is None or rig is None or window is None:
                return None
            samples = window.whole()
            self._daq = None
        x, step = decimated(daq["x"], POINTS)
        y, _ = decimated(daq["y"], POINTS)
        arrays = {"x": 1e6 * x, "y": 1e6 * y}
        if samples is not None and np.isfinite(samples).all():
            lines = spectrum_lines(samples, rig.sample_rate, SPECTRUM_HIGH, POINTS)
            arrays |= {"spectrum": lines.levels, "spectrum_at": lines.frequencies}
        values = {
            "rate": rig.sample_rate / step,
            "preload": float(daq["preload"][-1]),
            "belt_speed": float(daq["belt_speed"][-1]),
            "seq": int(daq["seq"][-1]),
        }
        with self._lock:
            self._numbers |= {"preload": values["preload"], "belt_speed": values["belt_speed"]}
        return packed("frame", values, arrays)

    def state(self) -> bytes:
        """Everything else: numbers, nodes, squeals, trends, the spectrogram. Each message is whole in itself."""
        with self._lock:
            now = self._clock()
            known = [f"{self._namespace}{name}" for name in ("rig", "recorder")]
            nodes = [
                {
                    "name": name,
                    "gone": now - heard >= _GONE,
                    "level": level if now - heard < _GONE else 3,
                    "message": message if now - heard < _GONE else f"gone: not heard for {now - heard:.0f} s",
                    "values": dict(values) if name in known else {},
                }
                for name, (heard, (level, message, values)) in sorted(self._nodes.items())
            ]
            rig = self._description
            set_points = (
                {}
                if rig is None
                else {name: getattr(rig.parameters, name) for name in settable() if hasattr(rig.parameters, name)}
            )
            mu = _aged(np.array(self._mu, float).reshape(-1, 4), now - self._window_came.last)
            level = _aged(np.array(self._level, float).reshape(-1, 2), now - self._squeal_came.last)
            old = _AGAIN if self._squeal_came.is_old(now) else ()
            silent = 0.0 if self._bag or not self._blocks else now - self._came
            columns = (*self._columns, *_dark_columns(silent))[-(self._columns.maxlen or 0) :]
            values = {
                "numbers": {name: value for name, value in self._numbers.items() if name not in old},
                "nodes": [] if self._bag else nodes,
                "set": {**set_points, **self._numbers.get("hit_settings", {})},
                "rig": {} if rig is None else {"driver": rig.driver, "rate": rig.sample_rate},
                "squeals": [dict(row) for row in self._squeals.rows],
                "told": dict(self._told),
                "run": {**self._progress.shown, "gone": not self._run_is_heard} if self._progress.shown else None,
                "limits": self._limit_rows(),
                "silent": now - self._came,
                "trips": list(self._trips),
                "blocks": self._blocks,
                "columns": len(columns),
                **self._shown,
            }
        arrays: dict[str, NDArray[Any]] = {"spectrogram": np.concatenate(columns) if columns else np.zeros(0, np.uint8)}
        arrays |= {"mu_t": mu[:, 0], "mu": mu[:, 1], "mu_means": mu[:, 2], "mu_true": mu[:, 3]}
        if len(mu) and not self._window_came.is_old(now):
            values["mu"] = dict(zip(("windows", "means", "true"), map(float, mu[-1, 1:]), strict=True))
        arrays |= {"level_t": level[:, 0], "level": level[:, 1]}
        return packed("state", values, arrays)

    def take_hit_settings(self, values: Mapping[str, float]) -> None:
        """Take the impact's settings, which the rig's description does not hold."""
        with self._lock:
            self._numbers["hit_settings"] = {**self._numbers.get("hit_settings", {}), **values}

    def _limit_rows(self) -> list[dict[str, Any]]:
        """The supervisor's limits: a row a quantity."""
        known = declarations(SupervisorSettings)
        rows = []
        for quantity in _LIMITED:
            found = {level: self._limits.get(f"{quantity}_{level}") for level in _LEVELS}
            if any(limit is not None for limit in found.values()):
                unit = known[f"{quantity}_warn"].unit
                rows.append({"what": quantity.replace("_", " "), "unit": unit, **found})
        return rows

    def _point(self) -> tuple[float, float]:
        if self._daq is not None:
            return float(self._daq["preload"][-1]), float(self._daq["belt_speed"][-1])
        if "preload" in self._numbers or self._description is None:
            return self._numbers.get("preload", math.nan), self._numbers.get("belt_speed", math.nan)
        return self._description.parameters.preload, self._description.parameters.belt_speed


def column(samples: NDArray[np.float64], sample_rate: float) -> NDArray[np.uint8]:
    """A column of the spectrogram: levels of the lines up to `SPECTRUM_HIGH` as 0 to 255."""
    lines = spectrum_lines(samples, sample_rate, SPECTRUM_HIGH, len(samples))
    # By frequency, not by count: a rig of another rate has other lines, and the axis stays.
    place = np.minimum((lines.frequencies / SPECTRUM_HIGH * COLUMN_LINES).astype(int), COLUMN_LINES - 1)
    levels = np.full(COLUMN_LINES, DARK_DB)
    np.maximum.at(levels, place, lines.levels)
    scaled = np.clip((levels - DARK_DB) / (BRIGHT_DB - DARK_DB), 0.0, 1.0)
    return np.round(255.0 * scaled).astype(np.uint8)


def _dark_columns(silent: float) -> list[NDArray[np.uint8]]:
    """Columns for a time without samples [s], where it is long: what came before is not shown as of now."""
    count = round(min(silent, TREND) * COLUMNS_PER_SECOND) if silent > 1.0 else 0
    return [np.zeros(COLUMN_LINES, np.uint8)] * count


def _aged(rows: NDArray[np.float64], age: float) -> NDArray[np.float64]:
    """Rows (n, m) whose first column, a time, is turned into seconds before now; the last one came `age` [s] ago."""
    if not len(rows):
        return rows
    rows[:, 0] -= rows[-1, 0] + age
    kept: NDArray[np.float64] = rows[rows[:, 0] >= -TREND]
    return kept


def number(status: Status, key: str) -> float:
    """A number out of a status; nan where it has none."""
    try:
        return float(status[2].get(key, "nan"))
    except ValueError:
        return math.nan
