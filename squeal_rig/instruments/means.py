"""Means over a block, for displays: true values where there are any, else what the instruments tell."""

from __future__ import annotations

import math
from dataclasses import dataclass

from squeal_rig.instruments.acquisition import Block
from squeal_rig.model.parameters import RigParameters


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
    sine_1, sine_2 = math.sin(p.arm_angle_1), math.sin(p.arm_angle_2)
    normal = daq["arm_left"] * sine_1 + daq["arm_right"] * sine_2 + daq["preload"] * (sine_1 + sine_2)
    return BlockMeans(
        position, (slope_x, slope_y), float(daq["motor_torque"].mean()) / drum_radius, float(normal.mean())
    )
