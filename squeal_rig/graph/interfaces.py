"""Message classes by name, and QoS between rclpy and bags."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from typing import Any

from rclpy.duration import Duration
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)
from rclpy.topic_endpoint_info import TopicEndpointInfo

from squeal_rig.errors import RecordingError
from squeal_rig.recording import INFINITE_NS, QosProfile, installed_schema

# History and depth cannot be seen over DDS: taken as KEEP_LAST with this depth, above one second of any of our topics.
_UNSEEN_DEPTH = 200
#: What the recorder itself asks for: it must not lose a message while a disk is slow.
RECORDING_DEPTH = 1000


def message_class(type_name: str) -> Any:
    """The Python class of a message type such as `std_msgs/msg/String`.

    The name comes out of a bag or the graph: only a package that installs a definition of the type is imported.

    Raises:
        RecordingError: no such interface package is installed, or this is no name of a message type.
    """
    package, _, name = installed_schema(type_name).type_name.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError):
        raise RecordingError(f"the message type {type_name} is not installed here") from None


def offered_qos(endpoint: TopicEndpointInfo) -> QosProfile:
    """What a publisher of the graph offers, as a bag keeps it."""
    profile = endpoint.qos_profile
    return QosProfile(
        history="keep_last",
        depth=_UNSEEN_DEPTH,
        reliability=profile.reliability.name.lower(),
        durability=profile.durability.name.lower(),
        deadline_ns=_nanoseconds(profile.deadline),
        lifespan_ns=_nanoseconds(profile.lifespan),
        liveliness=profile.liveliness.name.lower(),
        liveliness_lease_ns=_nanoseconds(profile.liveliness_lease_duration),
    )


def requested_qos(offered: Sequence[QosProfile]) -> QoSProfile:
    """A subscriber's request that every one of these publishers meets."""
    reliable = all(profile.reliability == "reliable" for profile in offered)
    latched = all(profile.durability == "transient_local" for profile in offered)
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=RECORDING_DEPTH,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def replayed_qos(offered: Sequence[QosProfile]) -> QoSProfile:
    """The publisher's profile that a recorded one becomes on replay: the first of several."""
    profile = offered[0] if offered else QosProfile()
    result = QoSProfile(
        history=HistoryPolicy.KEEP_ALL if profile.history == "keep_all" else HistoryPolicy.KEEP_LAST,
        depth=max(1, profile.depth),
        reliability=ReliabilityPolicy.BEST_EFFORT
        if profile.reliability == "best_effort"
        else ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL
        if profile.durability == "transient_local"
        else DurabilityPolicy.VOLATILE,
        liveliness=LivelinessPolicy.AUTOMATIC,
    )
    for name, value in (("deadline", profile.deadline_ns), ("lifespan", profile.lifespan_ns)):
        if 0 < value < INFINITE_NS:
            setattr(result, name, Duration(nanoseconds=value))
    return result


def _nanoseconds(duration: Duration) -> int:
    value = int(duration.nanoseconds)
    return INFINITE_NS if value <= 0 or value >= INFINITE_NS else value
