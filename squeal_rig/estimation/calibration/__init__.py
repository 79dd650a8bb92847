"""The inverse problem: parameters of the rig from thresholds, frequencies, contact loss and jumps."""

from squeal_rig.estimation.calibration.floors import Floors, bilinear_floors, largest_floor, searched_floor
from squeal_rig.estimation.calibration.identifiability import Identifiability, identifiability
from squeal_rig.estimation.calibration.problem import Calibration, load_calibration
from squeal_rig.estimation.calibration.residuals import Residual, residual_lines, residuals, spread_lines, write_preset
from squeal_rig.estimation.calibration.search import Found, calibrate
from squeal_rig.estimation.calibration.targets import Target, Targets, load_targets

__all__ = [
    "Calibration",
    "Floors",
    "Found",
    "Identifiability",
    "Residual",
    "Target",
    "Targets",
    "bilinear_floors",
    "calibrate",
    "identifiability",
    "largest_floor",
    "load_calibration",
    "load_targets",
    "residual_lines",
    "residuals",
    "searched_floor",
    "spread_lines",
    "write_preset",
]
