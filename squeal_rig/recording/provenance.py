"""What a run was: versions, host facts, start time, parameters. All texts, for a bag's custom_data."""

from __future__ import annotations

import os
import platform
from datetime import datetime, timezone
from importlib.metadata import PackageNotFoundError, version

from squeal_rig import __version__

_LIBRARIES = ("numpy", "scipy", "numba", "mcap", "zstandard", "rclpy")


def provenance() -> dict[str, str]:
    """Return the facts of a run that starts now. Host names and paths are not taken.

    Keys: squeal_rig, python, os, machine, cpu_count, started_utc (ISO 8601), and one per library found
    (`library.<name>`).
    """
    facts = {
        "squeal_rig": __version__,
        "python": f"{platform.python_implementation()} {platform.python_version()}",
        "os": _operating_system(),
        "machine": platform.machine(),
        "cpu_count": str(os.cpu_count() or 0),
        "started_utc": datetime.now(timezone.utc).isoformat(timespec="milliseconds"),
    }
    for name in _LIBRARIES:
        try:
            facts[f"library.{name}"] = version(name)
        except PackageNotFoundError:
            continue
    return facts


def _operating_system() -> str:
    """Return the distribution's name and version where the system tells it."""
    try:
        return platform.freedesktop_os_release()["PRETTY_NAME"]
    except (OSError, KeyError):
        return platform.system()
