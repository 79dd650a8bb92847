"""Settings of the driver `opendaq`: which signal is which channel, which register moves what, read from YAML."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from squeal_rig.configuration.declared import Declaration, Declared, checked, quantity
from squeal_rig.drivers.registers import Register, words_of
from squeal_rig.errors import ConfigurationError, DriverError, ParameterError
from squeal_rig.instruments.channels import DAQ_CHANNELS, Channel, record_type
from squeal_rig.instruments.driver import Samples
from squeal_rig.instruments.driver_config import declared_from, load_driver_config

DRIVER = "opendaq"
#: Channels that a map has to say something of, with their units.
UNITS = {channel.name: channel.unit for channel in DAQ_CHANNELS if channel.name not in ("t", "seq")}
#: What a rig of hardware can be moved by, with its unit.
MOVABLE = {"preload": "N", "belt_speed": "m/s"}
_MOST_EXTRA = 32
_MOST_WRITES = 32
_TOP = ("channels", "modbus", "set_points")
_SOURCES = ("signal", "register", "fixed")


@dataclass(frozen=True)
class AcquisitionSettings(Declared):
    """Top level of the file."""

    connection: str = quantity("", "connection string of the openDAQ device, as in daq.ns://192.168.0.20:7420")
    stale_after: float = quantity(
        0.2,
        "time without samples, or without an answer of a Modbus unit, after which the driver fails",
        unit="s",
        lower=0.05,
        upper=60.0,
    )
    clock_tolerance: float = quantity(
        1.0,
        "difference of the device's clock from this machine's that is worth a warning; its stamps are published",
        unit="s",
        lower=1e-3,
        upper=1e9,
    )
    queue: float = quantity(
        2.0,
        "time for which samples are kept while the rig does not read them; older ones are lost",
        unit="s",
        lower=0.1,
        upper=60.0,
    )
    write_interval: float = quantity(
        0.05, "time between two writes of a set point at least, and between two reads", unit="s", lower=0.005, upper=5.0
    )
    safe_timeout: float = quantity(
        0.1,
        "longest wait for each answer to the safe command, which is then sent once more on a new connection",
        unit="s",
        lower=0.005,
        upper=5.0,
    )


@dataclass(frozen=True)
class ChannelSource(Declared):
    """Each of `channels`: where a channel of the rig comes from, exactly one of signal, register and fixed.

    Value = sign · scale · (reading of the device) + offset, in the channel's unit.
    """

    signal: str = quantity("", "signal of the device: its local id, or its whole id where that is not unique")
    register: str = quantity("", "register that measures it, as unit.name: held from one answer to the next")
    scale: float = quantity(1.0, "channel's units per unit of the device")
    offset: float = quantity(0.0, "added after scaling, in the channel's unit")
    unit: str = quantity("", "unit of the channel, which the scale leads to; checked against the channel's own")
    sign: int = quantity(1, "-1 where the device counts the other way round", lower=-1, upper=1)
    delay: int = quantity(
        0, "samples that the signal comes late by, as a filter's group delay", lower=-1_000_000, upper=1_000_000
    )


@dataclass(frozen=True)
class ModbusUnit(Declared):
    """Each of `modbus`: one inverter or preload unit over Modbus TCP."""

    host: str = quantity("", "address of the unit, or of its gateway")
    port: int = quantity(502, "TCP port", lower=1, upper=65535)
    device_id: int = quantity(1, "Modbus device id", lower=0, upper=255)
    timeout: float = quantity(0.1, "longest wait for an answer", unit="s", lower=0.005, upper=10.0)


class Place(NamedTuple):
    """A register of a unit."""

    unit: str
    register: str


class Write(NamedTuple):
    """A value [register's unit] for a register of a unit."""

    register: str
    value: float


@dataclass(frozen=True)
class Unit:
    """One Modbus unit: how to reach it, its registers, what makes it safe and what starts it, in order."""

    connection: ModbusUnit
    registers: Mapping[str, Register]
    safe: tuple[Write, ...]
    start: tuple[Write, ...]


@dataclass(frozen=True)
class HardwareSettings:
    """All of a file: acquisition, channels (theirs and more), units, the registers that set points go to.

    `fixed` are channels that nobody measures, with the value that they carry.
    """

    acquisition: AcquisitionSettings
    signals: Mapping[str, ChannelSource]
    measured: Mapping[str, ChannelSource]
    fixed: Mapping[str, float]
    units: Mapping[str, Unit]
    set_points: Mapping[str, Place]

    @property
    def record(self) -> Any:
        """Record of one sample: the rig's channels, then those that the map has beside them."""
        extra = [
            Channel(name, source.unit, source.signal or source.register)
            for name, source in (*self.signals.items(), *self.measured.items())
            if name not in UNITS
        ]
        return record_type((*DAQ_CHANNELS, *extra))

    def empty_block(self, size: int) -> Samples:
        """A block of so many samples with what is fixed in it."""
        daq: Samples = _zeros(size, self.record)
        for name, value in self.fixed.items():
            daq[name] = value
        return daq


def _zeros(size: int, record: Any) -> Samples:
    import numpy as np

    return np.zeros(size, record)


def place_of(text: str) -> Place:
    """`unit.register` as its two names."""
    unit, _, register = text.partition(".")
    return Place(unit, register)


def load_hardware(path: str) -> HardwareSettings:
    """Read and check a file of settings.

    Raises:
        ConfigurationError, ParameterError: what is wrong with it, in one sentence.
    """
    if not path:
        raise ConfigurationError(f"driver_config = '' names no file: the driver {DRIVER!r} needs one")
    content = load_driver_config(path, DRIVER)
    parts = {name: _mapping(path, name, content.pop(name, {})) for name in _TOP}
    acquisition = declared_from(AcquisitionSettings, path, content)
    if not acquisition.connection:
        raise ConfigurationError(f"{path}: connection = '' names no device, as daq.ns://192.168.0.20:7420 does")
    units = {name: _unit(f"modbus.{name}", path, raw) for name, raw in parts["modbus"].items()}
    signals, measured, fixed = _channels(path, parts["channels"], units)
    set_points = {}
    for name, text in parts["set_points"].items():
        where = f"{path}, set_points.{name}"
        if name not in MOVABLE:
            raise ConfigurationError(
                f"{where}: there is no such set point: {' and '.join(MOVABLE)} can be moved by a register"
            )
        set_points[name] = _register_at(where, text, units, MOVABLE[name], writable=True)
    return HardwareSettings(acquisition, signals, measured, fixed, units, set_points)


def _mapping(path: str, name: str, value: object) -> dict[str, Any]:
    if not isinstance(value, dict) or not all(isinstance(key, str) for key in value):
        raise ConfigurationError(f"{path}: {name} is a mapping of names, got {value!r}")
    return value


def _channels(
    path: str, raw: Mapping[str, Any], units: Mapping[str, Unit]
) -> tuple[dict[str, ChannelSource], dict[str, ChannelSource], dict[str, float]]:
    missing = [name for name in UNITS if name not in raw]
    if missing:
        raise ConfigurationError(
            f"{path}: channels says nothing of {', '.join(missing)}: name a signal, a register, or a fixed value"
        )
    if len(raw) > len(UNITS) + _MOST_EXTRA:
        raise ConfigurationError(f"{path}: {len(raw)} channels: at most {_MOST_EXTRA} more than the rig has")
    signals, measured, fixed = {}, {}, {}
    for name, value in raw.items():
        where = f"channels.{name}"
        if name in ("t", "seq"):
            raise ConfigurationError(f"{path}, {where}: the rig itself fills it")
        entry = _mapping(path, where, value)
        if sum(source in entry for source in _SOURCES) != 1:
            raise ConfigurationError(f"{path}, {where}: exactly one of {', '.join(_SOURCES)} says where it comes from")
        if "fixed" in entry:
            if len(entry) > 1:
                raise ConfigurationError(
                    f"{path}, {where}: fixed stands alone, one number in {UNITS.get(name, 'its unit')}:"
                    f" without effect beside it: {', '.join(sorted(entry.keys() - {'fixed'}))}"
                )
            fixed[name] = _number(f"{path}, {where}", "fixed", entry["fixed"])
            continue
        source = declared_from(ChannelSource, path, entry, where)
        if source.sign == 0:
            raise ConfigurationError(f"{path}, {where}: sign = 0 must be 1 or -1")
        if name in UNITS and source.unit != UNITS[name]:
            raise ConfigurationError(f"{path}, {where}: unit = {source.unit!r}, but the channel is in {UNITS[name]}")
        if source.register:
            _register_at(f"{path}, {where}", source.register, units)
            if source.delay:
                raise ConfigurationError(f"{path}, {where}: delay is for signals, a register is held")
            measured[name] = source
        else:
            signals[name] = source
    if not signals:
        raise ConfigurationError(f"{path}: no channel comes from a signal: the device's samples make the blocks")
    return signals, measured, fixed


def _unit(where: str, path: str, raw: object) -> Unit:
    content = dict(_mapping(path, where, raw))
    registers = {
        name: _register(path, f"{where}.registers.{name}", value)
        for name, value in _mapping(path, f"{where}.registers", content.pop("registers", {})).items()
    }
    safe, start = (_writes(f"{path}, {where}.{key}", content.pop(key, []), registers) for key in ("safe", "start"))
    connection = declared_from(ModbusUnit, path, content, where)
    if not connection.host:
        raise ConfigurationError(f"{path}, {where}: host = '' names no address")
    if not safe:
        raise ConfigurationError(f"{path}, {where}: safe says nothing: list the writes that stop it")
    return Unit(connection, registers, safe, start)


def _register(path: str, where: str, raw: object) -> Register:
    register = declared_from(Register, path, raw, where)
    if register.write_function not in (6, 16):
        raise ConfigurationError(f"{path}, {where}: write_function = {register.write_function} must be 6 or 16")
    if register.write_function == 6 and register.type not in ("uint16", "int16"):
        raise ConfigurationError(f"{path}, {where}: write_function = 6 writes 16 bits, but type = {register.type}")
    if register.scale == 0.0:
        raise ConfigurationError(f"{path}, {where}: scale = 0 leaves nothing of what it holds")
    return register


def _writes(where: str, raw: object, registers: Mapping[str, Register]) -> tuple[Write, ...]:
    if not isinstance(raw, list) or len(raw) > _MOST_WRITES:
        raise ConfigurationError(f"{where}: a list of at most {_MOST_WRITES} writes, {{register: value}}, got {raw!r}")
    writes = []
    for entry in raw:
        if not isinstance(entry, dict) or len(entry) != 1:
            raise ConfigurationError(f"{where}: a write is {{register: value}}, got {entry!r}")
        ((name, value),) = entry.items()
        if name not in registers or registers[name].kind != "holding":
            raise ConfigurationError(f"{where}: {name!r} is no holding register of this unit")
        number = _number(where, name, value)
        try:
            words_of(registers[name], number, name)  # what does not fit is not to be found out when it is needed
        except DriverError as error:
            raise ConfigurationError(f"{where}: {error}") from None
        writes.append(Write(name, number))
    return tuple(writes)


def _register_at(where: str, text: object, units: Mapping[str, Unit], unit: str = "", writable: bool = False) -> Place:
    place = place_of(str(text))
    if place.unit not in units or place.register not in units[place.unit].registers:
        known = [f"{name}.{register}" for name, body in units.items() for register in body.registers]
        raise ConfigurationError(f"{where}: no register {text!r}: there are {', '.join(known) or 'none'}")
    register = units[place.unit].registers[place.register]
    if writable and register.kind != "holding":
        raise ConfigurationError(f"{where}: {text} is an input register, which cannot be written")
    if unit and register.unit != unit:
        raise ConfigurationError(f"{where}: {text} is in {register.unit!r}, but {unit} is needed")
    return place


def _number(where: str, name: str, value: object) -> float:
    try:
        return float(checked(Declaration(0.0, "a number", name=name), value))
    except ParameterError as error:
        raise ConfigurationError(f"{where}: {error}") from None
