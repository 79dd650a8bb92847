"""Metadata records that carry their own checksum: MCAP protects chunks, but not the records between them."""

from __future__ import annotations

import zlib
from collections.abc import Mapping

#: Name of the record that holds a bag's custom data, repeated whenever it grows.
PROVENANCE = "provenance"
SEAL = "crc32"


def sealed(values: Mapping[str, str]) -> dict[str, str]:
    """Return the texts with their checksum under the key `crc32`."""
    content = {key: value for key, value in values.items() if key != SEAL}
    return {**content, SEAL: _checksum(content)}


def is_intact(values: Mapping[str, str]) -> bool | None:
    """Return whether a record's checksum fits; None where it has none."""
    if SEAL not in values:
        return None
    return values[SEAL] == _checksum({key: value for key, value in values.items() if key != SEAL})


def unsealed(values: Mapping[str, str]) -> dict[str, str]:
    """Return the texts without their checksum."""
    return {key: value for key, value in values.items() if key != SEAL}


def _checksum(values: Mapping[str, str]) -> str:
    crc = 0
    for key, value in sorted(values.items()):
        for text in (key.encode(), value.encode()):
            crc = zlib.crc32(text, zlib.crc32(len(text).to_bytes(4, "little"), crc))
    return f"{crc:08x}"
