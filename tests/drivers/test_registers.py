"""Numbers in Modbus registers, there and back."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from squeal_rig.drivers.registers import Register, count_of, value_of, words_of
from squeal_rig.errors import DriverError

BOUNDS = {"uint16": (0, 65535), "int16": (-32768, 32767), "uint32": (0, 2**32 - 1), "int32": (-(2**31), 2**31 - 1)}


@pytest.mark.parametrize("kind", [*BOUNDS, "float32", "float64"])
@pytest.mark.parametrize("order", ["big", "little"])
@given(share=st.floats(0.0, 1.0))
def test_a_value_comes_back_within_its_step(kind, order, share):
    register = Register(type=kind, word_order=order, scale=0.25, offset=3.0, unit="N")
    low, high = BOUNDS.get(kind, (-1000, 1000))
    value = 0.25 * (low + share * (high - low)) + 3.0
    words = words_of(register, value, "force")
    assert len(words) == count_of(register)
    assert all(0 <= word <= 65535 for word in words)
    step = 0.126 if kind in BOUNDS else 1e-4
    assert value_of(register, words, "force") == pytest.approx(value, abs=step, rel=1e-9)


def test_words_are_those_of_the_specification():
    # Modbus Application Protocol V1.1b3, section 4.2: the more significant byte of a register comes first.
    assert words_of(Register(type="uint32"), 0x12345678, "n") == [0x1234, 0x5678]
    assert words_of(Register(type="uint32", word_order="little"), 0x12345678, "n") == [0x5678, 0x1234]
    assert words_of(Register(type="int16"), -2, "n") == [0xFFFE]
    assert words_of(Register(type="float32"), 1.0, "n") == [0x3F80, 0x0000]


@pytest.mark.parametrize(
    ("kind", "value"), [("uint16", -1.0), ("int16", 4e4), ("float32", 1e300), ("uint32", float("nan"))]
)
def test_a_value_that_does_not_fit_is_refused_by_name(kind, value):
    with pytest.raises(DriverError, match=rf"inverter\.speed = .* m/s does not fit its register of {kind}"):
        words_of(Register(type=kind, unit="m/s"), value, "inverter.speed")


def test_what_is_no_number_is_refused_by_name():
    nan = list(struct.unpack(">HH", struct.pack(">f", float("nan"))))
    with pytest.raises(DriverError, match=r"unit\.force reads nan"):
        value_of(Register(type="float32"), nan, "unit.force")
    with pytest.raises(DriverError, match="1 registers came, and float32 takes 2"):
        value_of(Register(type="float32"), [1], "unit.force")
