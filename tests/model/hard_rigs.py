"""Random rigs between quiet and squeal, and the same questions asked in another way."""

import math

import numpy as np

from squeal_rig.errors import ModelError
from squeal_rig.model import (
    Motion,
    RigParameters,
    contact_events,
    eigenvalues,
    equilibrium,
    follow_cycle,
    squeal_cycle,
    zone,
)

PLAIN = {"mu_speed": 0.0, "mu_preload": 0.0, "mu_speed_preload": 0.0}


def random_hard_rig(rng):
    """Damping 100 to 5000 N s/m, k 1e7 to 1e8 N/m, arm angles 120 to 150 degrees, unequal arms among them."""
    c, k = 10.0 ** rng.uniform(2.0, math.log10(5000.0)), 10.0 ** rng.uniform(7.0, 8.0)
    angles = np.radians(rng.uniform(120.0, 150.0, 2))
    if rng.random() < 0.5:
        angles[1] = angles[0]
    share = rng.uniform(0.5, 1.5) if rng.random() < 0.5 else 1.0
    return RigParameters(
        damping_x=c,
        damping_y=c,
        k1=k * share,
        k2=k * (2.0 - share),
        arm_angle_1=float(angles[0]),
        arm_angle_2=float(angles[1]),
        mu0=0.3,
        **PLAIN,
    )


def followed(p):
    """The branch in mu0 from a squeal cycle between both borders, and the threshold it should end at."""
    borders = zone(p)
    rig = p.replace(mu0=borders.fold_mu + 0.3 * (borders.flutter_mu - borders.fold_mu))
    found = follow_cycle(rig, squeal_cycle(rig), "mu0", bounds=(0.0, 1.2 * borders.flutter_mu))
    return found, borders.flutter_mu


def flutter_by_eigenvalues(p, near):
    """Friction coefficient and frequency [Hz] at which LAPACK's eigenvalues begin to grow, by bisection."""
    low, high = 0.99 * near, 1.01 * near
    for _ in range(60):
        middle = 0.5 * (low + high)
        if np.max(eigenvalues(p.replace(mu0=middle)).real) > 0.0:
            high = middle
        else:
            low = middle
    values = eigenvalues(p.replace(mu0=high))
    return high, abs(values[np.argmax(values.real)].imag) / (2.0 * math.pi)


def random_point(rng):
    """An operating point anywhere between quiet and squeal, damped, with unequal damping, arms and angles at times."""
    c, k = 10.0 ** rng.uniform(1.5, 3.7), 10.0 ** rng.uniform(6.3, 8.0)
    p = RigParameters(
        damping_x=c,
        damping_y=c if rng.random() < 0.5 else c * rng.uniform(0.5, 2.0),
        k1=k if rng.random() < 0.75 else 0.7 * k,
        k2=k,
        preload=rng.uniform(10.0, 300.0),
        mu0=10.0 ** rng.uniform(-1.7, 0.0),
        **PLAIN,
    )
    if rng.random() < 0.33:
        angle_1, angle_2 = np.radians(rng.uniform(120.0, 150.0, 2)).tolist()
        p = p.replace(arm_angle_1=angle_1, arm_angle_2=angle_2)
    return p


def share_on_belt_after(p, state, settle, window=0.1):
    """Share of the time in contact after the motion from a state has settled; nan where it left the small motions."""
    motion, block = Motion(p, 51200.0, state), np.empty((512, 6))
    try:
        for _ in range(int(settle * 51200.0 / 512.0) + 1):
            motion.advance(block)
            if np.max(np.abs(block[:, :2])) > 1e-3:
                return math.nan
        events = contact_events(p, window, initial_state=motion.state)
    except ModelError:
        return math.nan
    return events.contact_time / events.duration


def zone_by_force(p, sizes=(0.3, 1.0, 3.0, 10.0)):
    """Zone by hits in eight directions and long runs, with no criterion but what is left after ten times the slowest
    decay; how many of the hits squeal, and of how many.
    """
    values = eigenvalues(p)
    if np.max(values.real) > 0.0:
        return "squeal", 0, 0
    slowest = min(-np.max(values.real), min(p.damping_x, p.damping_y) / (2.0 * p.mass))
    settle = min(10.0 / slowest, 40.0)
    x, y = equilibrium(p)
    speed = (p.pretension_length - y) * math.sqrt(p.contact_stiffness / p.mass)
    squeals, tried = 0, 0
    for size in sizes:
        for angle in np.arange(8) * math.pi / 4.0:
            start = np.array([x, y, size * speed * math.cos(angle), size * speed * math.sin(angle)])
            tried += 1
            squeals += share_on_belt_after(p, start, settle) < 0.9999
        if squeals and size >= 1.0:
            break
    return ("bistable" if squeals else "quiet"), squeals, tried
