"""Quality of service of a recorded topic, in the YAML form rosbag2 writes and reads.

rosbag2 Jazzy names the policies (`history: keep_last`), older bags number them: both are read, names written.
Durations are integer nanoseconds; `INFINITE_NS` is what ROS 2 calls an infinite duration.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from squeal_rig.configuration.files import dump_yaml, parse_yaml_texts
from squeal_rig.errors import ConfigurationError, RecordingError

INFINITE_NS = 2**63 - 1

# Position in each tuple = the number the same policy has in rmw/types.h (metadata version 8 and older).
POLICIES: dict[str, tuple[str, ...]] = {
    "history": ("system_default", "keep_last", "keep_all", "unknown"),
    "reliability": ("system_default", "reliable", "best_effort", "unknown", "best_available"),
    "durability": ("system_default", "transient_local", "volatile", "unknown", "best_available"),
    "liveliness": (
        "system_default",
        "automatic",
        "manual_by_node",
        "manual_by_topic",
        "unknown",
        "best_available",
    ),
}
# (sec, nsec) of Fast DDS and Connext in bags recorded with Foxy (rosbag2_storage/qos.cpp).
_OLD_INFINITIES = ((0x7FFFFFFF, 0xFFFFFFFF), (0x7FFFFFFF, 0x7FFFFFFF))
_MAX_DEPTH = 2**31 - 1  # rosbag2 reads the depth as a C int


@dataclass(frozen=True)
class QosProfile:
    """What one publisher offers. Policies carry their rmw names in lower case; durations are in [ns]."""

    history: str = "keep_last"
    depth: int = 10
    reliability: str = "reliable"
    durability: str = "volatile"
    deadline_ns: int = INFINITE_NS
    lifespan_ns: int = INFINITE_NS
    liveliness: str = "automatic"
    liveliness_lease_ns: int = INFINITE_NS
    avoid_ros_namespace_conventions: bool = False

    def __post_init__(self) -> None:
        for policy, names in POLICIES.items():
            value = getattr(self, policy)
            if value not in names:
                raise RecordingError(f"QoS {policy} is {value!r}; it must be one of {', '.join(names)}.")
        if not 0 <= self.depth <= _MAX_DEPTH:
            raise RecordingError(f"QoS depth is {self.depth}; it must lie in 0..{_MAX_DEPTH} messages.")
        for duration in ("deadline_ns", "lifespan_ns", "liveliness_lease_ns"):
            value = getattr(self, duration)
            if not 0 <= value <= INFINITE_NS:
                raise RecordingError(f"QoS {duration} is {value} ns; it must lie in 0..{INFINITE_NS} ns.")


def qos_to_mapping(qos: QosProfile) -> dict[str, Any]:
    """Return the profile as rosbag2's mapping, keys in rosbag2's order."""
    return {
        "history": qos.history,
        "depth": qos.depth,
        "reliability": qos.reliability,
        "durability": qos.durability,
        "deadline": _duration_to_mapping(qos.deadline_ns),
        "lifespan": _duration_to_mapping(qos.lifespan_ns),
        "liveliness": qos.liveliness,
        "liveliness_lease_duration": _duration_to_mapping(qos.liveliness_lease_ns),
        "avoid_ros_namespace_conventions": qos.avoid_ros_namespace_conventions,
    }


def qos_from_mapping(mapping: Mapping[str, Any]) -> QosProfile:
    """Return the profile of one rosbag2 mapping; RecordingError where a key is missing or of a wrong type."""
    try:
        return QosProfile(
            history=_policy_name("history", mapping["history"]),
            depth=int(mapping["depth"]),
            reliability=_policy_name("reliability", mapping["reliability"]),
            durability=_policy_name("durability", mapping["durability"]),
            deadline_ns=_duration_from_mapping(mapping["deadline"]),
            lifespan_ns=_duration_from_mapping(mapping["lifespan"]),
            liveliness=_policy_name("liveliness", mapping["liveliness"]),
            liveliness_lease_ns=_duration_from_mapping(mapping["liveliness_lease_duration"]),
            avoid_ros_namespace_conventions=str(mapping["avoid_ros_namespace_conventions"]).lower() == "true",
        )
    except KeyError as error:
        raise RecordingError(f"A QoS profile lacks the key {error}.") from None
    except (TypeError, ValueError) as error:
        raise RecordingError(f"A QoS profile cannot be read: {error}.") from None


def qos_to_yaml(profiles: Sequence[QosProfile]) -> str:
    """Return the text of the channel metadata `offered_qos_profiles`, as yaml-cpp would dump it."""
    return _qos_text(tuple(profiles))


@lru_cache(maxsize=256)  # a bag's topics have a handful of profiles
def _qos_text(profiles: tuple[QosProfile, ...]) -> str:
    return dump_yaml([qos_to_mapping(profile) for profile in profiles]).rstrip("\n")


@lru_cache(maxsize=256)
def qos_from_yaml(text: str) -> tuple[QosProfile, ...]:
    """Return the profiles of an `offered_qos_profiles` text; an empty text is an empty tuple."""
    try:
        return qos_from_list(parse_yaml_texts(text, "the offered QoS profiles"))
    except ConfigurationError as error:
        raise RecordingError(f"{error}.") from None


def qos_from_list(loaded: object) -> tuple[QosProfile, ...]:
    """Return the profiles of a loaded YAML list, whose values are texts; nothing is an empty list."""
    if not loaded:
        return ()
    if not isinstance(loaded, list) or not all(isinstance(item, Mapping) for item in loaded):
        raise RecordingError("The offered QoS profiles are not a list of mappings.")
    return tuple(qos_from_mapping(item) for item in loaded)


def _policy_name(policy: str, value: object) -> str:
    """Return the name of a policy given by name or by the number older bags hold."""
    names = POLICIES[policy]
    if not isinstance(value, str):
        raise RecordingError(f"QoS {policy} is {value!r}; it must be one of {', '.join(names)}.")
    if not value.isdecimal():
        return value
    if int(value) < len(names):
        return names[int(value)]
    raise RecordingError(f"QoS {policy} is {value}; it must lie in 0..{len(names) - 1}.")


def _duration_to_mapping(nanoseconds: int) -> dict[str, int]:
    seconds, rest = divmod(nanoseconds, 1_000_000_000)
    return {"sec": seconds, "nsec": rest}


def _duration_from_mapping(mapping: Mapping[str, Any]) -> int:
    """Return [ns]; INFINITE_NS for what older middlewares wrote as infinite."""
    seconds, rest = int(mapping["sec"]), int(mapping["nsec"])
    if (seconds, rest) in _OLD_INFINITIES:
        return INFINITE_NS
    return min(seconds * 1_000_000_000 + rest, INFINITE_NS)
