"""Pure physics on SI floats: parameters, equilibrium, eigenvalues, critical stiffness, trajectories.

Each name is imported when it is first asked for: parameters need no compiler, and loading numba takes half a second.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from squeal_rig.model.contact import ContactEvents, contact_events
    from squeal_rig.model.dynamics import jacobian, state_derivative
    from squeal_rig.model.eigen import eigenvalues, squeal_frequency
    from squeal_rig.model.energy import EnergyBalance, energy_balance
    from squeal_rig.model.ensemble import Ensemble, simulate_many
    from squeal_rig.model.friction import friction_coefficient
    from squeal_rig.model.maps import StabilityMap, stability_map
    from squeal_rig.model.parameters import RigParameters, preset_names
    from squeal_rig.model.stability import (
        StabilityReport,
        critical_pad_stiffness,
        stability_band,
        stability_report,
    )
    from squeal_rig.model.statics import equilibrium
    from squeal_rig.model.trajectory import Motion, Trajectory, displaced_state, simulate

_HOMES = {
    "ContactEvents": "contact",
    "EnergyBalance": "energy",
    "Ensemble": "ensemble",
    "Motion": "trajectory",
    "RigParameters": "parameters",
    "StabilityMap": "maps",
    "StabilityReport": "stability",
    "Trajectory": "trajectory",
    "contact_events": "contact",
    "critical_pad_stiffness": "stability",
    "displaced_state": "trajectory",
    "eigenvalues": "eigen",
    "energy_balance": "energy",
    "equilibrium": "statics",
    "friction_coefficient": "friction",
    "jacobian": "dynamics",
    "preset_names": "parameters",
    "simulate": "trajectory",
    "simulate_many": "ensemble",
    "squeal_frequency": "eigen",
    "stability_band": "stability",
    "stability_map": "maps",
    "stability_report": "stability",
    "state_derivative": "dynamics",
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
