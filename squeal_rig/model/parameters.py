"""The rig's parameters: one flat frozen dataclass, each field declared once."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from squeal_rig.configuration.arguments import assignments
from squeal_rig.configuration.declared import Declared, declarations, quantity
from squeal_rig.configuration.files import config_directory, load_yaml, yaml_mapping
from squeal_rig.errors import ConfigurationError, ParameterError

MACHINE, CONTACT, FRICTION, OPERATING = "machine", "contact", "friction law", "operating point"

#: Concerns that may change while the rig is active; the others are constants of the machine.
RUN_TIME_CONCERNS = (FRICTION, OPERATING)

_ANGLE = {"unit": "rad", "lower": -math.pi, "upper": math.pi, "concern": MACHINE}
_ARM_STIFFNESS = {"unit": "N/m", "lower": 0.0, "upper": 1e10, "concern": OPERATING}
_CLIP_STIFFNESS = {"unit": "N/m", "lower": 0.0, "upper": 1e11, "concern": MACHINE}
_ARM_LENGTH = {"unit": "m", "lower": 1e-3, "upper": 10.0, "concern": MACHINE, "assumed": True}
_DAMPING = {"unit": "N s/m", "lower": 0.0, "upper": 1e6, "concern": MACHINE, "assumed": True}


@dataclass(frozen=True)
class RigParameters(Declared):
    """Parameters of the two-degree-of-freedom rig, SI units. Defaults are the preset `yavuz_sen_2023`.

    Source: Yavuz and Sen, section 2, Fig. 3; the paper prints no values, docs/physics.md tells how they were found.
    """

    mass: float = quantity(11.499, "pad mass m", unit="kg", lower=1e-3, upper=1e5, concern=MACHINE)
    k1: float = quantity(4.0e7, "stiffness of the left arm", **_ARM_STIFFNESS)
    k2: float = quantity(4.0e7, "stiffness of the right arm", **_ARM_STIFFNESS)
    k3: float = quantity(2.3250e8, "stiffness of the left clip, along the belt", **_CLIP_STIFFNESS)
    k4: float = quantity(2.3250e8, "stiffness of the right clip, along the belt", **_CLIP_STIFFNESS)
    contact_stiffness: float = quantity(
        6.5074e8, "contact stiffness k_c, pushes only", unit="N/m", lower=1e-3, upper=1e12, concern=CONTACT
    )
    arm_angle_1: float = quantity(
        0.75 * math.pi, "angle of the left arm, counter-clockwise from the belt's direction", **_ANGLE
    )
    arm_angle_2: float = quantity(
        0.75 * math.pi, "angle of the right arm, counter-clockwise from the belt's direction", **_ANGLE
    )
    arm_length_1: float = quantity(0.1, "free length of the left arm's spring", **_ARM_LENGTH)
    arm_length_2: float = quantity(0.1, "free length of the right arm's spring", **_ARM_LENGTH)
    pretension_length: float = quantity(
        1e-5,
        "pretension L_pre of the contact spring",
        unit="m",
        lower=0.0,
        upper=0.1,
        concern=CONTACT,
        assumed=True,
    )
    contact_smoothing: float = quantity(
        1e7,
        "regularizing factor sigma of Eq. (3.1)",
        unit="1/m",
        lower=1.0,
        upper=1e15,
        concern=CONTACT,
        assumed=True,
    )
    damping_x: float = quantity(0.0, "viscous damping along the belt (the paper has none)", **_DAMPING)
    damping_y: float = quantity(0.0, "viscous damping normal to the belt (the paper has none)", **_DAMPING)
    preload: float = quantity(50.0, "preload F of one arm", unit="N", lower=0.0, upper=2000.0, concern=OPERATING)
    belt_speed: float = quantity(1.0, "belt speed V", unit="m/s", lower=0.0, upper=20.0, concern=OPERATING)
    mu0: float = quantity(0.25010, "friction law: constant term", lower=-10.0, upper=10.0, concern=FRICTION)
    mu_speed: float = quantity(
        9.1366e-3,
        "friction law: slope over belt speed",
        unit="s/m",
        lower=-10.0,
        upper=10.0,
        concern=FRICTION,
    )
    mu_preload: float = quantity(
        2.3202e-3, "friction law: slope over preload", unit="1/N", lower=-1.0, upper=1.0, concern=FRICTION
    )
    mu_speed_preload: float = quantity(
        -5.1639e-4,
        "friction law: interaction of speed and preload",
        unit="s/(m N)",
        lower=-1.0,
        upper=1.0,
        concern=FRICTION,
    )
    friction_direction: str = quantity(
        "constant",
        "constant: as printed in Eq. (2.3); slip: times tanh((V - vx)/regularization_speed)",
        options=("constant", "slip"),
        concern=FRICTION,
    )
    friction_speed: str = quantity(
        "belt",
        "speed seen by the friction law: belt V, or slip |V - vx|",
        options=("belt", "slip"),
        concern=FRICTION,
    )
    preload_direction: str = quantity(
        "vertical",
        "vertical: preload acts on y only, as printed; arms: along the arms",
        options=("vertical", "arms"),
        concern=MACHINE,
    )
    regularization_speed: float = quantity(
        0.01,
        "width of the tanh in slip direction",
        unit="m/s",
        lower=1e-6,
        upper=10.0,
        concern=FRICTION,
        assumed=True,
    )

    @classmethod
    def preset(cls, name: str) -> RigParameters:
        """Parameters of a named preset in `config/presets/`.

        Raises:
            ConfigurationError: no such preset; the sentence lists those there are.
        """
        folder = config_directory() / "presets"
        if name not in preset_names():
            raise ConfigurationError(f"no preset {name!r}: there are {', '.join(preset_names())}")
        return cls.from_yaml(folder / f"{name}.yaml")

    @classmethod
    def from_yaml(cls, path: Path | str) -> RigParameters:
        """Parameters from a flat YAML mapping; the key `preset`, if given, names the base it differs from."""
        content = load_yaml(path)
        if not isinstance(content, dict):
            raise ConfigurationError(f"{path}: expected a mapping of parameter names to values, got {content!r}")
        values: dict[str, object] = dict(content)
        try:
            base = cls.preset(str(values.pop("preset"))) if "preset" in values else None
            return cls.from_mapping(values, base)
        except (ConfigurationError, ParameterError) as error:
            raise type(error)(f"{path}: {error}") from None

    @classmethod
    def chosen(cls, preset: str, settings: Sequence[str] = ()) -> RigParameters:
        """Parameters of a preset with settings on top, each a word `name=value`; `pad_stiffness` sets `k1` and `k2`.

        Raises:
            ConfigurationError: no such preset.
            ParameterError: a setting is none, its name unknown or its value out of bounds.
        """
        return cls.preset(preset).replace(**assignments(settings))

    def to_yaml(self, path: Path | str) -> None:
        """Write every parameter as a flat YAML mapping that `from_yaml` reads back bit for bit."""
        Path(path).write_text(yaml_mapping(self.as_mapping()), encoding="utf-8")

    def replace(self, **changes: Any) -> RigParameters:
        """A copy with changes; `pad_stiffness` [N/m] sets `k1` and `k2`."""
        if "pad_stiffness" in changes:
            stiffness = changes.pop("pad_stiffness")
            changes = {"k1": stiffness, "k2": stiffness, **changes}
        return type(self).from_mapping(changes, self)


#: Names of the parameters that may change while the rig is active.
RUN_TIME_PARAMETERS = frozenset(
    name for name, declaration in declarations(RigParameters).items() if declaration.concern in RUN_TIME_CONCERNS
)


def preset_names() -> list[str]:
    """Names of the presets that ship with the package."""
    return sorted(path.stem for path in (config_directory() / "presets").glob("*.yaml"))
