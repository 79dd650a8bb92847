"""Contact forces as the instruments tell them, Eq. (2.1), and means over a block for displays."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from squeal_rig.instruments.acquisition import Block
from squeal_rig.instruments.driver import Samples
from squeal_rig.model.parameters import RigParameters

Values = NDArray[np.float64]


def contact_forces(daq: Samples, p: RigParameters, drum_radius: float) -> tuple[Values, Values]:
    """Numerator F_t = torque/R and denominator of Eq. (2.1) [N], each (n,); the drum's radius is in m.

    With sin theta of each arm by itself; the preload is the one in force, from its channel. The denominator equals N
    only where m y'' + c_y y' = 0: it holds in steady sliding and is badly biased in squeal.
    """
    sine_1, sine_2 = math.sin(p.arm_angle_1), math.sin(p.arm_angle_2)
    tangential = daq["motor_torque"] / drum_radius
    normal = daq["arm_left"] * sine_1 + daq["arm_right"] * sine_2 + daq["preload"] * (sine_1 + sine_2)
    return tangential, normal


@dataclass(frozen=True)
class BlockMeans:
    """Mean pad position [m] and velocity [m/s] as (x, y), mean tangential and normal contact force on the pad [N]."""

    position: tuple[float, float]
    velocity: tuple[float, float]
    tangential: float
    normal: float


def block_means(block: Block, p: RigParameters, drum_radius: float) -> BlockMeans:
    """Means of a block. Without truth the forces are those of Eq. (2.1), the velocities mean slopes."""
    daq, truth = block.daq, block.truth
    position = float(daq["x"].mean()), float(daq["y"].mean())
    if truth is not None:
        velocity = float(truth["vx"].mean()), float(truth["vy"].mean())
        return BlockMeans(
            position, velocity, float(truth["tangential_force"].mean()), float(truth["normal_force"].mean())
        )
    span = float(daq["t"][-1] - daq["t"][0])
    slope_x, slope_y = (float(daq[axis][-1] - daq[axis][0]) / span for axis in ("x", "y"))
    tangential, normal = contact_forces(daq, p, drum_radius)
    return BlockMeans(position, (slope_x, slope_y), float(tangential.mean()), float(normal.mean()))
