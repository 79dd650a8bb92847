"""How pictures and sound go to a browser: a line of JSON and the arrays that it names, in one binary message."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from struct import pack
from typing import Any

import numpy as np


def packed(kind: str, values: Mapping[str, Any], arrays: Mapping[str, np.ndarray] | None = None) -> bytes:
    """Length of the head (uint32), the head as JSON padded to a multiple of 4, then the arrays, each as well.

    Arrays are float32, or uint8 where they are that; all little-endian.
    """
    arrays = arrays or {}
    head: dict[str, Any] = {"kind": kind, **values}
    body = []
    names = []
    for name, array in arrays.items():
        code = "u1" if array.dtype == np.uint8 else "f4"
        data = array.astype("<u1" if code == "u1" else "<f4").tobytes()
        names.append([name, code, array.size])
        body.append(data + bytes(-len(data) % 4))
    head["arrays"] = names
    text = json.dumps(_finite(head), allow_nan=False, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    return pack("<I", len(text)) + text + b"".join(body)


def _finite(value: Any) -> Any:
    """The value with null for numbers that JSON does not have."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: _finite(found) for key, found in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(found) for found in value]
    return value
