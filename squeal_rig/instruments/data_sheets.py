"""Data sheets of the rig's instruments and actuators: what config/instruments/*.yaml holds, and how it is read."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from squeal_rig.configuration.declared import Declared, quantity
from squeal_rig.configuration.files import config_directory, load_yaml
from squeal_rig.errors import ConfigurationError, ParameterError

_OF_RANGE = "share of the range"


@dataclass(frozen=True)
class Sensor(Declared):
    """An analog sensor with its amplifier. Tolerances are bounds: what one specimen has is drawn within them.

    In every field 0 stands for an effect that is not there; a range of 0 is no limit.
    """

    range: float = quantity(0.0, "largest magnitude it shows; 0: no limit", lower=0.0, upper=1e9)
    sensitivity_error: float = quantity(0.0, "tolerance of the sensitivity after calibration", lower=0.0, upper=0.5)
    offset: float = quantity(0.0, "tolerance of the reading at zero", unit=_OF_RANGE, lower=0.0, upper=0.5)
    linearity: float = quantity(
        0.0, "largest deviation from the straight line through zero and range", unit=_OF_RANGE, lower=0.0, upper=0.2
    )
    hysteresis: float = quantity(
        0.0, "largest difference between rising and falling values", unit=_OF_RANGE, lower=0.0, upper=0.1
    )
    noise_density: float = quantity(0.0, "density of the white noise, one-sided", lower=0.0, upper=1e9)
    bandwidth: float = quantity(
        0.0, "-3 dB limit of its second-order low-pass; 0: none", unit="Hz", lower=0.0, upper=1e9
    )
    zero_drift: float = quantity(0.0, "tolerance of the zero's drift", unit="1/K", lower=0.0, upper=0.1)
    sensitivity_drift: float = quantity(0.0, "tolerance of the sensitivity's drift", unit="1/K", lower=0.0, upper=0.1)

    def __post_init__(self) -> None:
        super().__post_init__()
        if 0.0 < self.bandwidth < 1.0:  # its filter's poles would be at 1 but for rounding
            raise ParameterError(
                f"bandwidth = {self.bandwidth:g} Hz is out of bounds: it must be 0 (none) or 1 Hz or more"
            )
        for name in ("offset", "linearity", "hysteresis", "zero_drift"):
            if getattr(self, name) and not self.range:
                raise ParameterError(f"{name} is a share of the range, which is 0: it needs a range above 0")


def _range(unit: str) -> Any:
    return quantity(0.0, "largest magnitude it shows; 0: no limit", unit=unit, lower=0.0, upper=1e9)


def _noise(unit: str) -> Any:
    return quantity(0.0, "density of the white noise, one-sided", unit=f"{unit}/sqrt(Hz)", lower=0.0, upper=1e6)


@dataclass(frozen=True)
class ForceSensor(Sensor):
    """A force transducer: of an arm, of a clip, or of the preload unit by its pressure."""

    range: float = _range("N")
    noise_density: float = _noise("N")


@dataclass(frozen=True)
class DisplacementSensor(Sensor):
    """A displacement sensor of the pad."""

    range: float = _range("m")
    noise_density: float = _noise("m")


@dataclass(frozen=True)
class SpeedSensor(Sensor):
    """A measuring wheel on the belt."""

    range: float = _range("m/s")
    noise_density: float = _noise("m/s")


@dataclass(frozen=True)
class TorqueReport(Declared):
    """The motor's torque as its inverter tells it: filtered, at its own rate, late, in steps."""

    range: float = _range("N m")
    sensitivity_error: float = quantity(0.0, "tolerance of the sensitivity", lower=0.0, upper=0.5)
    offset: float = quantity(0.0, "tolerance of the reading at zero", unit=_OF_RANGE, lower=0.0, upper=0.5)
    noise_density: float = _noise("N m")
    filter_time: float = quantity(
        0.0, "time constant of its first-order low-pass; 0: none", unit="s", lower=0.0, upper=100.0
    )
    update_rate: int = quantity(
        0, "values reported per second, held in between; 0: every sample", unit="Hz", lower=0, upper=1_000_000
    )
    delay: float = quantity(0.0, "delay until a value is reported", unit="s", lower=0.0, upper=1.0)
    resolution: float = quantity(0.0, "step of the reported values; 0: none", unit="N m", lower=0.0, upper=1e6)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.offset and not self.range:
            raise ParameterError("offset is a share of the range, which is 0: it needs a range above 0")


@dataclass(frozen=True)
class Daq(Declared):
    """The acquisition's front end: all analog channels through one kind of filter, sampled at the same moment."""

    anti_alias_order: int = quantity(0, "order of the Butterworth anti-alias filter; 0: none", lower=0, upper=12)
    anti_alias_cutoff: float = quantity(
        0.4, "its -3 dB limit", unit="share of the sample rate", lower=0.001, upper=0.49
    )
    bits: int = quantity(0, "bits of a value; 0: not quantised", lower=0, upper=32)
    headroom: float = quantity(1.25, "input range over each sensor's range", lower=1.0, upper=1000.0)
    clock_error: float = quantity(0.0, "tolerance of the clock's rate", unit="ppm", lower=0.0, upper=1000.0)
    drop_rate: float = quantity(0.0, "gaps per second, at random", unit="1/s", lower=0.0, upper=50.0)
    drop_length: float = quantity(0.001, "length of a gap", unit="s", lower=0.0, upper=0.005)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.bits == 1:
            raise ParameterError("bits = 1 holds no sign: it must be 0 or 2 to 32")


@dataclass(frozen=True)
class Environment(Declared):
    """The rig warms up from the temperature it was calibrated at: rise * (1 - exp(-t / time))."""

    temperature_rise: float = quantity(0.0, "rise once warm", unit="K", lower=-100.0, upper=100.0)
    temperature_time: float = quantity(600.0, "time constant of the rise", unit="s", lower=1.0, upper=1e6)


@dataclass(frozen=True)
class Hydraulics(Declared):
    """The preload unit: a servo valve that follows its command, and what its pump adds."""

    slew_rate: float = quantity(0.0, "fastest change of the preload; 0: none", unit="N/s", lower=0.0, upper=1e9)
    response_time: float = quantity(
        0.0, "time constant with which the preload follows; 0: at once", unit="s", lower=0.0, upper=10.0
    )
    ripple: float = quantity(0.0, "amplitude of the pump's ripple", unit="share of the preload", lower=0.0, upper=0.5)
    ripple_frequency: float = quantity(150.0, "frequency of the pump's ripple", unit="Hz", lower=0.01, upper=200.0)


@dataclass(frozen=True)
class BeltDrive(Declared):
    """Motor with speed control, and the drum it turns. An inertia of 0: the speed is what is commanded, at once."""

    inertia: float = quantity(
        0.0, "drum, motor and belt, as seen at the drum; 0: none", unit="kg m^2", lower=0.0, upper=1e6
    )
    control_bandwidth: float = quantity(
        5.0, "natural frequency of the speed control", unit="Hz", lower=0.01, upper=200.0
    )
    control_damping: float = quantity(1.0, "damping ratio of the speed control", lower=0.1, upper=10.0)
    torque_limit: float = quantity(0.0, "largest torque of the motor; 0: no limit", unit="N m", lower=0.0, upper=1e9)
    run_out: float = quantity(0.0, "eccentricity of the drum", unit="m", lower=0.0, upper=0.1)
    speed_ripple: float = quantity(
        0.0, "amplitude of the ripple of the belt's speed", unit="share of the speed", lower=0.0, upper=0.5
    )
    ripple_order: int = quantity(4, "periods of that ripple per turn of the drum", lower=1, upper=100)

    def __post_init__(self) -> None:
        super().__post_init__()
        if 0.0 < self.inertia < 1e-4:
            raise ParameterError(
                f"inertia = {self.inertia:g} kg m^2 is out of bounds: it must be 0 (none) or 0.0001 kg m^2 or more"
            )
        for name in ("torque_limit", "run_out", "speed_ripple"):
            if getattr(self, name) and not self.inertia:
                raise ParameterError(f"{name} is of a drum that turns: it needs an inertia above 0 kg m^2")


@dataclass(frozen=True)
class DataSheets:
    """Every instrument and actuator of a rig. The default is ideal: the true values, and set points in force at once.

    `name` is that of the file.
    """

    arm_force: ForceSensor = field(default_factory=ForceSensor)
    clip_force: ForceSensor = field(default_factory=ForceSensor)
    displacement: DisplacementSensor = field(default_factory=DisplacementSensor)
    preload: ForceSensor = field(default_factory=ForceSensor)
    belt_speed: SpeedSensor = field(default_factory=SpeedSensor)
    motor_torque: TorqueReport = field(default_factory=TorqueReport)
    daq: Daq = field(default_factory=Daq)
    environment: Environment = field(default_factory=Environment)
    hydraulics: Hydraulics = field(default_factory=Hydraulics)
    belt_drive: BeltDrive = field(default_factory=BeltDrive)
    name: str = "ideal"

    def __post_init__(self) -> None:
        if self.daq.bits:
            for channel, sensor in self.analog.items():
                if not sensor.range:
                    raise ParameterError(
                        f"daq: bits = {self.daq.bits} need an input range, but the sensor of {channel} has none:"
                        " give every analog sensor a range above 0"
                    )

    @property
    def analog(self) -> dict[str, Sensor]:
        """Channel -> its sensor, of those that the acquisition samples, in the order of the channels."""
        return {
            "x": self.displacement,
            "y": self.displacement,
            "arm_left": self.arm_force,
            "arm_right": self.arm_force,
            "clip_left": self.clip_force,
            "clip_right": self.clip_force,
            "belt_speed": self.belt_speed,
            "preload": self.preload,
        }


#: Block of a file -> what it declares.
BLOCKS: dict[str, type[Declared]] = {
    f.name: f.default_factory  # type: ignore[misc]
    for f in dataclasses.fields(DataSheets)
    if f.name != "name"
}


def data_sheet_names() -> list[str]:
    """Names of the data sheets that ship with the package."""
    return sorted(path.stem for path in (config_directory() / "instruments").glob("*.yaml"))


def data_sheet_path(chosen: str) -> Path:
    """File of data sheets: one of `config/instruments/` by its name, or a path (with a folder, or ending with .yaml).

    Raises:
        ConfigurationError: no such name; the sentence lists those there are.
    """
    if "/" in chosen or chosen.endswith((".yaml", ".yml")):
        return Path(chosen)
    if chosen not in data_sheet_names():
        raise ConfigurationError(
            f"instruments = {chosen!r} is not known: there are {', '.join(data_sheet_names())}, or give a path"
        )
    return config_directory() / "instruments" / f"{chosen}.yaml"


def load_data_sheets(chosen: str) -> DataSheets:
    """Read data sheets by name or path; a block or a field that is left out is ideal.

    Raises:
        ConfigurationError, ParameterError: no such file, no such block, or a field that is unknown or out of bounds.
    """
    path = data_sheet_path(chosen)
    return data_sheets_of(load_yaml(path), path)


def data_sheets_of(content: object, path: Path | str) -> DataSheets:
    """Data sheets of a file's content, as `load_data_sheets` reads them."""
    if not isinstance(content, dict):
        raise ConfigurationError(f"{path}: data sheets are a mapping of {', '.join(BLOCKS)}, got {content!r}")
    blocks: dict[str, Any] = {}
    for key, body in content.items():
        if key not in BLOCKS:
            raise ConfigurationError(f"{path}: unknown block {str(key)!r}: it must be one of {', '.join(BLOCKS)}")
        if not isinstance(body, dict):
            raise ConfigurationError(f"{path}, {key}: expected a mapping of names to values, got {body!r}")
        try:
            blocks[key] = BLOCKS[key].from_mapping(body)
        except ParameterError as error:
            raise ParameterError(f"{path}, {key}: {error}") from None
    try:
        return DataSheets(**blocks, name=Path(path).stem)
    except ParameterError as error:
        raise ParameterError(f"{path}: {error}") from None


def looks_like_data_sheets(content: dict[Any, Any]) -> bool:
    """Whether a file's content is of this kind, right or wrong."""
    return bool(content.keys() & BLOCKS.keys()) and any(
        isinstance(content[key], dict) for key in content.keys() & BLOCKS
    )
