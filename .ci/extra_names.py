"""Prints the names of the package's extras: `--users` those that a user installs, `--developers` all others."""

import runpy
import sys
from pathlib import Path
from typing import Any

import setuptools

ROOT = Path(__file__).resolve().parents[1]
_DEVELOPERS = ("bench", "colcon", "dist", "docs", "lint", "test")


def main(which: str) -> None:
    """Print one name a line."""
    found: dict[str, Any] = {}
    setuptools.setup = found.update
    runpy.run_path(str(ROOT / "setup.py"))
    names = [name for name in found["extras_require"] if (name in _DEVELOPERS) == (which == "--developers")]
    sys.stdout.write("\n".join(names) + "\n")


if __name__ == "__main__":
    main(sys.argv[1])
