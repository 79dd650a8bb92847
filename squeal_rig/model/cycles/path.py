"""A rig along one of its parameters: packed values, their exact derivative, and how far the parameter may go."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from squeal_rig.configuration.declared import declarations
from squeal_rig.errors import ModelError, ParameterError
from squeal_rig.model.core.law import COEFFICIENTS, friction_law
from squeal_rig.model.core.layout import PACKED_SIZE, Vector, pack, packed_columns
from squeal_rig.model.parameters import RigParameters

PAD_STIFFNESS = "pad_stiffness"
# The packed parameters are analytic in each field: of an imaginary step only the exact derivative remains.
_IMAGINARY = 1e-30
# Fields in which some packed column is not linear.
_CURVED = ("arm_angle_1", "arm_angle_2", "arm_length_1", "arm_length_2")


def refuse_what_has_no_cycles(p: RigParameters) -> None:
    """Refuse rigs for which cycles, zones and hits do not exist or are not computed.

    Raises:
        ModelError: friction sees the slip; or a rig without damping, where nothing dies out.
    """
    if p.friction_direction != "constant" or p.friction_speed != "belt":
        raise ModelError(
            "cycles, zones and hits are computed for friction of constant direction and belt speed only, and here"
            f" friction_direction = {p.friction_direction}, friction_speed = {p.friction_speed}"
        )
    if not (p.damping_x > 0.0 and p.damping_y > 0.0):
        raise ModelError(
            "cycles, zones and hits need damping: with"
            f" damping_x = {p.damping_x:g} and damping_y = {p.damping_y:g} N s/m nothing dies out"
        )


class Path:
    """The rig `p` with one field, or the mean arm stiffness at the ratio k1/k2 of `p` ("pad_stiffness"), as a variable.

    Raises:
        ParameterError: the field is unknown or not numeric.
    """

    def __init__(self, p: RigParameters, field: str) -> None:
        known = declarations(RigParameters)
        if field != PAD_STIFFNESS and (field not in known or known[field].kind is not float):
            numeric = ", ".join(name for name, declared in known.items() if declared.kind is float)
            raise ParameterError(f"{field!r} is no numeric field of a rig: those are {numeric}, and pad_stiffness")
        self.p, self.field = p, field
        self._shares = {field: 1.0}
        if field == PAD_STIFFNESS:
            mean = 0.5 * (p.k1 + p.k2)
            self._shares = {"k1": p.k1 / mean, "k2": p.k2 / mean} if mean > 0.0 else {"k1": 1.0, "k2": 1.0}
        self.value = 0.5 * (p.k1 + p.k2) if field == PAD_STIFFNESS else float(getattr(p, field))
        self.lower = max(known[name].lower / share for name, share in self._shares.items() if share > 0.0)
        self.upper = min(known[name].upper / share for name, share in self._shares.items() if share > 0.0)
        self._narrow_to_friction()
        self._linear = field not in _CURVED
        self._q, self._dq = pack(p), self._derivative(self.value)

    def _values(self, value: complex) -> dict[str, Any]:
        return {**vars(self.p), **{name: value * share for name, share in self._shares.items()}}

    def _derivative(self, value: float) -> Vector:
        dq = np.zeros(PACKED_SIZE)
        for column, part in packed_columns(self._values(complex(value, _IMAGINARY))).items():
            dq[column] = np.imag(part) / _IMAGINARY
        return dq

    def _narrow_to_friction(self) -> None:
        """Keep to where mu >= 0, which is linear in each field that it depends on."""
        if self.field not in (*COEFFICIENTS, "preload", "belt_speed"):
            return

        def mu(value: float) -> float:
            v = self._values(value)
            return float(friction_law(v, v["belt_speed"], v["preload"]))

        slope = mu(self.value + 1.0) - mu(self.value)
        if slope != 0.0:
            zero = self.value - mu(self.value) / slope
            if slope > 0.0:
                self.lower = max(self.lower, zero)
            else:
                self.upper = min(self.upper, zero)

    def packed(self, value: float) -> Vector:
        """Packed parameters (28,) at a value of the field."""
        if self._linear:
            return self._q + (value - self.value) * self._dq
        return pack(self._values(value))

    def derivative(self, value: float) -> Vector:
        """Their derivative (28,) by the field."""
        return self._dq if self._linear else self._derivative(value)

    def rig(self, value: float) -> RigParameters:
        """The rig at a value of the field."""
        return self.p.replace(**{name: value * share for name, share in self._shares.items()})

    def bounds(self, given: tuple[float, float] | None) -> tuple[float, float]:
        """The bounds asked for, within those of the field.

        Raises:
            ParameterError: they are not two numbers with the rig's own value between them.
        """
        if given is None:
            return self.lower, self.upper
        low, high = (float(bound) for bound in given)
        if not (math.isfinite(low) and math.isfinite(high) and low <= self.value <= high):
            raise ParameterError(
                f"bounds = ({low:g}, {high:g}) of {self.field} must be two numbers with {self.value:g} between them"
            )
        return max(low, self.lower), min(high, self.upper)
