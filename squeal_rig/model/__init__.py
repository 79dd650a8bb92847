"""Pure physics on SI floats: parameters, equilibrium, eigenvalues, critical stiffness, trajectories.

Each name is imported when it is first asked for: parameters need no compiler, and loading numba takes half a second.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from squeal_rig.model.core.forces import jacobian, state_derivative
    from squeal_rig.model.core.law import friction_coefficient
    from squeal_rig.model.core.layout import sample_room
    from squeal_rig.model.core.statics import equilibrium
    from squeal_rig.model.cycles.branch import Branch, FoldCurve, fold_curve, follow_cycle
    from squeal_rig.model.cycles.cycle import SquealCycle, squeal_cycle
    from squeal_rig.model.cycles.hits import BasinShare, Hit, basin_share, smallest_hit
    from squeal_rig.model.cycles.safe import safe_hit
    from squeal_rig.model.cycles.zone_map import ZoneMap, zone_map
    from squeal_rig.model.cycles.zones import Zone, zone
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
    "BasinShare": "cycles.hits",
    "Branch": "cycles.branch",
    "ContactEvents": "motion.contact",
    "EnergyBalance": "motion.energy",
    "Ensemble": "motion.ensemble",
    "FoldCurve": "cycles.branch",
    "Hit": "cycles.hits",
    "Motion": "motion.trajectory",
    "RigParameters": "parameters",
    "SquealCycle": "cycles.cycle",
    "StabilityMap": "linear.maps",
    "StabilityReport": "linear.eigen",
    "Trajectory": "motion.trajectory",
    "Zone": "cycles.zones",
    "ZoneMap": "cycles.zone_map",
    "basin_share": "cycles.hits",
    "contact_events": "motion.contact",
    "critical_pad_stiffness": "linear.eigen",
    "displaced_state": "motion.trajectory",
    "eigenvalues": "linear.eigen",
    "energy_balance": "motion.energy",
    "equilibrium": "core.statics",
    "fold_curve": "cycles.branch",
    "follow_cycle": "cycles.branch",
    "friction_coefficient": "core.law",
    "jacobian": "core.forces",
    "preset_names": "parameters",
    "safe_hit": "cycles.safe",
    "sample_room": "core.layout",
    "simulate": "motion.trajectory",
    "simulate_blocks": "motion.trajectory",
    "simulate_many": "motion.ensemble",
    "smallest_hit": "cycles.hits",
    "squeal_cycle": "cycles.cycle",
    "squeal_frequency": "linear.eigen",
    "stability_band": "linear.eigen",
    "stability_map": "linear.maps",
    "stability_report": "linear.eigen",
    "state_derivative": "core.forces",
    "zone": "cycles.zones",
    "zone_map": "cycles.zone_map",
}

__all__ = [
    "BasinShare",
    "Branch",
    "ContactEvents",
    "EnergyBalance",
    "Ensemble",
    "FoldCurve",
    "Hit",
    "Motion",
    "RigParameters",
    "SquealCycle",
    "StabilityMap",
    "StabilityReport",
    "Trajectory",
    "Zone",
    "ZoneMap",
    "basin_share",
    "contact_events",
    "critical_pad_stiffness",
    "displaced_state",
    "eigenvalues",
    "energy_balance",
    "equilibrium",
    "fold_curve",
    "follow_cycle",
    "friction_coefficient",
    "jacobian",
    "preset_names",
    "safe_hit",
    "sample_room",
    "simulate",
    "simulate_blocks",
    "simulate_many",
    "smallest_hit",
    "squeal_cycle",
    "squeal_frequency",
    "stability_band",
    "stability_map",
    "stability_report",
    "state_derivative",
    "zone",
    "zone_map",
]


def __getattr__(name: str) -> Any:
    """The public name, from its module."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return __all__
