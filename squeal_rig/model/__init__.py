"""Pure physics on SI floats: parameters, equilibrium, eigenvalues, critical stiffness, trajectories.

Each name is imported when it is first asked for: parameters need no compiler, and loading numba takes half a second.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from squeal_rig.model.core.forces import jacobian, state_derivative
    from squeal_rig.model.core.law import friction_coefficient
    from squeal_rig.model.core.statics import equilibrium
    from squeal_rig.model.linear.eigen import (
        StabilityReport,
        critical_pad_stiffness,
        eigenvalues,
        squeal_frequency,
        stability_band,
        stability_report,
    )
    from squeal_rig.model.linear.maps import StabilityMap, stability_map
    from squeal_rig.model.motion.contact import ContactEvents, contact_events
    from squeal_rig.model.motion.energy import EnergyBalance, energy_balance
    from squeal_rig.model.motion.ensemble import Ensemble, simulate_many
    from squeal_rig.model.motion.trajectory import Motion, Trajectory, displaced_state, simulate, simulate_blocks
    from squeal_rig.model.parameters import RigParameters, preset_names

_HOMES = {
    "ContactEvents": "motion.contact",
    "EnergyBalance": "motion.energy",
    "Ensemble": "motion.ensemble",
    "Motion": "motion.trajectory",
    "RigParameters": "parameters",
    "StabilityMap": "linear.maps",
    "StabilityReport": "linear.eigen",
    "Trajectory": "motion.trajectory",
    "contact_events": "motion.contact",
    "critical_pad_stiffness": "linear.eigen",
    "displaced_state": "motion.trajectory",
    "eigenvalues": "linear.eigen",
    "energy_balance": "motion.energy",
    "equilibrium": "core.statics",
    "friction_coefficient": "core.law",
    "jacobian": "core.forces",
    "preset_names": "parameters",
    "simulate": "motion.trajectory",
    "simulate_blocks": "motion.trajectory",
    "simulate_many": "motion.ensemble",
    "squeal_frequency": "linear.eigen",
    "stability_band": "linear.eigen",
    "stability_map": "linear.maps",
    "stability_report": "linear.eigen",
    "state_derivative": "core.forces",
}

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
    "simulate_blocks",
    "simulate_many",
    "squeal_frequency",
    "stability_band",
    "stability_map",
    "stability_report",
    "state_derivative",
]


def __getattr__(name: str) -> Any:
    """The public name, from its module."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return __all__
