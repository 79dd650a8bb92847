"""Declared dataclasses as ROS parameters: descriptors, refusal in a sentence, integers where floats are meant."""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Callable, Sequence, Sized
from itertools import pairwise
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

from squeal_rig.configuration.declared import Declaration, Declared, checked, declarations
from squeal_rig.configuration.files import load_yaml
from squeal_rig.configuration.node_files import RCLPY_NAMES, node_of, parameter_blocks, unknown_parameter
from squeal_rig.errors import ParameterError
from squeal_rig.model.parameters import RUN_TIME_CONCERNS

_TYPES = {
    float: ParameterType.PARAMETER_DOUBLE,
    int: ParameterType.PARAMETER_INTEGER,
    bool: ParameterType.PARAMETER_BOOL,
    str: ParameterType.PARAMETER_STRING,
    tuple: ParameterType.PARAMETER_STRING_ARRAY,
}
# The longest number that a text can be, and no text that would take long to read as one.
_INTEGER = re.compile(r"[-+]?[0-9]{1,18}")
_NUMBER = re.compile(r"[-+]?([0-9]{1,300}(\.[0-9]{0,300})?|\.[0-9]{1,300})([eE][-+]?[0-9]{1,3})?")

Refusal = Callable[[str, Declared, Declared], str | None]

#: Keyword arguments of a node whose parameters are a `DeclaredParameters`.
NODE_OPTIONS: dict[str, Any] = {"allow_undeclared_parameters": True}  # only to refuse them by name


def overrides(node: Node) -> dict[str, Any]:
    """Name -> value of the parameters given at start (files and arguments), rclpy's own left out.

    rclpy's public way, to have them all declared, ends the node on an empty list: such an override has no type.
    """
    given = node._parameter_overrides
    return {name: parameter.value for name, parameter in given.items() if name not in RCLPY_NAMES}


def passed_over(node_name: str, arguments: Sequence[str]) -> set[str]:
    """Names of parameters that came from a block for every node (`/**`) and from nowhere else.

    Such a block is no mistake where a node does not have one of them; what was given to this node itself is.

    Raises:
        ConfigurationError: a parameter file cannot be read.
    """
    for_all, own = set[str](), set[str]()
    for option, value in pairwise(arguments):
        if option in ("-p", "--param"):
            own.add(value.split(":=")[0].split(":")[-1])
        elif option == "--params-file":
            for key, values in parameter_blocks(load_yaml(value)):
                if not node_of(key):
                    for_all |= values.keys()
                elif node_of(key) == node_name:
                    own |= values.keys()
    return for_all - own


def meant(declaration: Declaration, value: Any) -> Any:
    """The value in the declared type where it can only be meant so: integers and numeric text for numbers.

    ros2cli reads by YAML 1.1, where 6e7 and 1e-05 are texts, and gives an empty list another type or none.
    """
    kind = declaration.kind
    if kind is tuple and (
        value is None or (not isinstance(value, str) and isinstance(value, Sized) and not len(value))
    ):
        return ()
    if kind in (int, float) and isinstance(value, str) and (_INTEGER if kind is int else _NUMBER).fullmatch(value):
        return kind(value)
    return float(value) if kind is float and type(value) is int else value


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
            unknown = given.keys() - self._declarations.keys()
            foreign = unknown & passed_over(node.get_name(), sys.argv) if unknown else set()
            for name in sorted(unknown - foreign):
                raise unknown_parameter(name, self._declarations)
            if foreign:
                node.get_logger().warning(f"not a parameter of this node, passed over: {', '.join(sorted(foreign))}")
            self._groups = {type(group): self._merged(group, given) for group in defaults}
        except ParameterError as error:
            raise ParameterError(f"{node.get_name()}: {error}") from None
        for group in self._groups.values():
            for name, value in group.as_mapping().items():
                node.declare_parameter(name, _as_ros(value), descriptor(self._declarations[name]), ignore_override=True)
        node.add_pre_set_parameters_callback(self._as_declared)
        node.add_on_set_parameters_callback(self._judge)
        node.add_post_set_parameters_callback(self._take)

    def group(self, kind: type[Any]) -> Any:
        """The instance of one of the dataclasses, as it is now."""
        return self._groups[kind]

    def _merged(self, group: Declared, values: dict[str, Any]) -> Declared:
        known = declarations(type(group))
        own = {name: meant(known[name], value) for name, value in values.items() if name in known}
        return type(group).from_mapping(own, group) if own else group

    def _as_declared(self, changes: list[Parameter]) -> list[Parameter]:
        """What can only be meant so in the declared type, before rclpy looks at types; the rest as it is."""

        def declared(change: Parameter) -> Parameter:
            declaration = self._declarations.get(change.name)
            value = change.value if declaration is None else meant(declaration, change.value)
            if declaration is None or type(value) is not declaration.kind:
                return change
            return Parameter(change.name, Parameter.Type(_TYPES[declaration.kind]), _as_ros(value))

        return [declared(change) for change in changes]

    def _judge(self, changes: list[Parameter]) -> SetParametersResult:
        """Accept or refuse, change nothing: the change is applied after rclpy has accepted it."""
        values = {change.name: change.value for change in changes if change.name not in RCLPY_NAMES}
        try:
            for name, value in values.items():
                if name not in self._declarations:
                    raise unknown_parameter(name, self._declarations)
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
    """ROS parameter descriptor of a declaration: type and range, the unit in the description, all else in words."""
    details = [declaration.description]
    if declaration.unit:
        details.append(f"[{declaration.unit}]")
    if declaration.assumed:
        details.append("(assumed: not published)")
    constraints = []
    if declaration.options:
        constraints.append("one of: " + ", ".join(declaration.options))
    if math.isfinite(declaration.lower):
        constraints.append(declaration.bounds)
    if declaration.multiple:
        constraints.append(f"a multiple of {declaration.multiple}")
    if declaration.concern and declaration.concern not in RUN_TIME_CONCERNS:
        constraints.append("changes only while the rig is inactive")
    result = ParameterDescriptor(
        name=declaration.name,
        type=_TYPES[declaration.kind],
        description=" ".join(details),
        additional_constraints="; ".join(constraints),
        read_only=declaration.read_only,
    )
    if math.isfinite(declaration.lower) and math.isfinite(declaration.upper):
        low, high = declaration.lower, declaration.upper
        if declaration.kind is float:
            result.floating_point_range = [FloatingPointRange(from_value=low, to_value=high, step=0.0)]
        elif declaration.kind is int:
            result.integer_range = [
                IntegerRange(from_value=int(low), to_value=int(high), step=declaration.multiple or 1)
            ]
    return result


def _as_ros(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value
