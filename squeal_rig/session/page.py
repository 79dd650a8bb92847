"""The page of a rig that runs already: the node `page` in this process."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from squeal_rig.configuration.files import yaml_scalar
from squeal_rig.nodes.page import main
from squeal_rig.session.run import keep_to_this_machine


def run_page(config: Path, settings: Mapping[str, str | bool | int]) -> int:
    """Serve the page until Ctrl-C, with the node's parameters of a file and settings on top; returns the exit code."""
    keep_to_this_machine()
    given = [word for name, value in settings.items() for word in ("-p", f"{name}:={yaml_scalar(value)}")]
    return main(["--ros-args", "--params-file", str(config), *given])
