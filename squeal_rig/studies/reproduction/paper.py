"""The numbers that the paper's text reports."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from squeal_rig.configuration.files import config_directory, load_yaml
from squeal_rig.errors import ConfigurationError


@dataclass(frozen=True)
class Threshold:
    """A critical pad stiffness [N/m] at a preload [N] and a belt speed [m/s], and the figure that shows it."""

    preload: float
    belt_speed: float
    k_cr: float
    source: str


@dataclass(frozen=True)
class FrequencyRow:
    """A row of Table 1: stiffness [N/m], squeal frequencies [Hz], contact-loss duration [s]."""

    k: float
    f_nonlinear: float
    f_linear: float
    contact_loss_s: float


@dataclass(frozen=True)
class Jump:
    """A panel of Fig. 12: preload [N] at which the peak displacement jumps, None where it does not."""

    k: float
    belt_speed: float
    jump_preload: float | None


@dataclass(frozen=True)
class PaperNumbers:
    """All numbers of the text. Table 1 holds at `table_preload` [N] and `table_speed` [m/s]."""

    thresholds: tuple[Threshold, ...]
    table: tuple[FrequencyRow, ...]
    table_preload: float
    table_speed: float
    superharmonics: dict[tuple[float, float], bool]
    jumps: tuple[Jump, ...]


def paper_numbers() -> PaperNumbers:
    """The numbers that ship in `config/paper/`.

    Raises:
        ConfigurationError: the file is missing or not as it must be.
    """
    path = config_directory() / "paper" / "yavuz_sen_2023.yaml"
    content: dict[str, Any] = load_yaml(path)
    try:
        table = content["squeal_frequency"]
        present = {
            (float(row["preload"]), float(k)): bool(there)
            for row in content["superharmonics"]
            for k, there in row["present"].items()
        }
        return PaperNumbers(
            thresholds=tuple(Threshold(**row) for row in content["critical_pad_stiffness"]),
            table=tuple(FrequencyRow(**row) for row in table["rows"]),
            table_preload=table["preload"],
            table_speed=table["belt_speed"],
            superharmonics=present,
            jumps=tuple(Jump(**row) for row in content["peak_displacement_jump"]),
        )
    except (KeyError, TypeError) as error:
        raise ConfigurationError(f"{path}: not the numbers of the paper: {error}") from None
