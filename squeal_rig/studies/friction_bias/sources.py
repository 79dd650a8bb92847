"""Sources of error: data sheets with one effect alone, all others ideal."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

from squeal_rig.configuration.declared import Declared
from squeal_rig.instruments.data_sheets import DataSheets

_STAY = ("sensitivity_error", "offset")
_FORM = ("linearity", "hysteresis")
_TORQUE_DYNAMICS = ("filter_time", "update_rate", "delay")
_TORQUE_NOISE = ("noise_density", "resolution")
_ALWAYS = ("range",)
# The inverter reads the motor's torque: without the drum's inertia its peaks in squeal would be beyond its range.
# Name of a source -> blocks of the data sheets -> fields of them that it has; an empty list is every field.
_SOURCES: dict[str, dict[str, Sequence[str]]] = {
    "arm forces: sensitivity, zero": {"arm_force": _STAY},
    "arm forces: linearity, hysteresis": {"arm_force": _FORM},
    "arm forces: noise": {"arm_force": ("noise_density",)},
    "arm forces: bandwidth": {"arm_force": ("bandwidth",)},
    "preload: sensitivity, zero": {"preload": (*_STAY, *_FORM)},
    "preload: noise, bandwidth": {"preload": ("noise_density", "bandwidth")},
    "drum, torque: sensitivity, zero": {"belt_drive": (), "motor_torque": _STAY},
    "drum, torque: filter, delay, hold": {"belt_drive": (), "motor_torque": _TORQUE_DYNAMICS},
    "drum, torque: noise, resolution": {"belt_drive": (), "motor_torque": (*_TORQUE_NOISE, *_TORQUE_DYNAMICS)},
    "displacement": {"displacement": ()},
    # Not the clock's error: it moves frequencies, and no window's means.
    "acquisition: filter, bits": {"daq": ("anti_alias_order", "anti_alias_cutoff", "bits", "headroom")},
    "temperature": {
        "environment": (),
        **dict.fromkeys(("arm_force", "preload", "displacement"), ("zero_drift", "sensitivity_drift")),
    },
    "preload unit": {"hydraulics": ()},
    "belt drive": {"belt_drive": ()},
}
IDEAL, ALL = "none (ideal)", "all together"


@dataclass(frozen=True)
class Source:
    """An error source: its name, and data sheets that have it alone."""

    name: str
    sheets: DataSheets

    @property
    def actuators(self) -> DataSheets:
        """The sheets' actuators with ideal instruments: what moves the pad."""
        return DataSheets(hydraulics=self.sheets.hydraulics, belt_drive=self.sheets.belt_drive)


def sources(sheets: DataSheets) -> list[Source]:
    """Ideal first, then each source of `sheets` alone, then all together; gaps are left out everywhere."""
    whole = dataclasses.replace(sheets, daq=dataclasses.replace(sheets.daq, drop_rate=0.0))
    found = [Source(IDEAL, DataSheets())]
    for name, blocks in _SOURCES.items():
        chosen = {block: _picked(getattr(whole, block), fields) for block, fields in blocks.items()}
        if "daq" in chosen:  # bits are steps of a range
            ranges = ("arm_force", "clip_force", "displacement", "preload", "belt_speed")
            chosen |= {block: _picked(getattr(whole, block), _ALWAYS) for block in ranges}
        found.append(Source(name, DataSheets(**chosen)))  # type: ignore[arg-type]
    return [*found, Source(ALL, whole)]


def _picked(block: Declared, fields: Sequence[str]) -> Declared:
    if not fields:
        return block
    return type(block)(**{name: getattr(block, name) for name in (*fields, *_ALWAYS) if hasattr(block, name)})
