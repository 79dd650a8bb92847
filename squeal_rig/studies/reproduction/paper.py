"""The numbers that the paper's text reports, as the reproduction lays them out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from squeal_rig.configuration.files import config_directory
from squeal_rig.errors import ConfigurationError
from squeal_rig.estimation.calibration.targets import Target, load_targets

_TABLE_1 = ("nonlinear_frequency", "squeal_frequency", "contact_loss")


@dataclass(frozen=True)
class FrequencyRow:
    """A row of Table 1: stiffness [N/m], squeal frequencies [Hz], contact-loss duration [s]."""

    k: float
    f_nonlinear: float
    f_linear: float
    contact_loss_s: float


@dataclass(frozen=True)
class PaperNumbers:
    """All numbers of the text. Table 1 holds at `table_preload` [N] and `table_speed` [m/s].

    `superharmonics`: whether there are any, by preload [N] and pad stiffness [N/m].
    """

    thresholds: tuple[Target, ...]
    table: tuple[FrequencyRow, ...]
    table_preload: float
    table_speed: float
    superharmonics: Mapping[tuple[float, float], bool]
    jumps: tuple[Target, ...]


def paper_numbers() -> PaperNumbers:
    """The numbers that ship in `config/paper/`.

    Raises:
        ConfigurationError: the file is missing or not as it must be.
    """
    path = config_directory() / "paper" / "yavuz_sen_2023.yaml"
    targets = load_targets(path)
    columns = [targets.of(kind) for kind in _TABLE_1]
    if not columns[0] or len({len(column) for column in columns}) != 1:
        raise ConfigurationError(f"{path}: not the numbers of the paper: Table 1 is not whole")
    first = columns[0][0]
    return PaperNumbers(
        thresholds=targets.of("critical_pad_stiffness"),
        table=tuple(
            FrequencyRow(row[0].pad_stiffness, *(item.value for item in row)) for row in zip(*columns, strict=True)
        ),
        table_preload=first.preload,
        table_speed=first.belt_speed,
        superharmonics=targets.superharmonics,
        jumps=targets.of("peak_displacement_jump"),
    )
