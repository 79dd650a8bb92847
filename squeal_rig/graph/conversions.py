"""All mapping between our objects and ROS messages."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import JointState

from squeal_rig.recording import cdr_from_samples
from squeal_rig.recording.cdr import text_of

FRAME = "rig"
_NS = 10**9

OK, WARN, ERROR, STALE = (
    DiagnosticStatus.OK,
    DiagnosticStatus.WARN,
    DiagnosticStatus.ERROR,
    DiagnosticStatus.STALE,
)


def time_message(nanoseconds: int) -> Time:
    """A time in ns since the epoch as a message."""
    return Time(sec=nanoseconds // _NS, nanosec=nanoseconds % _NS)


def cloud(samples: np.ndarray, stamp: int) -> bytes:
    """A structured array (n,) as a serialised PointCloud2, one point a sample; stamp in ns.

    Publishers take the bytes as they are; a message object, with its fields, would cost ten times as much.
    """
    return cdr_from_samples(samples, stamp, FRAME)


def joint_state(stamp: int, position: Sequence[float], velocity: Sequence[float]) -> JointState:
    """Mean position [m] and velocity [m/s] of the pad as joints pad_x, pad_y."""
    message = JointState(name=["pad_x", "pad_y"], position=list(position), velocity=list(velocity))
    message.header.stamp, message.header.frame_id = time_message(stamp), FRAME
    return message


def wrench(stamp: int, tangential: float, normal: float) -> WrenchStamped:
    """Mean contact force on the pad [N]."""
    message = WrenchStamped()
    message.header.stamp, message.header.frame_id = time_message(stamp), FRAME
    message.wrench.force.x, message.wrench.force.y = tangential, normal
    return message


def status(level: bytes, name: str, message: str, values: Mapping[str, Any], hardware_id: str = "") -> DiagnosticStatus:
    """One diagnostic status; floats are written so that they read back bit for bit, nan as `none`."""
    return DiagnosticStatus(
        level=level,
        name=name,
        message=message,
        hardware_id=hardware_id,
        values=[KeyValue(key=key, value=text_of(value)) for key, value in values.items()],
    )


def diagnostics(stamp: int, *statuses: DiagnosticStatus) -> DiagnosticArray:
    """Statuses of one moment [ns]."""
    message = DiagnosticArray(status=list(statuses))
    message.header.stamp, message.header.frame_id = time_message(stamp), FRAME
    return message


def status_values(message: DiagnosticStatus) -> dict[str, str]:
    """Key -> value of a status."""
    return {pair.key: pair.value for pair in message.values}


def whole_number(text: str) -> int:
    """A count out of a status; 0 where the text is none."""
    return int(text) if text.isdecimal() and len(text) < 20 else 0


def status_number(message: DiagnosticStatus, key: str) -> float:
    """A number out of a status; nan where it says `none` or has no such key."""
    text = status_values(message).get(key, "none")
    try:
        return float(text)
    except ValueError:
        return math.nan
