"""Message definitions and type hashes of the installed interface packages, found without ROS.

An interface package installs `share/<pkg>/msg/<Type>.msg` (the definition) and `<Type>.json` (its type hash).
They are looked for in every entry of AMENT_PREFIX_PATH, then in `sys.prefix`, where the PyPI wheels put them.
"""

from __future__ import annotations

import json
import os
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from squeal_rig.errors import RecordingError

_TYPE_NAME = re.compile(r"([A-Za-z][A-Za-z0-9_]*)/(?:(msg|srv|action)/)?([A-Za-z][A-Za-z0-9_]*)")
_FIELD = re.compile(r"^\s*([A-Za-z][A-Za-z0-9_]*(?:/[A-Za-z0-9_]+)*)(?:<=\d+)?(?:\[[^\]]*\])?\s+[A-Za-z]")
_PRIMITIVES = frozenset(
    "bool byte char float32 float64 int8 uint8 int16 uint16 int32 uint32 int64 uint64 string wstring".split()
)
_SEPARATOR = "=" * 80
_SEPARATORS = re.compile(r"^=+\n", re.MULTILINE)
_HEADS = ("MSG:", "IDL:")  # of the parts of a definition behind its first
_FIELD_PARTS = re.compile(r"^(?:\w+/)+|\s*(=)\s*")
_MAX_TEXT, _MAX_FIELDS = 1 << 18, 4000  # of a definition that is parsed
_MAX_DEPTH = 50  # rosbag2's own limit (local_message_definition_source.hpp)


@dataclass(frozen=True)
class MessageSchema:
    """A type's definition as a bag holds it.

    `text` is the rosbag2 `ros2msg` form; encoding and text may be empty where a definition is not installed.
    """

    type_name: str
    text: str = ""
    type_hash: str = ""
    encoding: str = "ros2msg"

    def conflict(self, other: MessageSchema) -> str | None:
        """Return the name of a type that another definition of this one defines otherwise, or not at all.

        None where the one reads the other's messages.

        Comments, spacing and the packages of fields do not count: they differ between releases of the same definition.
        One in another language (`encoding`) reads nothing of this one's.
        A part of another text without a head is in conflict with all: nobody reads by it.
        """
        if self.encoding != other.encoding:
            return other.type_name[:100]
        if self.text == other.text:
            return None
        for schema in (self, other):
            heads = (part.partition("\n")[0] for part in _SEPARATORS.split(schema.text)[1:])
            if (headless := next((head for head in heads if not head.startswith(_HEADS)), None)) is not None:
                return repr(headless[:60])
        mine, theirs = _fields_by_type(self), _fields_by_type(other)
        return next((name[:100] for name in mine | theirs if mine.get(name) != theirs.get(name)), None)

    def check_decodable(self) -> None:
        """Raise RecordingError where a definition is too long, or of a kind that lets a few bytes fill the memory."""
        if len(self.text) > _MAX_TEXT:
            raise RecordingError(f"its definition has {len(self.text)} characters; at most {_MAX_TEXT} are read")
        types = {
            name.rpartition("/")[2]: [f.split(" ") for f in fields] for name, fields in _fields_by_type(self).items()
        }
        count = sum(map(len, types.values()))
        if count > _MAX_FIELDS:
            raise RecordingError(f"its definition has {count} fields; at most {_MAX_FIELDS} are read")
        sized = set(_PRIMITIVES)  # types of which a value takes a byte of the message at least
        while grown := {name for name in types.keys() - sized if any(_is_sized(f, sized) for f in types[name])}:
            sized |= grown
        for field in (field for fields in types.values() for field in fields):
            if "[" in field[0] and _type_of(field) not in sized:
                raise RecordingError(f"its definition has an array of {_type_of(field)}, which has no fields")


def _is_sized(field: list[str], sized: set[str]) -> bool:
    """Whether a field takes a byte at least: a constant and an empty array take none."""
    return _type_of(field) in sized and "[0]" not in field[0] and "=" not in "".join(field[1:2])


def _type_of(field: list[str]) -> str:
    return re.split(r"\[|<=", field[0], maxsplit=1)[0]


@lru_cache(maxsize=256)
def _fields_by_type(schema: MessageSchema) -> dict[str, tuple[str, ...]]:
    """Name -> fields, for the type and each that it uses."""
    found = {}
    for number, part in enumerate(_SEPARATORS.split(schema.text)):
        head, _, body = part.partition("\n") if number else (f":{schema.type_name}", "", part)
        fields = (_FIELD_PARTS.sub(r"\1", " ".join(line.partition("#")[0].split())) for line in body.splitlines())
        found[head.partition(":")[2].strip().replace("/msg/", "/")] = tuple(field for field in fields if field)
    return found


@lru_cache(maxsize=256)
def installed_schema(type_name: str) -> MessageSchema:
    """Return definition and type hash of an installed message type, e.g. `sensor_msgs/msg/PointCloud2`.

    Raises RecordingError when the name is no message type or when it, or a type it uses, is not installed.
    The answer is remembered for the life of the process.
    """
    full_name = full_type_name(type_name)
    text = "".join(_definitions(full_name, set(), _MAX_DEPTH))
    return MessageSchema(full_name, text, _type_hash(full_name))


def full_type_name(type_name: str) -> str:
    """Return `pkg/msg/Type` for `pkg/msg/Type` or the short `pkg/Type`; RecordingError for anything else."""
    match = _TYPE_NAME.fullmatch(type_name)
    if match is None or match[2] not in (None, "msg"):
        raise RecordingError(f"{type_name!r} is not the name of a ROS message type; it reads pkg/msg/Type.")
    return f"{match[1]}/msg/{match[3]}"


def field_types(definition: str, package: str) -> tuple[str, ...]:
    """Return the sorted full names of the types a `.msg` text uses; `package` completes bare names."""
    names = set()
    for line in definition.splitlines():
        match = _FIELD.match(line)
        if match and match[1] not in _PRIMITIVES:
            names.add(full_type_name(match[1] if "/" in match[1] else f"{package}/{match[1]}"))
    return tuple(sorted(names))


def _definitions(full_name: str, seen: set[str], depth: int) -> Iterator[str]:
    """Yield the definition, then depth first each dependency not yet seen, in rosbag2's order."""
    if depth <= 0:
        raise RecordingError(f"The definition of {full_name} nests deeper than {_MAX_DEPTH} types.")
    text = _share_file(full_name, ".msg").read_bytes().decode("utf-8")
    yield text
    for name in field_types(text, full_name.split("/")[0]):
        if name not in seen:
            seen.add(name)
            yield f"\n{_SEPARATOR}\nMSG: {name}\n"
            yield from _definitions(name, seen, depth - 1)


def _type_hash(full_name: str) -> str:
    """Return `RIHS01_...` from the type description file."""
    path = _share_file(full_name, ".json")
    try:
        hashes = json.loads(path.read_text(encoding="utf-8"))["type_hashes"]
        return str(next(entry["hash_string"] for entry in hashes if entry["type_name"] == full_name))
    except (ValueError, KeyError, TypeError, StopIteration):
        raise RecordingError(f"{path} holds no type hash of {full_name}.") from None


def _share_file(full_name: str, suffix: str) -> Path:
    package, kind, name = full_name.split("/")
    prefixes = [entry for entry in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if entry]
    for prefix in [*prefixes, sys.prefix]:
        path = Path(prefix, "share", package, kind, name + suffix)
        if path.is_file():
            return path
    raise RecordingError(
        f"No {suffix} file of {full_name} is installed; looked for share/{package}/{kind}/{name}{suffix}"
        f" in AMENT_PREFIX_PATH ({len(prefixes)} entries) and in {sys.prefix}."
    )
