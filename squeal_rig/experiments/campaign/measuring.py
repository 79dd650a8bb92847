"""What is done and seen at one point of a campaign: its phases on a bench, its tones, its verdict; and whole chunks."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from squeal_rig.errors import ModelError
from squeal_rig.estimation.spectra import amplitude_spectrum, band_rms, level_db, refuse_empty_band
from squeal_rig.estimation.squeal_events import SquealEvent, SquealEvents
from squeal_rig.estimation.tones import ToneFinder
from squeal_rig.experiments.campaign.bench import Bench, EngineBench
from squeal_rig.experiments.campaign.plans import LEVEL, PAD_STIFFNESS, Campaign, Phase, parse_campaign
from squeal_rig.model.core.law import friction_law
from squeal_rig.model.linear.maps import map_points
from squeal_rig.model.motion.ensemble import STATUS, simulate_many
from squeal_rig.model.motion.trajectory import LARGE_DISPLACEMENT

Values = NDArray[np.float64]
Table = dict[str, NDArray[Any]]

_NO_IMPACT = "no impact was given: its impulse is 0 N s, no hit is known that starts squeal here, or none is needed"
QUIET, SQUEAL, IRREGULAR, STOPPED, FAILED = "quiet", "squeal", "irregular", "stopped", "failed"
#: What each verdict says.
VERDICTS = {
    QUIET: "no tone reaches the level",
    SQUEAL: "a tone reaches the level, for as long as squeal must last",
    IRREGULAR: "loud, and no tone stands out",
    STOPPED: "ended by the plan's rule on the level",
    FAILED: "not judged: the note says why",
}
#: And with `measure: level`, which follows no tones.
VERDICTS_BY_LEVEL = {
    **VERDICTS,
    QUIET: "the level is not reached, or a stable rig rings in contact",
    SQUEAL: "the level is reached over the dwell, and the pad left the belt or the equilibrium is unstable",
}
OUT, BACK = "out", "back"


class StoppedByLevel(Exception):  # noqa: N818
    """The level is above the plan's rule."""


@dataclass
class Point:
    """What was measured at one point: one row, its events, the steps of its ramps."""

    row: dict[str, Any]
    events: list[SquealEvent] = field(default_factory=list)
    steps: list[dict[str, Any]] = field(default_factory=list)


def measure_point(campaign: Campaign, values: Mapping[str, float], bench: Bench) -> Point:
    """Do the phases of the protocol at one point."""
    return _Measurement(campaign, bench).done(values)


class _Measurement:
    def __init__(self, campaign: Campaign, bench: Bench) -> None:
        self._campaign, self._bench = campaign, bench
        rate = bench.sample_rate
        self._events = SquealEvents(rate, campaign.squeal, campaign.tones)
        self._rate = rate
        refuse_empty_band(rate, self._window, campaign.squeal.band_low, campaign.squeal.band_high)
        self._time = 0
        self._values: Mapping[str, float] = {}
        self._ramps = 0
        self._lowest, self._highest = math.inf, -math.inf  # displacement along the belt [m]
        self._point = Point(
            {
                "verdict": FAILED, "level": math.nan, "frequency": math.nan, "tonality": math.nan, "tones": 0,
                "squeals_at_end": False, "settled": math.nan, "hit": math.nan,
                "squeal_from": math.nan, "squeal_to": math.nan, "duration": 0.0, "note": "",
            }
        )  # fmt: skip

    def done(self, values: Mapping[str, float]) -> Point:
        row = self._point.row
        try:
            self._values = _home(self._campaign, values)
            self._bench.set_parameters(self._values)
            for phase in self._campaign.protocol:
                getattr(self, f"_{phase.kind}")(phase)
        except StoppedByLevel:
            rule = f"stop.level = {self._campaign.stop.level:g} dB re 1 um"
            row["verdict"], row["note"] = STOPPED, f"the level was above {rule}"
            if self._squealing:
                row["frequency"] = max(self._squealing, key=lambda event: event.levels[-1]).frequencies[-1]
        except ModelError as error:
            row["verdict"], row["note"] = FAILED, str(error)
        rig = self._campaign.rig(values)
        # Half of its way: a transducer may read anything at rest.
        moved = 0.5 * (self._highest - self._lowest)
        note = _outside(moved, min(rig.arm_length_1, rig.arm_length_2))
        if note and row["verdict"] != FAILED:
            row["verdict"], row["note"] = FAILED, note
        self._point.events += self._events.finish()
        for event in self._point.events:  # numbers by time of onset
            event.number = 0
        for number, event in enumerate(sorted(self._point.events, key=lambda event: event.onset), 1):
            event.number = number
        row["duration"] = self._time / self._rate
        return self._point

    def _run(self, duration: float) -> Values:
        """Run, follow the tones, and return the last second of x (n,) [m]; the plan's rule on the level may end it."""
        pieces: deque[Values] = deque()
        kept = unjudged = 0
        for x in self._bench.run(duration):
            self._point.events += self._events.add_signal(x)
            self._time += len(x)
            self._lowest, self._highest = min(self._lowest, float(x.min())), max(self._highest, float(x.max()))
            pieces.append(x)
            kept, unjudged = kept + len(x), unjudged + len(x)
            while kept - len(pieces[0]) >= max(self._rate, self._window):
                kept -= len(pieces.popleft())
            if self._campaign.stop.level < math.inf and unjudged >= self._window:
                unjudged = 0
                self._stop_above(np.concatenate(pieces))
        signal = np.concatenate(pieces)
        self._stop_above(signal)
        return signal

    @property
    def _window(self) -> int:
        return max(2, round(self._campaign.squeal.window * self._rate))

    def _stop_above(self, signal: Values) -> None:
        if self._campaign.stop.level < math.inf:
            level = self._level(signal)
            if level > self._campaign.stop.level:
                self._point.row["level"] = level
                raise StoppedByLevel

    def _level(self, signal: Values) -> float:
        band = self._campaign.squeal
        return level_db(
            band_rms(*amplitude_spectrum(signal[-self._window :], self._rate), band.band_low, band.band_high)
        )

    @property
    def _squealing(self) -> list[SquealEvent]:
        least = self._campaign.tones.least_duration
        return [event for event in self._events.current if event.duration >= least and math.isnan(event.harmonic_of)]

    def _reset(self, _phase: Phase) -> None:
        self._bench.set_parameters(self._values)  # a ramp may have left them
        self._bench.reset()
        self._point.events += self._events.finish()

    def _hit(self, phase: Phase) -> None:
        impulse, direction = phase.impulse, phase.direction
        if math.isfinite(phase.share):
            smallest, direction = self._bench.smallest_hit()
            impulse = phase.share * smallest
        if not math.isfinite(impulse) or impulse <= 0.0:
            self._point.row["note"] = _NO_IMPACT
            return
        self._point.row["hit"] = impulse
        self._bench.hit(impulse, direction)

    def _settle(self, phase: Phase) -> None:
        begin, before = self._time, math.inf
        while (self._time - begin) / self._rate + phase.over <= phase.duration * (1.0 + 1e-9):
            level = self._level(self._run(phase.over))
            if abs(level - before) < phase.change or level == before:
                break
            before = level
        self._point.row["settled"] = (self._time - begin) / self._rate

    def _dwell(self, phase: Phase) -> None:
        signal = self._run(phase.duration)
        begin = self._time / self._rate - phase.duration  # what came late before it is not of the dwell
        row, band = self._point.row, self._campaign.squeal
        row["level"] = self._level(signal)
        last = signal[-min(self._rate, round(phase.duration * self._rate)) :]
        tones = ToneFinder(self._rate, len(last), band, self._campaign.tones).tones(last, band.off_level)
        row["tones"] = len(tones)
        row["squeals_at_end"] = bool(self._squealing and tones)
        if row["squeals_at_end"]:
            row["verdict"], row["frequency"], row["tonality"] = SQUEAL, tones[0].frequency, tones[0].tonality
        elif during := self._during(begin, phase.duration):
            loudest = max(during, key=lambda event: event.level)
            row["verdict"], row["frequency"], row["tonality"] = SQUEAL, loudest.frequency, loudest.tonality
        else:
            row["verdict"] = IRREGULAR if row["level"] >= band.on_level else QUIET

    def _during(self, begin: float, duration: float) -> list[SquealEvent]:
        """Squeals of which the least duration, or the whole dwell where that is shorter, lies in a dwell."""
        least = self._campaign.tones.least_duration
        wanted = min(least, duration) - 1.0 / self._rate
        return [
            event
            for event in (*self._point.events, *self._events.current)
            if math.isnan(event.harmonic_of)
            and event.duration >= least
            and min(event.onset + event.duration, begin + duration) - max(event.onset, begin) >= wanted
        ]

    def _ramp(self, phase: Phase) -> None:
        row, found = self._point.row, len(self._point.steps)
        self._ramps += 1
        for number, value in enumerate(phase.values):
            self._bench.set_parameters({phase.parameter: value})
            level = self._level(self._run(phase.duration))
            squealing = self._squealing
            loudest = max(squealing, key=lambda event: event.levels[-1], default=None)
            leg = OUT if not phase.turn or number < phase.turn else BACK
            self._point.steps.append(
                {
                    "ramp": self._ramps, "parameter": phase.parameter, "value": value, "leg": leg, "level": level,
                    "squealing": loudest is not None,
                    "frequency": math.nan if loudest is None else loudest.frequencies[-1],
                }
            )  # fmt: skip
        steps = self._point.steps[found:]
        if math.isnan(row["squeal_from"]):  # of the first ramp that squeals; `steps` has them all
            row["squeal_from"], row["squeal_to"] = start_and_end(
                [s["value"] for s in steps], [s["leg"] for s in steps], [s["squealing"] for s in steps]
            )
        if row["verdict"] == FAILED:
            row["verdict"] = SQUEAL if any(step["squealing"] for step in steps) else QUIET


def is_unstable(points: Table) -> NDArray[np.bool_]:
    """Where the linearised rig is unstable: only what grows has a frequency of squeal (`stability_map`)."""
    return np.isfinite(points["predicted_frequency"])


def _outside(largest: float, arm: float) -> str:
    """Why a motion of that displacement [m] is none of the model's with an arm so long [m]; empty where it may be."""
    if largest <= LARGE_DISPLACEMENT * arm:
        return ""
    return f"the pad moved by {largest:.3g} m, above {LARGE_DISPLACEMENT:g} of the arm length {arm:g} m: no squeal"


def _home(campaign: Campaign, values: Mapping[str, float]) -> dict[str, float]:
    """What is set at a point: its factors, and all that ramps change, which one before may have left elsewhere."""
    ramped = {phase.parameter for phase in campaign.protocol if phase.kind == "ramp"}
    home, rig = dict(values), campaign.rig(values)
    if PAD_STIFFNESS in ramped:
        home.pop(PAD_STIFFNESS, None)
        ramped = ramped - {PAD_STIFFNESS} | {"k1", "k2"}
    return home | {name: float(getattr(rig, name)) for name in ramped}


def start_and_end(values: Sequence[float], legs: Sequence[str], squealing: Sequence[bool]) -> tuple[float, float]:
    """Value of a ramp at which squeal starts on the way out, and at which it ends on the way back; nan where not.

    Where it squealed when the ramp began it starts at none of its values.
    """

    def first(leg: str, starts: bool) -> float:
        found = (
            values[i]
            for i in range(1, len(values))
            if legs[i] == leg and bool(squealing[i]) == starts and bool(squealing[i - 1]) != starts
        )
        return float(next(found, math.nan))

    return first(OUT, True), first(BACK, False)


def measure_chunk(text: str, first: int, last: int) -> dict[str, Table]:
    """Measure the places `first` to `last` of a campaign's order by the engine; the tables `points`, `events`, `steps`.

    All that it needs comes with the call, so any process on any machine does it, with the same result.
    """
    campaign = _parsed(text)
    if campaign.measure == LEVEL:
        return {"points": _levels(campaign, first, last)}
    rows = []
    base = head(campaign, first, last)
    for i in range(len(base["place"])):
        values = {f.name: float(base[f.name][i]) for f in campaign.design.factors}
        bench = EngineBench(campaign.base)
        rows.append(measure_point(campaign, values, bench))
    return tables_of(base, rows)


@lru_cache(maxsize=4)
def _parsed(text: str) -> Campaign:
    return parse_campaign(text, "the plan")


def head(campaign: Campaign, first: int, last: int) -> Table:
    """Columns known before anything is measured: place in the order, point, repeat, factors, and what is predicted."""
    design = campaign.design
    points = design.points(first, last)
    values = design.values(points)
    table: Table = {
        "place": np.arange(first, first + len(points), dtype=np.int64),
        "point": points,
        "repeat": design.repeat_of(first, last),
        **values,
    }
    fields: dict[str, Any] = {**campaign.base.as_mapping(), **values}
    if "pad_stiffness" in fields:
        fields["k1"] = fields["k2"] = fields.pop("pad_stiffness")
    mu = np.broadcast_to(friction_law(fields, fields["belt_speed"], fields["preload"]), points.shape)
    found = map_points(fields, threads=1)
    table["mu"] = np.array(mu, dtype=np.float64)
    for name, column in (
        ("predicted_growth", found.growth_rate),
        ("predicted_frequency", found.squeal_frequency),
        ("critical_pad_stiffness", found.critical_pad_stiffness),
    ):
        table[name] = np.array(np.broadcast_to(column, points.shape), dtype=np.float64)
    return table


def _levels(campaign: Campaign, first: int, last: int) -> Table:
    table = head(campaign, first, last)
    values: dict[str, Any] = {f.name: table[f.name] for f in campaign.design.factors}
    dwell = campaign.protocol[-1].duration
    found = simulate_many(
        campaign.base, dwell, settle=campaign.settle, initial_compressions=campaign.start, threads=1, **values
    ).summaries
    with np.errstate(divide="ignore"):
        level = 20.0 * np.log10(found["rms_x"] / 1e-6)
    failed = found["status"] != 0
    # In contact the motion is linear: where it does not grow, what stays in contact rings, and is no squeal.
    lasts = (found["separations"] > 0) | is_unstable(table)
    squeals = (level >= campaign.squeal.on_level) & lasts
    arms = [values.get(name, getattr(campaign.base, name)) for name in ("arm_length_1", "arm_length_2")]
    arm, largest = np.minimum(*arms), np.maximum(found["peak_x"], found["peak_y"])
    outside = np.full(len(level), "", dtype=object)
    for i in np.flatnonzero(~failed & (largest > LARGE_DISPLACEMENT * arm)).tolist():
        outside[i] = _outside(float(largest[i]), float(np.broadcast_to(arm, largest.shape)[i]))
    table["verdict"] = np.where(failed | (outside != ""), FAILED, np.where(squeals, SQUEAL, QUIET))
    table["level"] = level
    for name in ("peak_x", "squeal_frequency", "growth_rate", "contact_share", "separations"):
        table["frequency" if name == "squeal_frequency" else name] = found[name].copy()
    table["note"] = np.where(failed, np.array(STATUS)[found["status"]], outside).astype(str)
    return table


def tables_of(base: Table, points: list[Point]) -> dict[str, Table]:
    """The tables of measured points; `base` has the columns of `head`."""
    table = dict(base)
    for name in points[0].row if points else ():
        table[name] = np.array([point.row[name] for point in points])
    events, steps = [], []
    for place, number, point in zip(base["place"], base["point"], points, strict=True):
        own = {"place": int(place), "point": int(number)}
        events += [{**own, **event_row(event)} for event in sorted(point.events, key=lambda e: e.number)]
        steps += [{**own, "step": i, **step} for i, step in enumerate(point.steps)]
    return {"points": table, "events": _columns(events), "steps": _columns(steps)}


def event_row(event: SquealEvent) -> dict[str, Any]:
    """One event as a row; times in s since the point began."""
    return {
        "event": event.number, "onset": event.onset, "end": event.end, "duration": event.duration,
        "frequency": event.frequency, "level": event.level, "tonality": event.tonality,
        "growth": event.growth.rate, "growth_error": event.growth.error, "growth_residual": event.growth.residual,
        "growth_frequency": event.growth.frequency, "decay": event.decay.rate, "decay_error": event.decay.error,
        "harmonics": " ".join(str(h.order) for h in event.harmonics), "harmonic_of": event.harmonic_of,
        "lowest_frequency": min(event.frequencies), "highest_frequency": max(event.frequencies),
    }  # fmt: skip


def _columns(rows: list[dict[str, Any]]) -> Table:
    return {name: np.array([row[name] for row in rows]) for name in rows[0]} if rows else {}
