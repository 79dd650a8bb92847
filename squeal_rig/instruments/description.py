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

_TARE = "tare_"
_MAX_TEXT = 1 << 14  # ours has an eighth of it, and it is read while blocks arrive
_TRUTH = Declaration(True, "whether truth/samples are published", name="publishes_truth")


@dataclass(frozen=True)
class RigDescription:
    """What the rig is: preset, driver, parameters (set points), drum radius [m], sample rate [Hz], tare offsets.

    `publishes_truth` tells whether `truth/samples` is to be waited for. Tare offsets are by channel, in its unit.
    """

    parameters: RigParameters
    preset: str = ""
    driver: str = "virtual"
    publishes_truth: bool = True
    sample_rate: int = 51200
    drum_radius: float = 0.05
    tare: Mapping[str, float] = field(default_factory=dict)

    def to_yaml(self) -> str:
        """Flat YAML: one key a line, every rig parameter among them."""
        head: dict[str, str | bool | int | float] = {
            "preset": self.preset,
            "driver": self.driver,
            "publishes_truth": self.publishes_truth,
            "sample_rate": self.sample_rate,
            "drum_radius": self.drum_radius,
        }
        tare = {_TARE + channel: offset for channel, offset in self.tare.items()}
        return yaml_mapping({**head, **self.parameters.as_mapping(), **tare})

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
            tare = {
                key[len(_TARE) :]: checked(Declaration(0.0, "tare of a channel", name=key), values.pop(key))
                for key in list(values)
                if key.startswith(_TARE)
            }
            known = {**declarations(RigSettings), **declarations(PresetChoice), _TRUTH.name: _TRUTH}
            for name in known.keys() & values.keys():
                values[name] = checked(known[name], values[name])
            return cls(parameters=parameters, tare=tare, **values)
        except (KeyError, TypeError, ValueError, ParameterError) as error:
            raise ConfigurationError(f"rig/description is not one of this version: {error}") from None
