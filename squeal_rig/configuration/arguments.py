"""What is written on a command line in one word: `name=value`, and a range `low:high`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeVar

from squeal_rig.errors import ParameterError

T = TypeVar("T")


def assignments(words: Sequence[str]) -> dict[str, float | str]:
    """Names and values of words `name=value`; a value that is no number stays a text.

    Raises:
        ParameterError: a word is none, or a name is given twice.
    """
    values: dict[str, float | str] = {}
    for word in words:
        name, equals, text = (part.strip() for part in word.partition("="))
        if not (name and equals and text):
            raise ParameterError(f"{word!r} is no setting: write name=value, as in damping_x=1000")
        if name in values:
            raise ParameterError(f"{name} is set twice, to {values[name]} and to {text}")
        values[name] = _number(text, text)
    return values


def span(word: str, what: str, unit: str = "") -> tuple[float, float]:
    """Both ends of a range `low:high`; `what` and `unit` are for the sentence.

    Raises:
        ParameterError: it is none.
    """
    low, _, high = word.partition(":")
    ends = _number(low, math.nan), _number(high, math.nan)
    if not (math.isfinite(ends[0]) and math.isfinite(ends[1]) and ends[0] < ends[1]):
        of = f" [{unit}]" if unit else ""
        raise ParameterError(f"{word!r} is no range of {what}{of}: write low:high, two finite numbers, the lower first")
    return ends


def _number(text: str, otherwise: T) -> float | T:
    try:
        return float(text)
    except ValueError:
        return otherwise
