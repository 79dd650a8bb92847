"""Decodes any recorded message from the definition its bag carries, for offline analysis without ROS."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache
from typing import Any

from mcap.records import Schema

from squeal_rig.errors import RecordingError

from .schemas import MessageSchema

Decode = Callable[[bytes], Any]
#: Level, sentence and values of a diagnostic status.
Status = tuple[int, str, Mapping[str, str]]


@lru_cache(maxsize=64)
def decoder_of(schema: MessageSchema) -> Decode:
    """Return a function from CDR bytes to an object with the message's fields as attributes.

    Nested messages are such objects, arrays are lists or bytes. The returned function raises RecordingError
    for bytes that are no such message; this one where the bag has no readable definition.
    """
    try:
        from mcap_ros2.decoder import DecoderFactory  # a recorder never needs it
    except ImportError:
        raise RecordingError(
            "Decoding recorded messages needs the Python package mcap-ros2-support, which is not installed."
        ) from None
    record = Schema(id=1, data=schema.text.encode(), encoding=schema.encoding, name=schema.type_name)
    try:
        schema.check_decodable()
        decode = DecoderFactory().decoder_for("cdr", record)
    except Exception as error:  # its parser raises many kinds
        raise RecordingError(f"The definition of {schema.type_name} cannot be read ({error}).") from None
    if decode is None:
        raise RecordingError(f"The bag holds no ros2msg definition of {schema.type_name} ({schema.encoding!r}).")
    return _guarded(decode, schema.type_name)


def as_mapping(message: Any) -> Any:
    """Return a decoded message as dicts, lists and plain values, for instance to print or to store it."""
    if isinstance(message, list):
        return [as_mapping(item) for item in message]
    names = getattr(type(message), "__slots__", None)
    return message if names is None else {name: as_mapping(getattr(message, name)) for name in names}


def statuses(message: Any) -> Iterator[tuple[str, Status]]:
    """Yield name and status of each entry of a decoded diagnostic_msgs/DiagnosticArray.

    Raises:
        RecordingError: it is of another type.
    """
    try:
        for found in message.status:
            level = found.level if isinstance(found.level, int) else int.from_bytes(found.level, "little")
            yield str(found.name), (level, str(found.message), {pair.key: pair.value for pair in found.values})
    except (AttributeError, TypeError) as error:
        raise RecordingError(f"A message holds no diagnostic statuses ({error}).") from None


def _guarded(decode: Decode, type_name: str) -> Decode:
    def guarded(data: bytes) -> Any:
        try:
            return decode(data)
        except Exception as error:  # struct.error, IndexError, UnicodeDecodeError, ...
            raise RecordingError(f"{len(data)} bytes are no {type_name} ({type(error).__name__}: {error}).") from None

    return guarded
