"""Where our YAML files are, and how any YAML is read: by the rules of YAML 1.2."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from squeal_rig.errors import ConfigurationError


def config_directory() -> Path:
    """Folder with `presets/` and `rig.yaml`: beside the package, else the nearest parent's share folder.

    One rule for every way of installing (pip, editable, --target, colcon with and without symlinks).
    """
    package = Path(__file__).resolve().parents[1]
    beside = package.parent / "config"
    if (beside / "presets" / "yavuz_sen_2023.yaml").is_file():
        return beside
    # The unresolved path as well: a colcon symlink-install resolves to the source tree.
    for start in (package, Path(__file__).absolute().parents[1]):
        for parent in start.parents:
            candidate = parent / "share" / "squeal_rig" / "config"
            if candidate.is_dir():
                return candidate
    raise ConfigurationError(f"no configuration found: neither {beside} nor share/squeal_rig/config above {package}")


def parse_yaml(text: str, source: str) -> Any:
    """Read YAML 1.2 text (`6e7` is a number, `on` is a string, a duplicate key is an error).

    Args:
        text: the YAML.
        source: what the text is, for the error's sentence.
    """
    try:
        return YAML(typ="safe", pure=True).load(text)
    except YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f", line {mark.line + 1}" if mark is not None else ""
        problem = getattr(error, "problem", None) or str(error).splitlines()[0]
        raise ConfigurationError(f"{source}{where}: not valid YAML: {problem}") from error
    except (ValueError, LookupError) as error:  # the reader's own slips: `2020-99-99`, `!!float x`
        raise ConfigurationError(f"{source}: not valid YAML: {error}") from error
    except RecursionError as error:
        raise ConfigurationError(f"{source}: not valid YAML: nested too deeply") from error


def load_yaml(path: Path | str) -> Any:
    """Read one YAML 1.2 file; a missing or unreadable file is a `ConfigurationError`."""
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not UTF-8 text"
        raise ConfigurationError(f"cannot read {path}: {reason}") from error
    return parse_yaml(text, str(path))


def yaml_scalar(value: float | int | bool | str) -> str:
    """One value as YAML text that YAML 1.1, YAML 1.2 and rcl readers all take for the same value."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        if not math.isfinite(value):
            raise ConfigurationError(f"{value} cannot be written to YAML: not finite")
        text = repr(value)
        mantissa, e, exponent = text.partition("e")
        return f"{mantissa}.0e{exponent}" if e and "." not in mantissa else text
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n") + '"'
    return str(value)


def yaml_mapping(values: Mapping[str, float | int | bool | str]) -> str:
    """A flat mapping as YAML text, one key a line, in the order given."""
    return "".join(f"{key}: {yaml_scalar(value)}\n" for key, value in values.items())
