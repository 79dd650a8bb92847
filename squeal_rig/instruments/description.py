"""`rig/description`: all of the rig's constants and set points as one YAML text, the one source for everybody else."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from squeal_rig.configuration.declared import Declaration, checked, declarations
from squeal_rig.configuration.files import parse_yaml, yaml_mapping
from squeal_rig.errors import ConfigurationError, ParameterError
from squeal_rig.instruments.settings import PresetChoice, RigSettings
from squeal_rig.model.parameters import RigParameters

# Prefixes of keys that hold one number a channel, with what the number is.
_BY_CHANNEL = {
    "tare": "what was subtracted of a channel",
    "noise": "standard deviation of one sample of a channel",
    "ripple": "amplitude of a channel's periodic deviation",
    "full_scale": "largest magnitude a channel can show",
    "correlation": "time over which a channel's noise stays alike",
    "gain_error": "bound of a channel's gain error, as a share",
    "offset_error": "bound of what a channel is off by at any reading, gain apart",
}
# What a number of a channel may be, in any unit.
_LARGEST = 1e12
_MAX_TEXT = 1 << 14  # ours has an eighth of it, and it is read while blocks arrive
_TRUTH = Declaration(True, "whether truth/samples are published", name="publishes_truth")


@dataclass(frozen=True)
class RigDescription:
    """What the rig is: preset, driver, parameters (set points), drum radius [m], sample rate [Hz], instruments.

    `publishes_truth` tells whether `truth/samples` is to be waited for. By channel, in its unit: `tare`, what was
    subtracted; and of the instruments' data sheets `noise`, the standard deviation of one sample, `ripple`, the
    amplitude of periodic deviations of what is in force, and `full_scale`, the largest magnitude that can be shown;
    `correlation`, the time [s] such that a mean over a longer T has the variance noise^2 correlation/T (one sample
    where not named); `gain_error` and `offset_error`, the bounds of errors that are the same in all samples. A channel
    that is not named has none of these and no end.
    """

    parameters: RigParameters
    preset: str = ""
    driver: str = "virtual"
    publishes_truth: bool = True
    sample_rate: int = 51200
    drum_radius: float = 0.05
    tare: Mapping[str, float] = field(default_factory=dict)
    instruments: str = "ideal"
    noise: Mapping[str, float] = field(default_factory=dict)
    ripple: Mapping[str, float] = field(default_factory=dict)
    full_scale: Mapping[str, float] = field(default_factory=dict)
    correlation: Mapping[str, float] = field(default_factory=dict)
    gain_error: Mapping[str, float] = field(default_factory=dict)
    offset_error: Mapping[str, float] = field(default_factory=dict)

    def to_yaml(self) -> str:
        """Flat YAML: one key a line, every rig parameter among them."""
        head: dict[str, str | bool | int | float] = {
            "preset": self.preset,
            "driver": self.driver,
            "publishes_truth": self.publishes_truth,
            "sample_rate": self.sample_rate,
            "drum_radius": self.drum_radius,
            "instruments": self.instruments,
        }
        by_channel = {
            f"{kind}_{channel}": value for kind in _BY_CHANNEL for channel, value in getattr(self, kind).items()
        }
        return yaml_mapping({**head, **self.parameters.as_mapping(), **by_channel})

    def with_parameters(self, changes: Mapping[str, object]) -> RigDescription:
        """A copy with changed rig parameters."""
        return dataclasses.replace(self, parameters=self.parameters.replace(**changes))

    @classmethod
    def from_yaml(cls, text: str) -> RigDescription:
        """The description that `to_yaml` wrote.

        Raises:
            ConfigurationError: a key is missing, unknown or has a value of the wrong kind.
        """
        content = parse_yaml(text, "rig/description", _MAX_TEXT)
        if not isinstance(content, dict) or not all(isinstance(key, str) for key in content):
            raise ConfigurationError("rig/description: expected a mapping of names to values")
        values: dict[str, Any] = dict(content)
        try:
            parameters = RigParameters.from_mapping({name: values.pop(name) for name in declarations(RigParameters)})
            by_channel: dict[str, Any] = {
                kind: {
                    key[len(kind) + 1 :]: checked(
                        Declaration(0.0, what, name=key, lower=lowest, upper=_LARGEST), values.pop(key)
                    )
                    for key in list(values)
                    if key.startswith(f"{kind}_")
                }
                for kind, what in _BY_CHANNEL.items()
                for lowest in [-_LARGEST if kind == "tare" else 0.0]
            }
            known = {**declarations(RigSettings), **declarations(PresetChoice), _TRUTH.name: _TRUTH}
            for name in known.keys() & values.keys():
                values[name] = checked(known[name], values[name])
            return cls(parameters=parameters, **by_channel, **values)
        except (KeyError, TypeError, ValueError, ParameterError) as error:
            raise ConfigurationError(f"rig/description is not one of this version: {error}") from None
