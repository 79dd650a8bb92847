"""What the inverse problem allows: floors of the thresholds' errors, trade-off with frequencies and mass."""

from __future__ import annotations

from dataclasses import dataclass

from squeal_rig.configuration.files import config_directory
from squeal_rig.estimation.calibration import Floors, bilinear_floors, load_calibration
from squeal_rig.studies.inverse.tradeoff import TradeOff, trade_off

#: The curve's points: weights of the frequencies, upper bounds of the mass [kg]; `make evidence` takes more of both.
_WEIGHTS = (0.01, 0.1, 0.3, 1.0, 10.0)
_MASSES = (10.0, 15.0, 30.0, 100.0)
_STARTS = 2


@dataclass(frozen=True)
class InverseResults:
    """Floors for any bilinear friction law, and points of the trade-off curve."""

    floors: Floors
    curve: list[TradeOff]


def solve_inverse() -> InverseResults:
    """Floors and trade-off for the paper's targets, from the calibration that ships."""
    problem = load_calibration(config_directory() / "calibrations" / "yavuz_sen_2023.yaml")
    return InverseResults(bilinear_floors(problem.targets), trade_off(problem, _WEIGHTS, _MASSES, starts=_STARTS))
