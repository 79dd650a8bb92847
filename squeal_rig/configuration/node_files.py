"""Parameter files of ROS nodes: whom a block is for, and the names in it as rcl joins them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from squeal_rig.configuration.declared import unknown_name
from squeal_rig.errors import ParameterError

ROS_KEY = "ros__parameters"
#: Parameters that rclpy itself declares.
RCLPY_NAMES = ("use_sim_time", "start_type_description_service")
_QOS = "qos_overrides"


def parameter_blocks(content: object, key: str = "") -> Iterator[tuple[str, dict[str, Any]]]:
    """(key, name -> value) of every block in a parameter file; nested keys and names are joined."""
    if isinstance(content, Mapping):
        for name, body in content.items():
            if name == ROS_KEY:
                yield key, dict(_flat(body))
            else:
                yield from parameter_blocks(body, f"{key}/{name}" if key else str(name))


def node_of(key: str) -> str:
    """Name of the node that a block's key is for; empty where it is for every node, as `/**` is."""
    name = key.rstrip("/").split("/")[-1]
    return "" if name in ("*", "**") else name


def unknown_parameter(name: str, known: Mapping[str, object]) -> ParameterError:
    """The error for a parameter that a node does not have."""
    if name.split(".")[0] == _QOS:
        return ParameterError(f"{name}: the quality of service of every topic is fixed, there are no {_QOS}")
    return unknown_name(name, known)


def _flat(body: object, prefix: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(body, Mapping):
        for name, value in body.items():
            if isinstance(value, Mapping):
                yield from _flat(value, f"{prefix}{name}.")
            else:
                yield f"{prefix}{name}", value
