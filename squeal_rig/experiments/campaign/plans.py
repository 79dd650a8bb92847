"""Campaign plans: what is varied, what is done at each point, what ends it, what is kept; read from YAML and checked.

docs/campaigns.md describes every key.
"""

from __future__ import annotations

import hashlib
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from squeal_rig.configuration.declared import declarations
from squeal_rig.configuration.files import parse_yaml, read_text
from squeal_rig.errors import ConfigurationError, ParameterError
from squeal_rig.estimation.bands import band
from squeal_rig.estimation.settings import SquealSettings, ToneSettings
from squeal_rig.estimation.squeal import SquealDetector
from squeal_rig.estimation.squeal_events import SquealEvents
from squeal_rig.experiments.campaign.designs import (
    AS_GIVEN,
    DESIGNS,
    GRID,
    LIST,
    MOST_HELD,
    MOST_POINTS,
    ORDERS,
    RANDOM,
    SOBOL,
    Design,
    Factor,
    spread,
)
from squeal_rig.instruments.settings import RigSettings
from squeal_rig.model.core.law import COEFFICIENTS, friction_refusal
from squeal_rig.model.parameters import RigParameters

EVENTS, LEVEL = "events", "level"
PAD_STIFFNESS = "pad_stiffness"
_LONGEST = 86400.0
#: Largest standard deviation of a parameter from rig to rig, as a share.
MOST_SCATTER = 0.2
_MOST_STEPS, _MOST_LEVELS, _MOST_REPEATS, _MOST_PHASES = 100_000, 100_000, 10_000, 100
# What the friction coefficient of a rig follows.
_OF_FRICTION = ("preload", "belt_speed", *COEFFICIENTS)
_KEYS = (
    "campaign", "note", "rig", "factors", "design", "points", "order", "by_hand", "repeats", "seed", "measure",
    "protocol", "detection", "stop", "scatter",
)  # fmt: skip


@dataclass(frozen=True)
class Phase:
    """One thing done at a point.

    - kind: "reset", "hit", "settle", "dwell" or "ramp"
    - duration [s]: of a dwell; of a settling at most; of each step of a ramp
    - hit: `share` of the smallest hit and its direction, or `impulse` [N s] and `direction` [rad]
    - settle: until the level moves less than `change` [dB] between windows of `over` [s]
    - ramp: `parameter` over `values`, one step after the other
    """

    kind: str
    duration: float = 0.0
    share: float = math.nan
    impulse: float = math.nan
    direction: float = -0.5 * math.pi
    change: float = math.nan
    over: float = math.nan
    parameter: str = ""
    values: tuple[float, ...] = ()
    turn: int = 0  # index of the first value on the way back; 0: one way

    @property
    def longest(self) -> float:
        """Time it takes at most [s]."""
        return self.duration * (len(self.values) if self.kind == "ramp" else 1)


@dataclass(frozen=True)
class Stop:
    """When a campaign, or a point, ends early: failed points in all; time of the campaign [s]; level [dB re 1 um]."""

    failures: int = 1_000_000
    duration: float = math.inf
    level: float = math.inf


@dataclass(frozen=True)
class Campaign:
    """A checked plan. `base`: the rig that factors are changed on; `scatter`: parameter -> standard deviation from
    rig to rig, as a share.
    """

    title: str
    base: RigParameters
    design: Design
    protocol: tuple[Phase, ...]
    measure: str = EVENTS
    start: float = 0.1
    settle: float = 0.0
    squeal: SquealSettings = field(default_factory=SquealSettings)
    tones: ToneSettings = field(default_factory=ToneSettings)
    stop: Stop = field(default_factory=Stop)
    scatter: Mapping[str, float] = field(default_factory=dict)
    note: str = ""
    text: str = ""

    @property
    def crc(self) -> str:
        """Digest of the plan's text, by which results know the plan they belong to."""
        return hashlib.sha256(self.text.encode()).hexdigest()[:16]

    @property
    def point_duration(self) -> float:
        """Sampled time of one point at most [s]."""
        return sum(phase.longest for phase in self.protocol)

    def rig(self, values: Mapping[str, float]) -> RigParameters:
        """The rig at one point."""
        return self.base.replace(**{name: float(value) for name, value in values.items()})


def load_campaign(path: Path | str) -> Campaign:
    """Read and check a campaign plan.

    Raises:
        ConfigurationError: the file is none; the sentence names the file, the key and the reason.
    """
    return parse_campaign(read_text(path), str(path))


def parse_campaign(text: str, source: str) -> Campaign:
    """A campaign plan from its text; `source` is its name in sentences."""
    content = parse_yaml(text, source)
    if not isinstance(content, dict):
        raise ConfigurationError(f"{source}: campaign: a plan is a mapping of {', '.join(_KEYS)}, got {content!r}")
    reader = _Reader(source, "", content)
    reader.known(_KEYS)
    title = reader.text("campaign")
    base = reader.tried("rig", lambda: _base(reader.mapping("rig", {})))
    design = _design(reader, base)
    measure = reader.choice("measure", EVENTS, (EVENTS, LEVEL))
    protocol = _protocol(reader, base)
    start, settle = _plain_protocol(reader, protocol, measure)
    squeal, tones = _detection(reader)
    detect_window = min(squeal.window, tones.tone_window)
    if measure == EVENTS and not any(p.kind in ("dwell", "ramp") for p in protocol):
        reader.refuse("protocol", "it measures nothing: it needs a dwell or a ramp")
    for phase in protocol:
        if phase.kind in ("dwell", "ramp") and phase.duration < 2.0 * detect_window:
            reader.refuse(
                f"protocol.{phase.kind}",
                f"{phase.duration:g} s is out of bounds: it must be at least two windows of {detect_window:g} s",
            )
    stop = _stop(reader)
    if measure == LEVEL and math.isfinite(stop.level):
        reader.refuse("stop.level", "with measure: level nobody looks at the level before a point has ended")
    if measure == EVENTS:
        rate = RigSettings().sample_rate
        reader.tried("detection", lambda: SquealDetector(rate, squeal))
        reader.tried("detection", lambda: SquealEvents(rate, squeal, tones))
    _check_friction(reader, base, design)
    return Campaign(
        title, base, design, protocol, measure, start, settle, squeal, tones, stop, _scatter(reader, base),
        str(content.get("note", "")), text,
    )  # fmt: skip


class _Reader:
    """Takes values out of one mapping of the plan; every refusal names the file, the key and the reason."""

    def __init__(self, source: str, where: str, content: Mapping[str, Any]) -> None:
        self.source, self._where, self._content = source, where, content

    def key(self, name: str) -> str:
        return f"{self._where}.{name}" if self._where else name

    def refuse(self, key: str, reason: str) -> None:
        raise ConfigurationError(f"{self.source}: {self.key(key)}: {reason}")

    def known(self, names: Sequence[str]) -> None:
        for name in self._content:
            if name not in names:
                self.refuse(str(name), f"unknown key: there are {', '.join(names)}")

    def tried(self, key: str, make: Callable[[], Any]) -> Any:
        try:
            return make()
        except (ParameterError, ConfigurationError) as error:
            if str(error).startswith(self.source):
                raise
            raise ConfigurationError(f"{self.source}: {self.key(key)}: {error}") from None

    def has(self, name: str) -> bool:
        return name in self._content

    def raw(self, name: str) -> Any:
        return self._content.get(name)

    def text(self, name: str) -> str:
        value = self._content.get(name)
        if not isinstance(value, str) or not value.strip():
            self.refuse(name, f"it must be a text, got {value!r}")
        return str(value)

    def mapping(self, name: str, default: Mapping[str, Any]) -> Mapping[str, Any]:
        value = self._content.get(name, default)
        if not isinstance(value, dict):
            self.refuse(name, f"it must be a mapping, got {value!r}")
        return dict(value)

    def number(self, name: str, default: float, low: float, high: float, unit: str = "") -> float:
        value = self._content.get(name, default)
        bound = f"{low:g} to {high:g}{' ' + unit if unit else ''}"
        self._need(name, default, low, high, bound)
        if isinstance(value, bool) or not isinstance(value, int | float):
            self.refuse(name, f"{value!r} is not a number: it must be {bound}")
        if not low <= value <= high:  # first: a whole number may be too long for a float
            self.refuse(name, f"{str(value)[:40]} is out of bounds: it must be {bound}")
        if not (math.isfinite(value) or value == default) or not low <= value <= high:
            self.refuse(name, f"{value!r} is out of bounds: it must be {bound}")
        return float(value)

    def integer(self, name: str, default: int, low: int, high: int) -> int:
        value = self._content.get(name, default)
        self._need(name, default, low, high, f"{low} to {high}")
        if isinstance(value, bool) or not isinstance(value, int):
            self.refuse(name, f"{value!r} is not an integer: it must be {low} to {high}")
        if not low <= value <= high:
            self.refuse(name, f"{value!r} is out of bounds: it must be {low} to {high}")
        return int(value)

    def _need(self, name: str, default: float, low: float, high: float, bound: str) -> None:
        """Refuse a value that is not there where the default is none."""
        if not self.has(name) and not low <= default <= high:
            self.refuse(name, f"it is missing: it must be {bound}")

    def choice(self, name: str, default: str, options: Sequence[str]) -> str:
        value = self._content.get(name, default)
        if value not in options:
            self.refuse(name, f"{value!r} is not known: it must be one of {', '.join(options)}")
        return str(value)

    def words(self, name: str, default: Sequence[str], options: Sequence[str]) -> list[str]:
        value = self._content.get(name, list(default))
        if not isinstance(value, list):
            self.refuse(name, f"it must be a list of {', '.join(options)}, got {value!r}")
        for word in value:
            if word not in options:
                self.refuse(name, f"{word!r} is not known: it must be one of {', '.join(options)}")
        if len(set(value)) < len(value):
            self.refuse(name, "a word stands in it twice")
        return [str(word) for word in value]

    def inside(self, name: str, content: object) -> _Reader:
        if not isinstance(content, dict):
            self.refuse(name, f"it must be a mapping, got {content!r}")
        return _Reader(self.source, self.key(name), dict(content))  # type: ignore[call-overload]


def _base(values: Mapping[str, Any]) -> RigParameters:
    rest = dict(values)
    wrong = set(map(str, rest)) - set(declarations(RigParameters)) - {"preset", PAD_STIFFNESS}
    if wrong:
        raise ParameterError(f"{', '.join(sorted(wrong))}: no parameter of the rig")
    rest = {str(key): value for key, value in rest.items()}
    base = RigParameters.preset(str(rest.pop("preset", "yavuz_sen_2023"))).replace(**rest)
    sentence = friction_refusal(base)
    if sentence:
        raise ParameterError(sentence)
    return base


def _design(reader: _Reader, base: RigParameters) -> Design:
    raw = reader.raw("factors")
    if not isinstance(raw, dict) or not raw:
        reader.refuse("factors", f"it must be a mapping of parameters to what they vary over, got {raw!r}")
    kind = reader.choice("design", GRID, DESIGNS)
    group = reader.inside("factors", raw)
    factors = tuple(_factor(group, str(name), body, kind, base) for name, body in raw.items())
    if len({f.name for f in factors} & {PAD_STIFFNESS, "k1", "k2"}) > 1 and PAD_STIFFNESS in raw:
        reader.refuse("factors", "pad_stiffness sets k1 and k2: vary it, or them")
    samples = 0
    if kind in (GRID, LIST):
        if reader.has("points"):
            reader.refuse("points", f"a {kind} has the points that its factors give it: leave it out")
    else:
        if not reader.has("points"):
            reader.refuse("points", f"a design {kind!r} must say how many")
        samples = reader.integer("points", 0, 1, MOST_POINTS if kind == SOBOL else MOST_HELD)
        if kind == SOBOL and samples & (samples - 1):
            reader.refuse("points", f"{samples} is no power of two, without which a Sobol sequence is not balanced")
    if kind == LIST and len({len(f.levels) for f in factors}) > 1:
        lengths = ", ".join(f"{f.name} {len(f.levels)}" for f in factors)
        reader.refuse("factors", f"in a list every factor has a value for each point, here: {lengths}")
    order = reader.choice("order", AS_GIVEN, ORDERS)
    if order == "serpentine" and kind != GRID:
        reader.refuse("order", f"serpentine is an order of a grid, and the design is {kind!r}")
    by_hand = tuple(reader.words("by_hand", (), [f.name for f in factors]))
    repeats = reader.integer("repeats", 1, 1, _MOST_REPEATS)
    design = Design(kind, factors, samples, order, repeats, reader.integer("seed", 1, 0, 2**31 - 1), by_hand)
    most = MOST_HELD if order == RANDOM or by_hand else MOST_POINTS
    if design.count > most:
        reader.refuse("factors", f"{design.count} points are out of bounds: at most {most}")
    return design


def _check_friction(reader: _Reader, base: RigParameters, design: Design) -> None:
    """Refuse factors over which friction pushes the pad against the belt: the law is largest and least at corners."""
    ends = {f.name: (min(f.levels), max(f.levels)) if f.levels else (f.low, f.high) for f in design.factors}
    varied = {name: values for name, values in ends.items() if name in _OF_FRICTION}
    for corner in itertools.product(*varied.values()):
        values = dict(zip(varied, corner, strict=True))
        sentence = friction_refusal(base.replace(**values))
        if sentence:
            where = ", ".join(f"{name} = {value:g}" for name, value in values.items())
            reader.refuse("factors", f"{sentence} ({where})" if values else sentence)


def _factor(group: _Reader, name: str, body: object, kind: str, base: RigParameters) -> Factor:
    known = declarations(RigParameters)
    if name != PAD_STIFFNESS and name not in known:
        group.refuse(name, f"unknown parameter: there are {PAD_STIFFNESS}, {', '.join(known)}")
    if name != PAD_STIFFNESS and known[name].kind is not float:
        group.refuse(name, "it is no number, and only numbers vary")
    sampled = kind not in (GRID, LIST)
    if isinstance(body, list):
        if sampled:
            group.refuse(name, f"a design {kind!r} samples ranges: give from and to")
        levels = tuple(_level(group, name, value) for value in body)
        if not levels:
            group.refuse(name, "it has no values")
        if kind == GRID and len(set(levels)) < len(levels):
            group.refuse(name, "a value stands in it twice: repeats are a key of their own")
        factor = Factor(name, levels)
    else:
        inner = group.inside(name, body)
        inner.known(("from", "to", "count", "scale"))
        for end in ("from", "to"):
            if not inner.has(end):
                inner.refuse(end, "it is missing: a range has from and to")
        low, high = (inner.number(end, math.nan, -1e12, 1e12) for end in ("from", "to"))
        log = inner.choice("scale", "linear", ("linear", "log")) == "log"
        if log and not low * high > 0.0:
            inner.refuse("scale", "a logarithmic range must not reach to 0 or across it")
        if low == high:
            inner.refuse("to", "the range is empty: from and to are the same")
        if sampled and inner.has("count"):
            inner.refuse("count", f"a design {kind!r} samples the range: the number of points is the key points")
        if not sampled and not inner.has("count"):
            inner.refuse("count", "it is missing: how many values between from and to")
        count = 0 if sampled else inner.integer("count", 0, 2, _MOST_LEVELS)
        factor = Factor(name, spread(low, high, count, log) if count else (), low, high, log)
    # Between two values that a parameter may have it may have all.
    for value in factor.levels if isinstance(body, list) else (factor.low, factor.high):
        group.tried(name, lambda value=value: base.replace(**{name: value}))  # type: ignore[misc]
    return factor


def _level(group: _Reader, name: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        group.refuse(name, f"{value!r} is not a number")
    if not -1e300 <= value <= 1e300:  # type: ignore[operator]
        group.refuse(name, f"{str(value)[:40]} is out of bounds: it must be -1e300 to 1e300")
    return float(value)  # type: ignore[arg-type]


def _protocol(reader: _Reader, base: RigParameters) -> tuple[Phase, ...]:
    raw = reader.raw("protocol")
    if not isinstance(raw, list) or not raw:
        reader.refuse("protocol", f"it must be a list of reset, start, hit, settle, dwell and ramp, got {raw!r}")
    if len(raw) > _MOST_PHASES:
        reader.refuse("protocol", f"it has {len(raw)} phases, of at most {_MOST_PHASES}")
    phases: list[Phase] = []
    for number, item in enumerate(raw, 1):
        where = f"protocol.{number}"
        if item == "reset":
            phases.append(Phase("reset"))
            continue
        if not isinstance(item, dict) or len(item) != 1:
            reader.refuse(
                where, f"a phase is reset, or one of start, hit, settle, dwell, ramp with its values, got {item!r}"
            )
        (kind, body), *_ = item.items()
        makers = {"start": _start, "hit": _hit, "settle": _settle, "dwell": _dwell, "ramp": _ramp}
        if kind not in makers:
            reader.refuse(f"{where}.{kind}", f"unknown phase: there are reset, {', '.join(makers)}")
        single = body if kind in ("hit", "settle", "ramp") else {kind: body}
        inner = reader.inside(f"{where}.{kind}" if kind in ("hit", "settle", "ramp") else where, single)
        phases.append(makers[kind](inner, base))
        if sum(len(phase.values) for phase in phases) > 2 * _MOST_STEPS:
            reader.refuse(where, f"all ramps together have more than {2 * _MOST_STEPS} steps")
    return tuple(phases)


def _start(inner: _Reader, _base: RigParameters) -> Phase:
    return Phase("start", impulse=inner.number("start", 0.1, 0.0, 100.0, "static compressions"))


def _dwell(inner: _Reader, _base: RigParameters) -> Phase:
    return Phase("dwell", inner.number("dwell", math.nan, 0.01, _LONGEST, "s"))


def _hit(inner: _Reader, _base: RigParameters) -> Phase:
    inner.known(("share", "impulse", "direction"))
    if inner.has("share") == inner.has("impulse"):
        inner.refuse("share", "a hit has either a share of the smallest one or an impulse")
    if inner.has("share"):
        if inner.has("direction"):
            inner.refuse("direction", "a share is of the smallest hit, which has its own direction")
        return Phase("hit", share=inner.number("share", 0.0, 0.0, 100.0))
    impulse = inner.number("impulse", 0.0, 0.0, 100.0, "N s")
    return Phase("hit", impulse=impulse, direction=inner.number("direction", -0.5 * math.pi, -math.pi, math.pi, "rad"))


def _settle(inner: _Reader, _base: RigParameters) -> Phase:
    inner.known(("longest", "change", "over"))
    longest = inner.number("longest", math.nan, 0.01, _LONGEST, "s")
    change = inner.number("change", 0.0, 0.0, 100.0, "dB")
    over = inner.number("over", 0.2, 0.02, _LONGEST, "s")
    if over > longest:
        inner.refuse("over", f"{over:g} s is longer than the settling itself, {longest:g} s")
    return Phase("settle", longest, change=change, over=over)


def _ramp(inner: _Reader, base: RigParameters) -> Phase:
    inner.known(("parameter", "from", "to", "steps", "hold", "scale", "back"))
    known = declarations(RigParameters)
    parameter = inner.text("parameter")
    if parameter != PAD_STIFFNESS and (parameter not in known or known[parameter].kind is not float):
        inner.refuse("parameter", f"{parameter!r} is not known or no number")
    low, high = (inner.number(end, math.nan, -1e12, 1e12) for end in ("from", "to"))
    steps = inner.integer("steps", 0, 2, _MOST_STEPS)
    log = inner.choice("scale", "linear", ("linear", "log")) == "log"
    if log and not low * high > 0.0:
        inner.refuse("scale", "a logarithmic ramp must not reach to 0 or across it")
    if low == high:
        inner.refuse("to", "the ramp goes nowhere: from and to are the same")
    back = inner.raw("back")
    if back is not None and not isinstance(back, bool):
        inner.refuse("back", f"{back!r} is not a truth value: write true or false")
    up = spread(low, high, steps, log)
    values = (*up, *up[-2::-1]) if back else up
    for end, value in (("from", low), ("to", high)):
        inner.tried(end, lambda value=value: base.replace(**{parameter: value}))  # type: ignore[misc]
    hold = inner.number("hold", math.nan, 0.01, _LONGEST, "s")
    return Phase("ramp", hold, parameter=parameter, values=values, turn=len(up) if back else 0)


def _plain_protocol(reader: _Reader, protocol: tuple[Phase, ...], measure: str) -> tuple[float, float]:
    """Start [static compressions] and settling time [s] of a protocol of `level`: start, settle, one dwell."""
    kinds = [phase.kind for phase in protocol]
    if measure == EVENTS:
        if "start" in kinds:
            reader.refuse("protocol", "start is of measure: level only; a rig is set in motion by a hit")
        return 0.0, 0.0
    if kinds not in (["start", "dwell"], ["start", "settle", "dwell"]):
        reader.refuse("protocol", "with measure: level it is start, settle (or not) and one dwell")
    settle = sum(phase.duration for phase in protocol if phase.kind == "settle")
    return protocol[0].impulse, settle


def _detection(reader: _Reader) -> tuple[SquealSettings, ToneSettings]:
    inner = reader.inside("detection", reader.mapping("detection", {}))
    own, tones = declarations(SquealSettings), declarations(ToneSettings)
    inner.known(("band", *own, *tones))
    values = dict(reader.mapping("detection", {}))
    name = values.pop("band", None)
    chosen: dict[str, Any] = {}
    if name is not None:
        found = inner.tried("band", lambda: band(str(name)))
        chosen = {
            "band_low": found.low,
            "band_high": found.high,
            "on_level": found.level,
            "off_level": found.level - 6.0,
        }
    squeal = {**chosen, **{key: value for key, value in values.items() if key in own}}
    made = reader.tried("detection", lambda: SquealSettings.from_mapping(squeal))
    return made, reader.tried(
        "detection", lambda: ToneSettings.from_mapping({k: v for k, v in values.items() if k in tones})
    )


def _stop(reader: _Reader) -> Stop:
    inner = reader.inside("stop", reader.mapping("stop", {}))
    inner.known(("failures", "duration", "level"))
    return Stop(
        inner.integer("failures", 1_000_000, 1, MOST_POINTS),
        inner.number("duration", math.inf, 0.1, math.inf, "s"),
        inner.number("level", math.inf, -200.0, math.inf, "dB re 1 um"),
    )


def _scatter(reader: _Reader, base: RigParameters) -> dict[str, float]:
    values = reader.mapping("scatter", {})
    inner, known = reader.inside("scatter", values), declarations(RigParameters)
    for name in values:
        if name != PAD_STIFFNESS and (name not in known or known[name].kind is not float):
            inner.refuse(str(name), "it is not known or no number")
        if not getattr(base, "k1" if name == PAD_STIFFNESS else name):
            inner.refuse(str(name), "it is 0, and a scatter is a share of the value")
    return {name: inner.number(name, math.nan, 1e-6, MOST_SCATTER) for name in values}
