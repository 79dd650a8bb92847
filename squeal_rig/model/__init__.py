"""Pure physics on SI floats: parameters, equilibrium, eigenvalues, critical stiffness, trajectories."""

from squeal_rig.model.contact import ContactEvents, contact_events
from squeal_rig.model.dynamics import jacobian, state_derivative
from squeal_rig.model.eigen import eigenvalues, squeal_frequency
from squeal_rig.model.energy import EnergyBalance, energy_balance
from squeal_rig.model.ensemble import Ensemble, simulate_many
from squeal_rig.model.equilibrium import equilibrium
from squeal_rig.model.friction import friction_coefficient
from squeal_rig.model.maps import StabilityMap, stability_map
from squeal_rig.model.parameters import RigParameters, preset_names
from squeal_rig.model.stability import (
    StabilityReport,
    critical_pad_stiffness,
    stability_band,
    stability_report,
)
from squeal_rig.model.trajectory import Motion, Trajectory, displaced_state, simulate

__all__ = [
    "ContactEvents",
    "EnergyBalance",
    "Ensemble",
    "Motion",
    "RigParameters",
    "StabilityMap",
    "StabilityReport",
    "Trajectory",
    "contact_events",
    "critical_pad_stiffness",
    "displaced_state",
    "eigenvalues",
    "energy_balance",
    "equilibrium",
    "friction_coefficient",
    "jacobian",
    "preset_names",
    "simulate",
    "simulate_many",
    "squeal_frequency",
    "stability_band",
    "stability_map",
    "stability_report",
    "state_derivative",
]
