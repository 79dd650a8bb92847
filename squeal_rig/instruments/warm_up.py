"""Compile, or load, everything that is ever compiled: once at installation instead of at the first use."""

from __future__ import annotations

import numpy as np

from squeal_rig.instruments.settings import RigSettings
from squeal_rig.instruments.virtual import VirtualRig
from squeal_rig.model.core.forces import jacobian, state_derivative
from squeal_rig.model.core.statics import equilibrium
from squeal_rig.model.cycles.cycle import squeal_cycle
from squeal_rig.model.cycles.hits import smallest_hit
from squeal_rig.model.cycles.safe import safe_hit
from squeal_rig.model.cycles.zone_map import zone_map
from squeal_rig.model.linear.eigen import critical_pad_stiffness, eigenvalues, stability_report
from squeal_rig.model.linear.maps import map_points, stability_map
from squeal_rig.model.motion.contact import contact_events
from squeal_rig.model.motion.energy import energy_balance
from squeal_rig.model.motion.ensemble import simulate_many
from squeal_rig.model.motion.trajectory import displaced_state, simulate
from squeal_rig.model.parameters import RigParameters

_MOMENT = 1e-4  # simulated [s]


def warm_up() -> None:
    """Call every kernel of the model and of the virtual rig once; numba keeps the code on disk."""
    p = RigParameters()
    slips = p.replace(friction_direction="slip", friction_speed="slip")
    damped = p.replace(damping_x=20.0)
    hittable = p.replace(damping_x=1000.0, damping_y=1000.0)
    rig = VirtualRig()
    for instruments in ("ideal", "typical"):
        rig.open(p, RigSettings(instruments=instruments))
        rig.close()
    for rig_parameters in (p, slips, damped):
        equilibrium(rig_parameters, linear=True)
        stability_report(rig_parameters)
        eigenvalues(rig_parameters, linear=True)
        critical_pad_stiffness(rig_parameters)
        stability_map(rig_parameters, preload=np.array([50.0, 300.0]), eigenvalues=True)
        map_points({**rig_parameters.as_mapping(), "preload": np.array([50.0, 300.0])}, at_rest=True)
    squeal_cycle(hittable)
    smallest_hit(hittable, 0.0)
    safe_hit(hittable)
    zone_map(hittable, preload=[50.0, 300.0])
    start = displaced_state(p, 0.1)
    jacobian(p, start)
    state_derivative(p, start)
    energy_balance(p, _MOMENT)
    contact_events(p, _MOMENT)
    contact_events(slips, _MOMENT)
    simulate_many(p, _MOMENT, preload=[50.0, 300.0])
    for engine, rig_parameters in (("exact", p), ("exact", slips), ("rk4", p)):
        run = simulate(rig_parameters, _MOMENT, engine=engine)
        _ = run.normal_force
