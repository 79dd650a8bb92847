"""The friction law mu(V, F) = mu0 + mu_V V + mu_F F + mu_VF V F (the paper's Fig. 4b, with the interaction term)."""

from __future__ import annotations

import math

from squeal_rig.model.parameters import RigParameters


def friction_coefficient(p: RigParameters, speed: float | None = None, preload: float | None = None) -> float:
    """Friction coefficient of the law at a speed [m/s] and a preload [N]; by default those of `p`."""
    v = p.belt_speed if speed is None else speed
    f = p.preload if preload is None else preload
    return p.mu0 + p.mu_speed * v + p.mu_preload * f + p.mu_speed_preload * v * f


def force_ratio(p: RigParameters, vx: float = 0.0) -> float:
    """F_t / N at pad velocity vx [m/s]: the law, with the switches for slip speed and slip direction."""
    slip = p.belt_speed - vx
    mu = friction_coefficient(p, speed=abs(slip)) if p.friction_speed == "slip" else friction_coefficient(p)
    return mu * math.tanh(slip / p.regularization_speed) if p.friction_direction == "slip" else mu


def force_ratio_slope(p: RigParameters, vx: float = 0.0) -> float:
    """d(F_t/N)/d(vx) at pad velocity vx [s/m]: zero for the printed law, else what slip-dependent friction adds.

    With `friction_speed="slip"` it acts like damping c_x = N dmu/dV on x alone. A negative slope destabilises the
    undamped rig everywhere, a positive one too where K_ab (K_ab + mu k_c) < 0: only with c > 0 is its sign decisive.
    """
    slip = p.belt_speed - vx
    mu, slope = friction_coefficient(p), 0.0
    if p.friction_speed == "slip":
        mu = friction_coefficient(p, speed=abs(slip))
        slope = -(p.mu_speed + p.mu_speed_preload * p.preload) * math.copysign(1.0, slip)
    if p.friction_direction == "slip":
        tanh = math.tanh(slip / p.regularization_speed)
        slope = slope * tanh - mu * (1.0 - tanh * tanh) / p.regularization_speed
    return slope


def friction_refusal(p: RigParameters) -> str | None:
    """A sentence when the law gives a negative friction coefficient at the operating point of `p`, else None."""
    mu = friction_coefficient(p)
    if mu >= 0.0:
        return None
    return (
        f"the friction law gives mu = {mu:.4g} at preload = {p.preload:g} N and belt_speed = {p.belt_speed:g} m/s:"
        " it must be 0 or more, the point lies outside the range the law was fitted in"
    )
