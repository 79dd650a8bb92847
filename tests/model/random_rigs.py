"""Random rigs with every switch, far from the presets, reproducible by seed."""

import itertools
import math

import numpy as np

from squeal_rig.model import RigParameters

#: All combinations of friction_direction, friction_speed, preload_direction.
SWITCHES = list(itertools.product(("constant", "slip"), ("belt", "slip"), ("vertical", "arms")))


def random_rig(rng, switches):
    friction_direction, friction_speed, preload_direction = switches
    k_c = 10.0 ** rng.uniform(7.0, 10.0)
    k1, k2, k3, k4 = k_c * 10.0 ** rng.uniform(-2.0, 0.0, 4)
    angle_1, angle_2 = rng.uniform(-math.pi, math.pi, 2)
    length_1, length_2 = 10.0 ** rng.uniform(-2.0, 0.0, 2)
    c_x, c_y = 10.0 ** rng.uniform(0.0, 4.0, 2)
    return RigParameters(
        mass=10.0 ** rng.uniform(-1.0, 3.0),
        k1=k1,
        k2=k2,
        k3=k3,
        k4=k4,
        contact_stiffness=k_c,
        arm_angle_1=angle_1,
        arm_angle_2=angle_2,
        arm_length_1=length_1,
        arm_length_2=length_2,
        pretension_length=10.0 ** rng.uniform(-6.0, -3.0),
        damping_x=c_x,
        damping_y=c_y,
        preload=rng.uniform(0.0, 2000.0),
        belt_speed=rng.uniform(0.0, 20.0),
        mu0=rng.uniform(0.0, 1.0),
        mu_speed=rng.uniform(-0.1, 0.1),
        mu_preload=rng.uniform(-1e-3, 1e-3),
        mu_speed_preload=rng.uniform(-1e-3, 1e-3),
        friction_direction=friction_direction,
        friction_speed=friction_speed,
        preload_direction=preload_direction,
        regularization_speed=10.0 ** rng.uniform(-2.0, 1.0),
    )


def random_state(rng, p, closed):
    """A state on or off the belt, away from the kinks at y = L_pre and zero slip, up to 0.1 L from the origin."""
    reach = 0.1 * min(p.arm_length_1, p.arm_length_2)
    size = reach * 10.0 ** rng.uniform(-4.0, 0.0, 2)
    x = rng.choice([-1.0, 1.0]) * size[0]
    y = p.pretension_length + (-size[1] if closed else size[1])
    # Slip within a few widths of the tanh, where its slope counts.
    slip = rng.choice([-1.0, 1.0]) * p.regularization_speed * rng.uniform(0.1, 3.0)
    return np.array([x, y, p.belt_speed - slip, rng.uniform(-1.0, 1.0)])
