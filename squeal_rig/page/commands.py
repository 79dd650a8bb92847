"""What a browser may ask for, checked against the declarations before the graph hears of it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from squeal_rig.configuration.declared import Declaration, checked, declarations, unknown_name
from squeal_rig.errors import ParameterError, SquealRigError
from squeal_rig.instruments.settings import RigSettings
from squeal_rig.model.parameters import RUN_TIME_PARAMETERS, RigParameters

EMERGENCY_STOP, SET, SUPERVISOR_RESET = "emergency_stop", "set", "supervisor_reset"
SPRINGS_FITTED, DEACTIVATE, ACTIVATE = "springs_fitted", "deactivate", "activate"
#: Commands without more than their name.
PLAIN = (
    "reset",
    "impact",
    "zero",
    "pause",
    "resume",
    DEACTIVATE,
    ACTIVATE,
    "record_start",
    "record_stop",
    "snapshot",
    EMERGENCY_STOP,
)
#: Commands with a text: what it is called there, and what the command is in words.
TEXTS = {
    SUPERVISOR_RESET: ("reason", "a reset of the supervisor needs a reason"),
    SPRINGS_FITTED: ("name", "confirming springs needs their name"),
}
#: Longest command taken [bytes], and longest text in one [characters].
MOST_BYTES = 4096
MOST_TEXT = 200
#: The impact's settings, which are the rig's parameters too.
HIT = ("impact_impulse", "impact_direction")


class RefusedError(SquealRigError):
    """A command that cannot be meant, or is not allowed; the sentence is shown to the operator."""


def settable() -> dict[str, Declaration]:
    """Name -> declaration of every parameter that can be set from the page."""
    rig = {name: found for name, found in declarations(RigParameters).items() if name in RUN_TIME_PARAMETERS}
    return {**rig, **{name: declarations(RigSettings)[name] for name in HIT}}


@dataclass(frozen=True)
class Command:
    """One command: its name, values to set, reason for the supervisor's reset or name of the springs."""

    name: str
    values: Mapping[str, Any] = field(default_factory=dict)
    text: str = ""


def command_of(text: bytes, control: bool) -> Command:
    """The command that a browser sent.

    Raises:
        RefusedError: too long, no command of ours, a value out of bounds, or not allowed.
    """
    if len(text) > MOST_BYTES:
        raise RefusedError(f"a command of {len(text)} bytes is longer than {MOST_BYTES}")
    try:
        content = json.loads(text)
    except (ValueError, RecursionError):
        raise RefusedError("that is no command: it is not JSON") from None
    if not isinstance(content, dict):
        raise RefusedError("that is no command: it has no name")
    name = content.pop("do", None)
    if not isinstance(name, str) or name not in (*PLAIN, SET, *TEXTS):
        raise RefusedError(f"there is no command {str(name)[:40]!r}")
    if name != EMERGENCY_STOP and not control:
        raise RefusedError("this page is read-only: start it with --control, or the parameter control, to operate")
    if name == SET:
        return Command(SET, _values(content.pop("values", None), content))
    if name in TEXTS:
        key, needed = TEXTS[name]
        given = content.pop(key, None)
        if not isinstance(given, str) or not given.strip() or len(given) > MOST_TEXT or not given.isprintable():
            raise RefusedError(f"{needed} of 1 to {MOST_TEXT} printable characters")
        _nothing_else(content)
        return Command(name, text=given.strip())
    _nothing_else(content)
    return Command(name)


def _values(given: Any, rest: Mapping[str, Any]) -> dict[str, Any]:
    _nothing_else(rest)
    known = settable()
    if not isinstance(given, dict) or not 1 <= len(given) <= len(known):
        raise RefusedError("there is nothing to set")
    try:
        for name in given:
            if name not in known:
                raise unknown_name(name[:40], known)
        return {name: checked(known[name], value) for name, value in given.items()}
    except ParameterError as error:
        raise RefusedError(str(error)) from None


def _nothing_else(content: Mapping[str, Any]) -> None:
    if content:
        raise RefusedError(f"the command has a part {next(iter(content))[:40]!r} that it does not take")
