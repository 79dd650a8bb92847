"""YAML texts as rosbag2 exchanges them: read by YAML 1.2 rules, written so that yaml-cpp reads the same."""

from __future__ import annotations

import io
from typing import Any

from ruamel.yaml import YAML

from squeal_rig.errors import RecordingError


def load_yaml(text: str) -> Any:
    """Return what a YAML text holds; RecordingError, one sentence, where it is no YAML."""
    try:
        return YAML(typ="safe", pure=True).load(io.StringIO(text))
    except Exception as error:  # on damaged text ruamel raises YAMLError, ValueError, KeyError, ...
        raise RecordingError(f"not YAML: {' '.join(str(error).split())}") from None


def dump_yaml(value: Any) -> str:
    """Return a value as YAML in block style, keys in the given order."""
    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = False
    yaml.sort_base_mapping_type_on_output = False  # type: ignore[assignment]  # keep rosbag2's key order
    yaml.width = 2**20  # one line a value: yaml-cpp and ruamel fold long lines differently
    stream = io.StringIO()
    yaml.dump(value, stream)
    return stream.getvalue()
