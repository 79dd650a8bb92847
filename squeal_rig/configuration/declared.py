"""Parameters declared once: default, unit, bounds, concern and description sit on the dataclass field.

YAML checking, ROS parameter descriptors, messages to the operator and the table in the docs all read them here.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
import numbers
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, TypeVar

from squeal_rig.errors import ParameterError

D = TypeVar("D", bound="Declared")
_METADATA_KEY = "declaration"


@dataclass(frozen=True)
class Declaration:
    """What is known of one parameter. Bounds are inclusive, in `unit`; a tuple is a list of texts.

    An integer is a multiple of `multiple`, where that is not 0.
    """

    default: float | int | bool | str | tuple[str, ...]
    description: str
    unit: str = ""
    lower: float = -math.inf
    upper: float = math.inf
    options: tuple[str, ...] = ()
    concern: str = ""
    assumed: bool = False
    read_only: bool = False
    multiple: int = 0
    name: str = ""

    @property
    def kind(self) -> type:
        """Type of the parameter, taken from its default."""
        return type(self.default)

    @property
    def bounds(self) -> str:
        """The bounds in words, for a sentence."""
        unit = f" {self.unit}" if self.unit else ""
        if self.lower == -math.inf and self.upper == math.inf:
            return "any finite number" + (f" in{unit}" if unit else "")
        if self.upper == math.inf:
            return f"{self.lower:g}{unit} or more"
        return f"{self.lower:g} to {self.upper:g}{unit}"


def quantity(default: float | int | bool | str | tuple[str, ...], description: str, **details: Any) -> Any:
    """A dataclass field that carries its `Declaration`; `details` are the declaration's other attributes."""
    declaration = Declaration(default, description, **details)
    return dataclasses.field(default=default, metadata={_METADATA_KEY: declaration})


_known: dict[type[Any], dict[str, Declaration]] = {}


def declarations(declared: type[Any]) -> dict[str, Declaration]:
    """Name -> declaration of every field of a declared dataclass, in order."""
    if declared not in _known:
        _known[declared] = {
            field.name: dataclasses.replace(field.metadata[_METADATA_KEY], name=field.name)
            for field in fields(declared)
        }
    return _known[declared]


def checked(declaration: Declaration, value: object) -> Any:
    """The value in the declared type (an integer becomes a float where a float is meant).

    Raises:
        ParameterError: wrong type, not finite, out of bounds, or not one of the options.
    """
    name, kind = declaration.name, declaration.kind
    unit = f" {declaration.unit}" if declaration.unit else ""
    if kind is bool:
        if not isinstance(value, bool):
            raise ParameterError(f"{name} = {value!r} is not a truth value: write true or false")
        return value
    if kind is tuple:
        if not isinstance(value, list | tuple) or not all(isinstance(item, str) for item in value):
            raise ParameterError(f"{name} = {value!r} is not a list of texts")
        return tuple(value)
    if kind is str:
        if not isinstance(value, str):
            raise ParameterError(f"{name} = {value!r} is not a text" + _choice(declaration))
        if declaration.options and value not in declaration.options:
            raise ParameterError(f"{name} = {value!r} is not known" + _choice(declaration))
        return value
    expected = numbers.Integral if kind is int else numbers.Real
    if isinstance(value, bool) or not isinstance(value, expected):
        what = "an integer" if kind is int else "a number"
        raise ParameterError(f"{name} = {value!r} is not {what}: it must be {declaration.bounds}")
    try:
        number = kind(value)
        finite = math.isfinite(number)  # of an integer, whether a float can hold it
    except OverflowError:
        raise ParameterError(f"{name} = {value} is out of bounds: it must be {declaration.bounds}") from None
    if not finite:
        raise ParameterError(f"{name} = {number}{unit} is not finite: it must be {declaration.bounds}")
    if not declaration.lower <= number <= declaration.upper:
        raise ParameterError(f"{name} = {number:.15g}{unit} is out of bounds: it must be {declaration.bounds}")
    if declaration.multiple and number % declaration.multiple:
        raise ParameterError(f"{name} = {number}{unit} must be a multiple of {declaration.multiple}{unit}")
    return number


def _choice(declaration: Declaration) -> str:
    return f": it must be one of {', '.join(declaration.options)}" if declaration.options else ""


def unknown_name(name: str, known: Mapping[str, object]) -> ParameterError:
    """The error for a parameter nobody declared, with the nearest known name."""
    near = difflib.get_close_matches(name, known, n=1)
    return ParameterError(f"unknown parameter {name!r}" + (f": did you mean {near[0]!r}?" if near else ""))


class Declared:
    """Base of frozen dataclasses whose fields are made by `quantity`: every value is checked on construction."""

    def __post_init__(self) -> None:
        for name, declaration in declarations(type(self)).items():
            object.__setattr__(self, name, checked(declaration, getattr(self, name)))

    @classmethod
    def from_mapping(cls: type[D], values: Mapping[str, object], base: D | None = None) -> D:
        """An instance from names and values, on top of `base` (defaults when None); unknown names are refused."""
        known = declarations(cls)
        for name in values:
            if name not in known:
                raise unknown_name(str(name), known)
        return cls(**{**(base.as_mapping() if base is not None else {}), **values})

    def as_mapping(self) -> dict[str, Any]:
        """Name -> value of every field, in order."""
        return {name: getattr(self, name) for name in declarations(type(self))}
