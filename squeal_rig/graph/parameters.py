"""Declared dataclasses as ROS parameters: descriptors, refusal in a sentence, integers where floats are meant."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    ParameterType,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter

from squeal_rig.configuration.declared import Declaration, Declared, checked, declarations, unknown_name
from squeal_rig.errors import ParameterError

_TYPES = {
    float: ParameterType.PARAMETER_DOUBLE,
    int: ParameterType.PARAMETER_INTEGER,
    bool: ParameterType.PARAMETER_BOOL,
    str: ParameterType.PARAMETER_STRING,
    tuple: ParameterType.PARAMETER_STRING_ARRAY,
}
# Parameters that rclpy declares or reads itself.
_RCLPY_NAMES = ("use_sim_time", "start_type_description_service")
_RCLPY_PREFIXES = ("qos_overrides.",)

Refusal = Callable[[str, Declared, Declared], str | None]

#: Keyword arguments of a node whose parameters are a `DeclaredParameters`.
NODE_OPTIONS: dict[str, Any] = {
    "automatically_declare_parameters_from_overrides": True,  # how we see the overrides that nobody declared
    "allow_undeclared_parameters": True,  # only to refuse them by name
}


def overrides(node: Node) -> dict[str, Any]:
    """Name -> value of the parameters given at start (files and arguments), rclpy's own left out."""
    given = node.get_parameters_by_prefix("")
    return {name: parameter.value for name, parameter in given.items() if not _is_rclpys(name)}


class DeclaredParameters:
    """The parameters of a node: one or more declared dataclasses, each kept whole and valid at all times.

    Args:
        node: made with `NODE_OPTIONS`.
        defaults: one instance of each dataclass; what is given at start is laid over it.
        refuse: called with (name, instance now, instance wanted) for every change; a sentence refuses it.
        apply: called once a change was accepted, when it is in force in the groups.

    Raises:
        ParameterError: what was given at start is unknown, of the wrong type or out of bounds.
    """

    def __init__(
        self,
        node: Node,
        defaults: Sequence[Declared],
        refuse: Refusal | None = None,
        apply: Callable[[], None] | None = None,
    ) -> None:
        self._refuse = refuse
        self._apply = apply
        self._declarations: dict[str, Declaration] = {}
        for group in defaults:
            self._declarations |= declarations(type(group))
        given = overrides(node)
        try:
            for name in given:
                if name not in self._declarations:
                    raise unknown_name(name, self._declarations)
            self._groups = {type(group): self._merged(group, given) for group in defaults}
        except ParameterError as error:
            raise ParameterError(f"{node.get_name()}: {error}") from None
        for group in self._groups.values():
            for name, value in group.as_mapping().items():
                if node.has_parameter(name):
                    node.undeclare_parameter(name)
                node.declare_parameter(name, _as_ros(value), descriptor(self._declarations[name]), ignore_override=True)
        node.add_pre_set_parameters_callback(self._integers_as_floats)
        node.add_on_set_parameters_callback(self._judge)
        node.add_post_set_parameters_callback(self._take)

    def group(self, kind: type[Any]) -> Any:
        """The instance of one of the dataclasses, as it is now."""
        return self._groups[kind]

    def _merged(self, group: Declared, values: dict[str, Any]) -> Declared:
        own = {name: value for name, value in values.items() if name in declarations(type(group))}
        return type(group).from_mapping(own, group) if own else group

    def _integers_as_floats(self, changes: list[Parameter]) -> list[Parameter]:
        return [self._as_declared(change) for change in changes]

    def _as_declared(self, change: Parameter) -> Parameter:
        declaration = self._declarations.get(change.name)
        if declaration is not None and declaration.kind is float and change.type_ == Parameter.Type.INTEGER:
            return Parameter(change.name, Parameter.Type.DOUBLE, float(change.value))
        return change

    def _judge(self, changes: list[Parameter]) -> SetParametersResult:
        """Accept or refuse, change nothing: the change is applied after rclpy has accepted it."""
        values = {change.name: change.value for change in changes if not _is_rclpys(change.name)}
        try:
            for name, value in values.items():
                if name not in self._declarations:
                    raise unknown_name(name, self._declarations)
                checked(self._declarations[name], value)
            for kind, group in self._groups.items():
                wanted = self._merged(group, values)
                for name in values.keys() & declarations(kind).keys():
                    sentence = self._refuse(name, group, wanted) if self._refuse else None
                    if sentence:
                        raise ParameterError(sentence)
        except ParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _take(self, changes: list[Parameter]) -> None:
        values = {change.name: change.value for change in changes if change.name in self._declarations}
        if not values:
            return
        self._groups = {kind: self._merged(group, values) for kind, group in self._groups.items()}
        if self._apply is not None:
            self._apply()


def descriptor(declaration: Declaration) -> ParameterDescriptor:
    """ROS parameter descriptor of a declaration: type, range, unit and options in the description."""
    details = [declaration.description]
    if declaration.unit:
        details.append(f"[{declaration.unit}]")
    if declaration.options:
        details.append("one of: " + ", ".join(declaration.options))
    if declaration.assumed:
        details.append("(assumed: not published)")
    result = ParameterDescriptor(
        name=declaration.name,
        type=_TYPES[declaration.kind],
        description=" ".join(details),
        read_only=declaration.read_only,
    )
    if math.isfinite(declaration.lower) and math.isfinite(declaration.upper):
        low, high = declaration.lower, declaration.upper
        if declaration.kind is float:
            result.floating_point_range = [FloatingPointRange(from_value=low, to_value=high, step=0.0)]
        elif declaration.kind is int:
            result.integer_range = [IntegerRange(from_value=int(low), to_value=int(high), step=1)]
    return result


def _as_ros(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


def _is_rclpys(name: str) -> bool:
    return name in _RCLPY_NAMES or name.startswith(_RCLPY_PREFIXES)
