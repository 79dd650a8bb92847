"""A calibration as data: which parameters are free and within what, how targets weigh, what is demanded of friction."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from squeal_rig.configuration.declared import Declaration, declarations, unknown_name
from squeal_rig.configuration.files import load_yaml
from squeal_rig.errors import ConfigurationError, ParameterError
from squeal_rig.estimation.calibration.targets import (
    KINDS,
    Targets,
    load_targets,
    looks_like_targets,
    mapping,
    number,
    read_targets,
)
from squeal_rig.model.core.law import COEFFICIENTS
from squeal_rig.model.parameters import RigParameters

EQUILIBRIA = ("linear", "exact")
MEASURES = ("rms", "mean", "largest")
_KEYS = (
    "title",
    "targets",
    "preset",
    "free",
    "tied",
    "friction",
    "weights",
    "limits",
    "measure",
    "equilibrium",
    "simulation",
)
_NEEDED = ("targets", "free")
#: Where a file of targets alone is calibrated: the constants that the paper does not print.
_DEFAULT_FREE: dict[str, tuple[float, float]] = {
    "mass": (1.0, 15.0),
    "contact_stiffness": (1e8, 1e10),
    "k3": (1e7, 5e9),
    **dict.fromkeys(COEFFICIENTS, (math.nan, math.nan)),
}
_DEFAULT_WEIGHTS = {"critical_pad_stiffness": 1.0, "squeal_frequency": 0.1}


@dataclass(frozen=True)
class Free:
    """A free parameter within bounds, in its own unit; searched on a logarithmic scale where `log`."""

    name: str
    lower: float
    upper: float
    log: bool = False


@dataclass(frozen=True)
class FrictionDemand:
    """Bounds of mu over a box of preloads [N] and belt speeds [m/s]; bilinear, so its corners are enough."""

    lower: float = 0.05
    upper: float = 0.8
    preload: tuple[float, float] = (10.0, 300.0)
    belt_speed: tuple[float, float] = (1.0, 4.0)


@dataclass(frozen=True)
class Simulation:
    """How targets of the nonlinear motion are computed: seconds let go by, seconds measured, start in compressions.

    `record` is the length [s] of the record that contact loss is given of; 0: unknown, the shares may be scaled as one.
    """

    settle: float = 1.0
    duration: float = 0.5
    compressions: float = 0.1
    record: float = 0.0


@dataclass(frozen=True)
class Calibration:
    """An inverse problem. `weights` and `limits` by kind of target; `tied` parameters follow another one.

    `equilibrium`: where the model is linearised, at r = 0 as in Eqs. (3.1), (3.2), or at the exact equilibrium.
    """

    title: str
    targets: Targets
    base: RigParameters
    free: tuple[Free, ...]
    tied: Mapping[str, str] = field(default_factory=dict)
    friction: FrictionDemand = field(default_factory=FrictionDemand)
    weights: Mapping[str, float] = field(default_factory=lambda: dict(_DEFAULT_WEIGHTS))
    limits: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    measure: str = "rms"
    equilibrium: str = "linear"
    simulation: Simulation = field(default_factory=Simulation)

    @classmethod
    def of(cls, targets: Targets) -> Calibration:
        """Targets with the usual free parameters and weights, on the preset `yavuz_sen_2023`."""
        free = tuple(_free(name, *bounds) for name, bounds in _DEFAULT_FREE.items())
        return cls(targets.title, targets, RigParameters(), free, {"k4": "k3"})

    @property
    def has_free_friction(self) -> bool:
        """Whether the whole friction law is free: it is then searched by its values at the corners of the demand."""
        return {item.name for item in self.free} >= set(COEFFICIENTS)

    def with_free(self, names: Sequence[str]) -> Calibration:
        """A copy with these parameters free; each `name` or `name=lower:upper`.

        Raises:
            ConfigurationError, ParameterError: an unknown name, or bounds that are none.
        """
        known = {item.name: item for item in self.free}
        free = tuple(_free_from_text(text, known) for text in names)
        tied = {name: other for name, other in self.tied.items() if other in {item.name for item in free}}
        return replace(self, free=_checked_free("--free", free), tied=tied)


def load_calibration(path: Path | str) -> Calibration:
    """Read and check a calibration, or a file of targets, which gets the usual free parameters.

    Raises:
        ConfigurationError, ParameterError: what is wrong with it, in one sentence.
    """
    content = load_yaml(path)
    if isinstance(content, dict) and looks_like_targets(content):
        return Calibration.of(load_targets(path))
    where = str(path)
    raw = mapping(where, content, _KEYS, _NEEDED)
    free = _read_free(f"{where}, free", raw["free"])
    measure, equilibrium = raw.get("measure", "rms"), raw.get("equilibrium", "linear")
    for key, value, options in (("measure", measure, MEASURES), ("equilibrium", equilibrium, EQUILIBRIA)):
        if value not in options:
            raise ConfigurationError(f"{where}: {key} = {value!r} is not known: it must be one of {', '.join(options)}")
    return Calibration(
        title=str(raw.get("title", Path(path).stem)),
        targets=_read_named_targets(Path(path), raw["targets"]),
        base=RigParameters.preset(str(raw.get("preset", "yavuz_sen_2023"))),
        free=free,
        tied=_read_tied(f"{where}, tied", raw.get("tied", {}), free),
        friction=_read_friction(f"{where}, friction", raw.get("friction", {})),
        weights=_read_weights(f"{where}, weights", raw.get("weights", _DEFAULT_WEIGHTS)),
        limits=_read_limits(f"{where}, limits", raw.get("limits", {})),
        measure=str(measure),
        equilibrium=str(equilibrium),
        simulation=_read_simulation(f"{where}, simulation", raw.get("simulation", {})),
    )


def _read_named_targets(path: Path, named: object) -> Targets:
    if isinstance(named, str):
        return load_targets(path.parent / named)
    return read_targets(named, f"{path}, targets", path.stem)


def _declaration(name: str) -> Declaration:
    known = declarations(RigParameters)
    if name not in known:
        raise unknown_name(name, known)
    if known[name].kind is not float:
        raise ParameterError(f"{name} is a choice of words: it cannot be free")
    return known[name]


def within_bounds(name: str, value: float) -> float:
    """The value, or the declared bound of a parameter that it lies beyond."""
    declared = _declaration(name)
    return min(max(value, declared.lower), declared.upper)


def _free(name: str, lower: float, upper: float) -> Free:
    """A free parameter; nan in place of a bound: that of its declaration."""
    declared = _declaration(name)
    low = declared.lower if math.isnan(lower) else lower
    high = declared.upper if math.isnan(upper) else upper
    if not declared.lower <= low < high <= declared.upper:
        raise ParameterError(f"{name}: bounds {low:g} to {high:g} must rise and lie within {declared.bounds}")
    return Free(name, low, high, low > 0.0 and high / low > 10.0)


def _read_free(where: str, content: object) -> tuple[Free, ...]:
    if not isinstance(content, Mapping):
        raise ConfigurationError(f"{where}: expected a mapping of parameters to lower and upper, got {content!r}")
    free = []
    for name, raw in content.items():
        place = f"{where}, {name}"
        bounds = mapping(place, raw if raw is not None else {}, ("lower", "upper"))
        values = [
            number(place, key, bounds[key], -math.inf) if key in bounds else math.nan for key in ("lower", "upper")
        ]
        try:
            free.append(_free(str(name), *values))
        except ParameterError as error:
            raise ParameterError(f"{where}: {error}") from None
    return _checked_free(where, tuple(free))


def _checked_free(where: str, free: tuple[Free, ...]) -> tuple[Free, ...]:
    if not free:
        raise ConfigurationError(f"{where}: no parameter is free, so there is nothing to search for")
    for name in ("preload", "belt_speed"):
        if any(item.name == name for item in free):
            raise ParameterError(f"{where}: {name} is set by the targets: it cannot be free")
    return free


def _free_from_text(text: str, known: Mapping[str, Free]) -> Free:
    name, equals, bounds = text.partition("=")
    if not equals and name in known:
        return known[name]
    values = _DEFAULT_FREE.get(name, (math.nan, math.nan))
    if equals:
        low, _, high = bounds.partition(":")
        try:
            values = (float(low), float(high))
        except ValueError:
            raise ConfigurationError(f"--free {text}: write name, or name=lower:upper") from None
    return _free(name, *values)


def _read_tied(where: str, content: object, free: tuple[Free, ...]) -> dict[str, str]:
    names = {item.name for item in free}
    tied = dict(mapping(where, content, tuple(declarations(RigParameters))))
    for name, other in tied.items():
        if name in names or not isinstance(other, str) or other not in names:
            raise ConfigurationError(f"{where}: {name}: {other!r} must tie a parameter that is not free to one that is")
    return tied


def _read_friction(where: str, content: object) -> FrictionDemand:
    raw = mapping(where, content, ("lower", "upper", "preload", "belt_speed"))
    default = FrictionDemand()
    low = number(where, "lower", raw.get("lower", default.lower), 0.0, 10.0)
    high = number(where, "upper", raw.get("upper", default.upper), 0.0, 10.0)
    if not low < high:
        raise ConfigurationError(f"{where}: lower = {low:g} must be below upper = {high:g}")
    return FrictionDemand(
        low,
        high,
        _range(where, "preload", raw.get("preload", list(default.preload)), 2000.0, "N"),
        _range(where, "belt_speed", raw.get("belt_speed", list(default.belt_speed)), 20.0, "m/s"),
    )


def _range(where: str, key: str, value: object, upper: float, unit: str) -> tuple[float, float]:
    if not isinstance(value, list) or len(value) != 2:
        raise ConfigurationError(f"{where}: {key} = {value!r} must be two numbers, the lower first [{unit}]")
    low, high = (number(where, key, item, 0.0, upper, unit) for item in value)
    if not low < high:
        raise ConfigurationError(f"{where}: {key} = {value} must be two numbers, the lower first [{unit}]")
    return low, high


def _read_weights(where: str, content: object) -> dict[str, float]:
    weights = {kind: number(where, kind, value) for kind, value in mapping(where, content, KINDS).items()}
    if not any(weights.values()):
        raise ConfigurationError(f"{where}: every weight is zero, so nothing is to be met")
    return weights


def _read_limits(where: str, content: object) -> dict[str, dict[str, float]]:
    return {
        kind: {
            key: number(f"{where}, {kind}", key, value)
            for key, value in mapping(f"{where}, {kind}", raw, MEASURES).items()
        }
        for kind, raw in mapping(where, content, KINDS).items()
    }


def _read_simulation(where: str, content: object) -> Simulation:
    names = ("settle", "duration", "compressions", "record")
    raw: Mapping[str, Any] = mapping(where, content, names)
    values = {name: number(where, name, value) for name, value in raw.items()}
    if values.get("duration", 1.0) == 0.0:
        raise ConfigurationError(f"{where}: duration = 0 s must be above 0 s")
    return Simulation(**values)
