"""What a calibration is to meet: thresholds, frequencies, contact loss and jumps, read from YAML.

The file is that of the paper's numbers, `config/paper/yavuz_sen_2023.yaml`; every section may be left out.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from squeal_rig.configuration.files import load_yaml
from squeal_rig.errors import ConfigurationError

#: Kinds of target, in the order they are reported.
KINDS = (
    "critical_pad_stiffness",
    "squeal_frequency",
    "nonlinear_frequency",
    "contact_loss",
    "peak_displacement_jump",
)
#: Sections a file of targets may have.
SECTIONS = ("arm_angle_rad", "critical_pad_stiffness", "squeal_frequency", "superharmonics", "peak_displacement_jump")
#: Preloads [N] of Fig. 12: "no jump" says that none lies in here.
JUMP_RANGE = (50.0, 300.0)
_ROW_KEYS = ("k", "f_nonlinear", "f_linear", "contact_loss_s")


@dataclass(frozen=True)
class Target:
    """One number to be met, at one operating point; `value` nan in a jump says that there is none.

    `value` is a stiffness [N/m], a frequency [Hz], a time off the belt [s] or a preload [N], by the kind.
    """

    kind: str
    preload: float
    belt_speed: float
    pad_stiffness: float
    value: float
    source: str = ""


@dataclass(frozen=True)
class Targets:
    """Every target of a file, grouped by kind; `title` is the file's name.

    `superharmonics`, which are no target: whether there are any, by preload [N] and pad stiffness [N/m].
    """

    title: str
    items: tuple[Target, ...]
    superharmonics: Mapping[tuple[float, float], bool] = field(default_factory=dict)

    def kinds(self) -> tuple[str, ...]:
        """The kinds of target there are, in the order of `KINDS`."""
        return tuple(kind for kind in KINDS if self.of(kind))

    def of(self, kind: str) -> tuple[Target, ...]:
        """The targets of one kind, in the file's order."""
        return tuple(item for item in self.items if item.kind == kind)


def load_targets(path: Path | str) -> Targets:
    """Read and check a file of targets.

    Raises:
        ConfigurationError: what is wrong with it, in one sentence.
    """
    return read_targets(load_yaml(path), str(path), Path(path).stem)


def looks_like_targets(content: Mapping[str, Any]) -> bool:
    """Whether a mapping read from YAML is a file of targets."""
    return any(section in content for section in SECTIONS)


def read_targets(content: object, where: str, title: str) -> Targets:
    """Targets from what was read from YAML; `where` begins every error's sentence.

    Raises:
        ConfigurationError: an unknown section or key, or a value that is not what it must be.
    """
    if not isinstance(content, Mapping):
        raise ConfigurationError(f"{where}: targets are a mapping of {', '.join(SECTIONS)}, got {content!r}")
    for section in content:
        if section not in SECTIONS:
            raise ConfigurationError(f"{where}: unknown section {section!r}: targets have {', '.join(SECTIONS)}")
    items = [
        *_thresholds(content.get("critical_pad_stiffness", []), f"{where}, critical_pad_stiffness"),
        *_table(content.get("squeal_frequency", {}), f"{where}, squeal_frequency"),
        *_jumps(content.get("peak_displacement_jump", []), f"{where}, peak_displacement_jump"),
    ]
    if not items:
        raise ConfigurationError(f"{where}: there is no target in it")
    return Targets(title, tuple(items), _superharmonics(content.get("superharmonics", []), f"{where}, superharmonics"))


def number(where: str, key: str, value: object, lower: float = 0.0, upper: float = math.inf, unit: str = "") -> float:
    """A finite number within bounds.

    Raises:
        ConfigurationError: it is not; the sentence gives the key, the value, the bounds and the unit.
    """
    bounds = f"at least {lower:g}" if math.isinf(upper) else f"{lower:g} to {upper:g}"
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ConfigurationError(f"{where}: {key} = {value!r} must be a number, {bounds} {unit}".rstrip())
    try:
        found = float(value)
    except OverflowError:  # a whole number may be too long for a float
        found = math.inf if value > 0 else -math.inf
    if not (math.isfinite(found) and lower <= found <= upper):
        shown = f"{found:g} {unit}".rstrip()
        raise ConfigurationError(f"{where}: {key} = {shown} is out of bounds: it must be {bounds} {unit}".rstrip())
    return found


def mapping(where: str, value: object, keys: tuple[str, ...], needed: tuple[str, ...] = ()) -> Mapping[str, Any]:
    """A mapping with no other keys than `keys` and all of `needed`.

    Raises:
        ConfigurationError: it is not.
    """
    if not isinstance(value, Mapping):
        raise ConfigurationError(f"{where}: expected a mapping of {', '.join(keys)}, got {value!r}")
    for key in value:
        if key not in keys:
            raise ConfigurationError(f"{where}: unknown key {key!r}: there are {', '.join(keys)}")
    for key in needed:
        if key not in value:
            raise ConfigurationError(f"{where}: {key} is missing")
    return value


def _rows(where: str, value: object) -> list[tuple[str, object]]:
    if not isinstance(value, list):
        raise ConfigurationError(f"{where}: expected a list, got {value!r}")
    return [(f"{where}, row {i}", row) for i, row in enumerate(value, 1)]


def _thresholds(content: object, where: str) -> list[Target]:
    items = []
    for place, raw in _rows(where, content):
        row = mapping(place, raw, ("preload", "belt_speed", "k_cr", "source"), ("preload", "belt_speed", "k_cr"))
        preload = number(place, "preload", row["preload"], 0.0, 2000.0, "N")
        speed = number(place, "belt_speed", row["belt_speed"], 0.0, 20.0, "m/s")
        k_cr = number(place, "k_cr", row["k_cr"], 1.0, 1e10, "N/m")
        items.append(Target("critical_pad_stiffness", preload, speed, k_cr, k_cr, str(row.get("source", ""))))
    return items


def _table(content: object, where: str) -> list[Target]:
    """Table 1: the linear and the nonlinear frequency and the time off the belt, a row a pad stiffness."""
    if content == {}:
        return []
    table = mapping(where, content, ("preload", "belt_speed", "rows"), ("preload", "belt_speed", "rows"))
    preload = number(where, "preload", table["preload"], 0.0, 2000.0, "N")
    speed = number(where, "belt_speed", table["belt_speed"], 0.0, 20.0, "m/s")
    items = []
    for place, raw in _rows(where, table["rows"]):
        row = mapping(place, raw, _ROW_KEYS, ("k",))
        k = number(place, "k", row["k"], 1.0, 1e10, "N/m")
        for key, kind, lower, unit in (
            ("f_linear", "squeal_frequency", 1e-3, "Hz"),
            ("f_nonlinear", "nonlinear_frequency", 1e-3, "Hz"),
            ("contact_loss_s", "contact_loss", 0.0, "s"),
        ):
            if key in row:
                value = number(place, key, row[key], lower, math.inf, unit)
                items.append(Target(kind, preload, speed, k, value, "Table 1"))
    return items


def _jumps(content: object, where: str) -> list[Target]:
    items = []
    for place, raw in _rows(where, content):
        keys = ("k", "belt_speed", "jump_preload")
        row = mapping(place, raw, keys, keys)
        k = number(place, "k", row["k"], 1.0, 1e10, "N/m")
        speed = number(place, "belt_speed", row["belt_speed"], 0.0, 20.0, "m/s")
        jump = row["jump_preload"]
        value = math.nan if jump is None else number(place, "jump_preload", jump, 0.0, 2000.0, "N")
        items.append(Target("peak_displacement_jump", value, speed, k, value, "Fig. 12"))
    return items


def _superharmonics(content: object, where: str) -> dict[tuple[float, float], bool]:
    """Fig. 10: whether multiples of the squeal frequency are present, by preload and pad stiffness."""
    found = {}
    for place, raw in _rows(where, content):
        row = mapping(place, raw, ("preload", "present"), ("preload", "present"))
        preload = number(place, "preload", row["preload"], 0.0, 2000.0, "N")
        if not isinstance(row["present"], Mapping):
            raise ConfigurationError(f"{place}: present = {row['present']!r} must map stiffness to true or false")
        for k, there in row["present"].items():
            if not isinstance(there, bool):
                raise ConfigurationError(f"{place}: present, {k}: {there!r} must be true or false")
            found[preload, number(place, "present", k, 1.0, 1e10, "N/m")] = there
    return found
