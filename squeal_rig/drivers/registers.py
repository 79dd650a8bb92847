"""Numbers in Modbus registers: type, word order, scale. Bytes: Modbus Application Protocol V1.1b3, section 4.2."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass

from squeal_rig.configuration.declared import Declared, quantity
from squeal_rig.errors import DriverError

_CODES = {"uint16": ">H", "int16": ">h", "uint32": ">I", "int32": ">i", "float32": ">f", "float64": ">d"}


@dataclass(frozen=True)
class Register(Declared):
    """Each of a unit's `registers`. Value = scale · (number in the register) + offset."""

    address: int = quantity(0, "address of its first register, counted from 0", lower=0, upper=65535)
    kind: str = quantity(
        "holding",
        "holding: read by function 3, written by write_function; input: read by function 4",
        options=("holding", "input"),
    )
    type: str = quantity("uint16", "number in it", options=("uint16", "int16", "uint32", "int32", "float32", "float64"))
    word_order: str = quantity(
        "big", "which of its registers comes first; bytes in a register are big-endian", options=("big", "little")
    )
    write_function: int = quantity(16, "6: single register, 16: multiple registers", lower=6, upper=16)
    scale: float = quantity(1.0, "units per count")
    offset: float = quantity(0.0, "added after scaling")
    unit: str = quantity("", "unit that the scale leads to; checked where it is used")


def count_of(register: Register) -> int:
    """Registers of 16 bits that it takes."""
    return struct.calcsize(_CODES[register.type]) // 2


def words_of(register: Register, value: float, name: str) -> list[int]:
    """The registers' contents for a value in the register's unit, the first register first.

    Raises:
        DriverError: the type cannot hold it.
    """
    raw = (value - register.offset) / register.scale
    try:
        number = raw if register.type.startswith("float") else round(raw)
        data = struct.pack(_CODES[register.type], number)
        if not math.isfinite(raw):
            raise ValueError
    except (struct.error, OverflowError, ValueError):
        raise DriverError(f"{name} = {value:g} {register.unit} does not fit its register of {register.type}") from None
    words = list(struct.unpack(f">{len(data) // 2}H", data))
    return words if register.word_order == "big" else words[::-1]


def value_of(register: Register, words: Sequence[int], name: str) -> float:
    """The value in the register's unit.

    Raises:
        DriverError: too few registers, or no finite number in them.
    """
    if len(words) != count_of(register):
        raise DriverError(f"{name}: {len(words)} registers came, and {register.type} takes {count_of(register)}")
    ordered = words if register.word_order == "big" else words[::-1]
    (number,) = struct.unpack(_CODES[register.type], struct.pack(f">{len(ordered)}H", *ordered))
    value: float = register.scale * number + register.offset
    if not math.isfinite(value):
        raise DriverError(f"{name} reads {value}")
    return value
