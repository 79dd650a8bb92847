"""The one layout in which compiled code sees parameters, states and samples, and how parameters get there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from squeal_rig.configuration.declared import checked, declarations
from squeal_rig.errors import ParameterError
from squeal_rig.model.core.law import friction_law, friction_law_slope
from squeal_rig.model.parameters import RigParameters

Vector = NDArray[np.float64]

#: Columns of a block of samples: the state [m, m/s], then the forces on the pad [N].
X, Y, VX, VY, NORMAL, TANGENTIAL = range(6)
STATE_SIZE, SAMPLE_SIZE = 4, 6
CACHE_LINE = 8  # numbers in it

# Packed parameters, SI.
MASS, K1, K2, K34, K_C, L_PRE, C_X, C_Y = range(8)
L1, A1X, A1Y, L2, A2X, A2Y = range(8, 14)  # free lengths and anchors a_i = L_i (cos theta_i, sin theta_i)
LOAD_X, LOAD_Y = 14, 15  # the preload's force on the pad
MU, MU_AT_ZERO, MU_SLOPE, SPEED, V_REG = range(16, 21)  # the friction law at V and at 0, and d mu/dV
SLIP_DIRECTION, SLIP_SPEED = 21, 22  # 1.0 where the switch is on
COS_1, SIN_1, COS_2, SIN_2, SIGMA = range(23, 28)
PACKED_SIZE = 28


def sample_room(samples: int, columns: int = SAMPLE_SIZE) -> Vector:
    """Room for a block of samples, float64 (samples, columns), which the exact engine fills in place.

    Column stands after column, a cache line further apart than they are long. numba compiles the engine for each kind
    of layout; such blocks and slices of them have one and the same, since none is contiguous, and so have transposed
    slices of columns in compiled code. Columns 4096 bytes apart would share a place in the nearest cache.
    """
    room: Vector = np.empty((columns, samples + CACHE_LINE)).T
    return room[:samples]


def checked_arrays(
    given: Mapping[str, ArrayLike], fields: Sequence[str], purpose: str
) -> tuple[dict[str, Vector], tuple[int, ...]]:
    """What varies over many rigs as arrays by field name, every value within its declared bounds, and their one shape.

    Args:
        given: arrays by name; `pad_stiffness` stands for k1 and k2 at once.
        fields: the numeric fields of `RigParameters` that may vary.
        purpose: what they are parameters of, for the sentence.

    Raises:
        ParameterError: an unknown field, a value out of its bounds, or shapes that do not broadcast.
    """
    known = declarations(RigParameters)
    arrays: dict[str, Vector] = {}
    for name, values in given.items():
        names = ("k1", "k2") if name == "pad_stiffness" else (name,)
        if names[0] not in fields:
            raise ParameterError(
                f"{name!r} is not a parameter of {purpose}: those are {', '.join((*fields, 'pad_stiffness'))}"
            )
        try:
            array: NDArray[np.float64] = np.asarray(values, dtype=np.float64)
        except (TypeError, ValueError):
            raise ParameterError(f"{name} = {values!r} is not an array of numbers") from None
        bounds = known[names[0]]
        wrong = ~((array >= bounds.lower) & (array <= bounds.upper))
        if wrong.any():
            checked(bounds, float(array[wrong].flat[0]))
        arrays.update(dict.fromkeys(names, array))
    try:
        return arrays, np.broadcast_shapes(*(array.shape for array in arrays.values()))
    except ValueError:
        shapes = ", ".join(f"{name} {array.shape}" for name, array in arrays.items())
        raise ParameterError(f"these shapes do not broadcast to one grid: {shapes}") from None


def pack(p: RigParameters | Mapping[str, Any]) -> Vector:
    """Parameters as the kernels see them: float64 (..., 28), SI.

    `p` is one rig, or the values of all its fields by name, numbers and arrays that broadcast to one shape.
    """
    values: Mapping[str, Any] = vars(p) if isinstance(p, RigParameters) else p
    shape = () if values is not p else np.broadcast_shapes(*(np.shape(value) for value in values.values()))
    q = np.empty((*shape, PACKED_SIZE))
    for column, value in packed_columns(values).items():
        q[..., column] = value
    return q


def packed_columns(v: Mapping[str, Any]) -> dict[int, Any]:
    """Column -> number or array, of the values of all fields by name: what does not vary stays a number."""
    preload, speed = v["preload"], v["belt_speed"]
    c1, s1 = np.cos(v["arm_angle_1"]), np.sin(v["arm_angle_1"])
    c2, s2 = np.cos(v["arm_angle_2"]), np.sin(v["arm_angle_2"])
    return {
        MASS: v["mass"],
        K1: v["k1"],
        K2: v["k2"],
        K34: v["k3"] + v["k4"],
        K_C: v["contact_stiffness"],
        L_PRE: v["pretension_length"],
        C_X: v["damping_x"],
        C_Y: v["damping_y"],
        L1: v["arm_length_1"],
        A1X: v["arm_length_1"] * c1,
        A1Y: v["arm_length_1"] * s1,
        L2: v["arm_length_2"],
        A2X: v["arm_length_2"] * c2,
        A2Y: v["arm_length_2"] * s2,
        LOAD_X: np.where(_chosen(v, "preload_direction", "arms"), -preload * (c1 + c2), 0.0),
        LOAD_Y: -preload * (s1 + s2),
        MU: friction_law(v, speed, preload),
        MU_AT_ZERO: friction_law(v, 0.0, preload),
        MU_SLOPE: friction_law_slope(v, preload),
        SPEED: speed,
        V_REG: v["regularization_speed"],
        SLIP_DIRECTION: _chosen(v, "friction_direction", "slip"),
        SLIP_SPEED: _chosen(v, "friction_speed", "slip"),
        COS_1: c1,
        SIN_1: s1,
        COS_2: c2,
        SIN_2: s2,
        SIGMA: v["contact_smoothing"],
    }


def _chosen(v: Mapping[str, Any], switch: str, option: str) -> NDArray[np.bool_]:
    return np.asarray(np.asarray(v[switch]) == option)
