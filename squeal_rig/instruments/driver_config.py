"""A driver's own YAML file, which the rig's parameter `driver_config` names: whose it is, and its check."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from squeal_rig.configuration.declared import Declared, declarations
from squeal_rig.configuration.files import load_yaml
from squeal_rig.errors import ConfigurationError, ParameterError
from squeal_rig.instruments.driver import driver_class

D = TypeVar("D", bound=Declared)

#: Key of a driver's file that names the driver it is for.
DRIVER_KEY = "driver"


def load_driver_config(path: str, driver: str) -> dict[str, Any]:
    """What the file says, without its key `driver`; nothing where no file is named.

    Raises:
        ConfigurationError: it cannot be read, is no mapping or is for another driver.
    """
    if not path:
        return {}
    content = load_yaml(path)
    if not isinstance(content, dict) or not all(isinstance(key, str) for key in content):
        raise ConfigurationError(f"{path}: the settings of a driver are a mapping of names to values")
    named = content.pop(DRIVER_KEY, None)
    if named != driver:
        raise ConfigurationError(f"{path}: {DRIVER_KEY} = {named!r}, and it is read for the driver {driver!r}")
    return dict(content)


def declared_from(kind: type[D], path: str, values: object, where: str = "") -> D:
    """Settings of one kind out of a driver's file, with the place in the sentence where something is wrong with them.

    Raises:
        ConfigurationError, ParameterError: no mapping, a name that nobody declared, a value out of bounds.
    """
    place = f"{path}, {where}" if where else path
    if not isinstance(values, Mapping):
        raise ConfigurationError(f"{place}: expected a mapping of {', '.join(declarations(kind))}, got {values!r}")
    try:
        return kind.from_mapping(values)
    except ParameterError as error:
        raise ParameterError(f"{place}: {error}") from None


def check_driver_config(path: str, driver: str) -> None:
    """Check a driver's file by the driver itself: its class method `check_config(path)`, where it has one.

    A driver that has none has no settings, and its file says no more than whose it is.

    Raises:
        ConfigurationError, ParameterError, DriverError: what is wrong with it, in one sentence.
    """
    check = getattr(driver_class(driver), "check_config", None)
    if check is not None:
        check(path)
        return
    unknown = next(iter(load_driver_config(path, driver)), None)
    if unknown is not None:
        raise ConfigurationError(f"{path}: unknown key {unknown!r}: the driver {driver!r} has no settings of its own")
