"""The friction law mu(V, F) = mu0 + mu_V V + mu_F F + mu_VF V F (the paper's Fig. 4b, with the interaction term).

A new term stands here, in `COEFFICIENTS` and both functions of `friction_law`, and is declared in `RigParameters`;
everything else takes it from there. The law stays of first degree in the speed: the engine's series and the slope of
friction that sees the slip rest on it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from squeal_rig.model.parameters import RigParameters

#: Parameters of the law, which is linear in them.
COEFFICIENTS = ("mu0", "mu_speed", "mu_preload", "mu_speed_preload")


def friction_law(c: Mapping[str, Any], speed: Any, preload: Any) -> Any:
    """mu of coefficients `c` at a speed [m/s] and a preload [N]; numbers or arrays that broadcast."""
    return c["mu0"] + c["mu_speed"] * speed + c["mu_preload"] * preload + c["mu_speed_preload"] * speed * preload


def friction_law_slope(c: Mapping[str, Any], preload: Any) -> Any:
    """d mu/dV [s/m] of `friction_law`, the same at every speed."""
    return c["mu_speed"] + c["mu_speed_preload"] * preload


def friction_basis(speed: NDArray[np.float64], preload: NDArray[np.float64]) -> NDArray[np.float64]:
    """What each coefficient's unit contributes at operating points (n,): (n, coefficients), for fits of the law."""
    units = ({name: float(name == unit) for name in COEFFICIENTS} for unit in COEFFICIENTS)
    return np.column_stack([friction_law(unit, speed, preload) for unit in units])


def friction_coefficient(p: RigParameters, speed: float | None = None, preload: float | None = None) -> float:
    """Friction coefficient of the law at a speed [m/s] and a preload [N]; by default those of `p`."""
    v = p.belt_speed if speed is None else speed
    return float(friction_law(vars(p), v, p.preload if preload is None else preload))


def with_constant_friction(p: RigParameters, mu: float) -> RigParameters:
    """A copy whose law gives `mu` at every speed and preload."""
    return p.replace(**{**dict.fromkeys(COEFFICIENTS, 0.0), "mu0": mu})


def friction_refusal(p: RigParameters) -> str | None:
    """A sentence when the law gives a negative friction coefficient at the operating point of `p`, else None."""
    mu = friction_coefficient(p)
    if mu >= 0.0:
        return None
    return (
        f"the friction law gives mu = {mu:.4g} at preload = {p.preload:g} N and belt_speed = {p.belt_speed:g} m/s:"
        " it must be 0 or more, the point lies outside the range the law was fitted in"
    )
