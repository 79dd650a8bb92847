"""Where our YAML files are, and how all YAML is read, by the rules of YAML 1.2, and written."""

from __future__ import annotations

import errno
import io
import math
import os
import stat
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml
from ruamel.yaml import YAML
from ruamel.yaml.composer import Composer, ComposerError
from ruamel.yaml.events import AliasEvent

from squeal_rig.errors import ConfigurationError

MAX_YAML = 1 << 16  # most that is read of a file or a text of ours: a second's work; our longest has a tenth of it
MAX_FOREIGN_YAML = 1 << 22  # of what rosbag2 writes: some 5000 topics
_NO_ALIASES = "aliases (*name) are not read"
_TEXTS: Any = getattr(yaml, "CBaseLoader", yaml.BaseLoader)


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


class _Composer(Composer):
    """Refuses aliases, as rcl does: a few lines of them stand for gigabytes."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.parser.check_event(AliasEvent):
            raise ComposerError(None, None, _NO_ALIASES, self.parser.peek_event().start_mark)
        return super().compose_node(parent, index)


def parse_yaml(text: str, source: str, limit: int = MAX_YAML) -> Any:
    """Read YAML 1.2 text (`6e7` is a number, `on` is a string; a duplicate key and an alias are errors).

    Args:
        text: the YAML, of `limit` characters at most.
        source: what the text is, for the error's sentence.

    Raises:
        ConfigurationError: it is too long or no YAML.
    """
    _check_length(text, source, limit)
    loader = YAML(typ="safe", pure=True)
    loader.Composer = _Composer
    try:
        content = loader.load(text)
        _check_characters(content)
        return content
    except RecursionError:
        raise ConfigurationError(f"{source}: not valid YAML: nested too deeply") from None
    except Exception as error:  # the reader's own slips as well: on `2020-99-99`, `!!float x`, `!!int ''`, ...
        raise ConfigurationError(_not_valid(source, error)) from None


def parse_yaml_texts(text: str, source: str, limit: int = MAX_FOREIGN_YAML) -> Any:
    """Read YAML whose values all stay texts (a null is an empty one), for what rosbag2 writes about bags.

    Libyaml reads a hundred times as fast as `parse_yaml`, and a bag tells of each topic and file in YAML. It knows the
    rules of YAML 1.1 only, in which `6e7` is no number and `on` is one of two truths: so none of its types are taken.
    Arguments and errors as in `parse_yaml`.
    """
    _check_length(text, source, limit)
    try:
        if "*" in text and any(isinstance(event, yaml.AliasEvent) for event in yaml.parse(text, Loader=_TEXTS)):
            raise ValueError(_NO_ALIASES)
        return yaml.load(text, Loader=_TEXTS)
    except Exception as error:  # YAMLError, and ValueError, RecursionError, ... on odd text
        raise ConfigurationError(_not_valid(source, error)) from None


def load_yaml(path: Path | str) -> Any:
    """Read one YAML 1.2 file; a missing, too large or unreadable file is a `ConfigurationError`."""
    return parse_yaml(read_text(path), str(path))


def read_text(path: Path | str, limit: int = MAX_YAML) -> str:
    """Read a UTF-8 file of at most `limit` bytes; `ConfigurationError` where that cannot be."""
    try:
        with open(path, "rb", opener=only_regular) as stream:
            data = stream.read(limit + 1)
        if len(data) > limit:
            raise ConfigurationError(f"cannot read {path}: it has more than {limit} bytes")
        return data.decode()
    except (OSError, ValueError) as error:  # of a path with a zero byte, of bytes that are not UTF-8
        raise ConfigurationError(f"cannot read {path}: {reason_of(error)}") from None


def only_regular(path: str, flags: int) -> int:
    """Open a file for `open(..., opener=only_regular)`: what waits for a writer or never ends is refused (OSError)."""
    descriptor = os.open(path, flags | os.O_NONBLOCK)
    mode = os.fstat(descriptor).st_mode
    if stat.S_ISREG(mode) or stat.S_ISDIR(mode):  # of a folder, `open` itself says so
        return descriptor
    os.close(descriptor)
    raise OSError(errno.EINVAL, "Not a regular file", path)


def reason_of(error: Exception) -> str:
    """Why a file could not be opened or read, in words without its name."""
    if isinstance(error, UnicodeDecodeError):
        return "not UTF-8 text"
    return getattr(error, "strerror", None) or str(error)


def dump_yaml(value: Any) -> str:
    """Return a value as YAML in block style, keys in the given order, so that yaml-cpp reads the same."""
    dumper = YAML(typ="safe", pure=True)
    dumper.default_flow_style = False
    dumper.sort_base_mapping_type_on_output = False  # type: ignore[assignment]  # keep rosbag2's key order
    dumper.width = 2**20  # one line a value: yaml-cpp and ruamel fold long lines differently
    stream = io.StringIO()
    dumper.dump(value, stream)
    return stream.getvalue()


def _quoted(character: str) -> str:
    """A character within double quotes; what YAML refuses, or takes for the end of a line, as its number."""
    if character in '"\\':
        return "\\" + character
    if character.isprintable():
        return character
    code = ord(character)
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"


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
        return '"' + "".join(map(_quoted, value)) + '"'
    return str(value)


def yaml_mapping(values: Mapping[str, float | int | bool | str]) -> str:
    """A flat mapping as YAML text, one key a line, in the order given."""
    return "".join(f"{key}: {yaml_scalar(value)}\n" for key, value in values.items())


def _check_characters(content: Any) -> None:
    """ValueError for a text that nothing can pass on: half a character ("\\ud800"), or a zero byte."""
    if isinstance(content, str):
        if "\0" in content or (not content.isascii() and any("\ud800" <= c <= "\udfff" for c in content)):
            raise ValueError(f"{content[:40]!a} has a character that no message can hold")
    elif isinstance(content, (list, dict)):
        for item in content:
            _check_characters(item)
        if isinstance(content, dict):
            for item in content.values():
                _check_characters(item)


def _check_length(text: str, source: str, limit: int) -> None:
    if len(text) > limit:
        raise ConfigurationError(f"{source}: {len(text)} characters of YAML; at most {limit} are read")


def _not_valid(source: str, error: Exception) -> str:
    mark = getattr(error, "problem_mark", None)
    where = f", line {mark.line + 1}" if mark is not None else ""
    problem = getattr(error, "problem", None) or (str(error).splitlines() or [type(error).__name__])[0]
    return f"{source}{where}: not valid YAML: {problem}"
