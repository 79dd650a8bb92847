"""Prints each lower bound of setup.py as a pin, for pip's --constraint: the oldest set that is said to work."""

import re
import runpy
import sys
from pathlib import Path
from typing import Any

import setuptools

ROOT = Path(__file__).resolve().parents[1]
_WITH = ("click==8.1.6",)  # typer's own dependency, as Ubuntu 24.04 has it: typer 0.9 does not know later ones
_EXTRAS = ("jazzy", "test", "export")  # the others are tools and peers, no part of what a user installs


def pins(metadata: dict[str, Any]) -> list[str]:
    """`name==bound` for every requirement of the package and of its extras."""
    extras = metadata["extras_require"]
    asked = [*metadata["install_requires"], *(name for extra in _EXTRAS for name in extras[extra])]
    bounds = dict(re.match(r"([\w.-]+)>=([\w.]+)", name).groups() for name in asked)  # type: ignore[union-attr,misc]
    return [*(f"{name}=={bound}" for name, bound in sorted(bounds.items())), *_WITH]


if __name__ == "__main__":
    found: dict[str, Any] = {}
    setuptools.setup = found.update
    runpy.run_path(str(ROOT / "setup.py"))
    sys.stdout.write("\n".join(pins(found)) + "\n")
