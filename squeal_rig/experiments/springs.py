"""Springs of the arms as a named set: a catalogue in YAML, from which the steps of a plan take one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from squeal_rig.configuration.declared import Declared, quantity
from squeal_rig.configuration.files import config_directory, load_yaml
from squeal_rig.errors import ConfigurationError, ParameterError

_MOST = 256


@dataclass(frozen=True)
class Spring(Declared):
    """Each entry of a catalogue: one pair of springs, one for each arm."""

    stiffness: float = quantity(4.0e7, "stiffness of one arm with it", unit="N/m", lower=1.0, upper=1e10)
    tolerance: float = quantity(
        0.05, "share that the stiffness may be off by, as its maker states", lower=0.0, upper=0.5
    )


def looks_like_springs(content: Mapping[object, object]) -> bool:
    """Whether a YAML file's content is a catalogue of springs."""
    return any(isinstance(value, Mapping) and "stiffness" in value for value in content.values())


def load_springs(path: Path | str | None = None) -> dict[str, Spring]:
    """Name -> spring of a catalogue; that in `config/springs.yaml` where none is named.

    Raises:
        ConfigurationError: it cannot be read, or an entry is not as it must be.
    """
    file = path or config_directory() / "springs.yaml"
    content = load_yaml(file)
    if not isinstance(content, dict) or not content or len(content) > _MOST:
        raise ConfigurationError(f"{file}: a catalogue of springs is a mapping of 1 to {_MOST} names")
    springs = {}
    for name, values in content.items():
        if not isinstance(values, dict) or "stiffness" not in values:
            raise ConfigurationError(f"{file}, {name}: a spring is a mapping with a stiffness [N/m] and a tolerance")
        try:
            springs[str(name)] = Spring.from_mapping(values)
        except ParameterError as error:
            raise ConfigurationError(f"{file}, {name}: {error}") from None
    return springs
