"""The page of a rig that runs already: the node `page` in this process."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from squeal_rig.configuration.files import yaml_scalar
from squeal_rig.nodes.page import main
from squeal_rig.session.run import keep_to_this_machine


def run_page(config: Path, settings: Mapping[str, str | bool | int | Sequence[str]]) -> int:
    """Serve the page until Ctrl-C, with the node's parameters of a file and settings on top; returns the exit code."""
    keep_to_this_machine()
    given = [word for name, value in settings.items() for word in ("-p", f"{name}:={_yaml(value)}")]
    return main(["--ros-args", "--params-file", str(config), *given])


def _yaml(value: str | bool | int | Sequence[str]) -> str:
    if isinstance(value, str | bool | int):
        return yaml_scalar(value)
    return f"[{', '.join(map(yaml_scalar, value))}]"
