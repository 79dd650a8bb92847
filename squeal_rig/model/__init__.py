"""Pure physics on SI floats: parameters, equilibrium, eigenvalues, critical stiffness, trajectories."""

from squeal_rig.model.dynamics import jacobian, state_derivative
from squeal_rig.model.eigen import eigenvalues, squeal_frequency
from squeal_rig.model.equilibrium import equilibrium
from squeal_rig.model.friction import friction_coefficient
from squeal_rig.model.parameters import RigParameters, preset_names
from squeal_rig.model.stability import (
    StabilityReport,
    critical_pad_stiffness,
    stability_band,
    stability_report,
)
from squeal_rig.model.trajectory import Motion, Trajectory, displaced_state, simulate

__all__ = [
    "Motion",
    "RigParameters",
    "StabilityReport",
    "Trajectory",
    "critical_pad_stiffness",
    "displaced_state",
    "eigenvalues",
    "equilibrium",
    "friction_coefficient",
    "jacobian",
    "preset_names",
    "simulate",
    "squeal_frequency",
    "stability_band",
    "stability_report",
    "state_derivative",
]
