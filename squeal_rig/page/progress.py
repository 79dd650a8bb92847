"""How far a plan or a campaign is, out of what is told of it on `run/events`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from squeal_rig.experiments.engine import RUN_ENDED, RUN_STARTED, STEP_BEGUN, STEP_ENDED

_LONGEST = 200  # characters of a text that others wrote
_SEEN = ("verdict", "frequency", "note")
_ERROR = 2  # level of a diagnostic status


class Progress:
    """Follows the events of one run after the other; who comes late misses the first ones of a long one.

    `shown` is empty until something was told; then
    - kind: "plan", "campaign" or "run", and its title
    - of, done, failed: steps or points in all (0: not known), how many are done, how many of these failed
    - step, doing: the one that is at work, 0 where none is
    - last: what came out of the one before
    - left: time that the rest takes at the pace so far [s], nan where it is not known
    - ended: how the run ended; empty while it lasts
    """

    def __init__(self) -> None:
        self.shown: dict[str, Any] = {}
        self._begun = math.nan
        self._measured = 0

    def take(self, stamp: float, level: int, what: str, facts: Mapping[str, str]) -> None:
        """Take an event of a time [s since the epoch]."""
        if what == RUN_STARTED or not self.shown:
            self._start(stamp, facts)
        shown = self.shown
        if what == STEP_BEGUN:
            if not self._measured:
                self._begun = stamp  # not from the start of the nodes on
            shown |= {"step": _count(facts, "step"), "doing": _text(facts, "title"), "ended": ""}
            # A plan's steps are one after the other; of a campaign that goes on some are done already.
            shown["of"] = _count(facts, "of") or shown["of"]
        elif what == STEP_ENDED:
            self._measured += 1
            failed = level >= _ERROR or facts.get("verdict") == "failed"
            seen = [name for name in _SEEN if facts.get(name, "") not in ("", "nan", "none")]
            outcome = ", ".join(f"{name} {_text(facts, name)}" for name in seen)
            done = shown["done"] + 1
            shown |= {
                "step": 0,
                "done": done,
                "failed": shown["failed"] + failed,
                "last": f"{_text(facts, 'title')}: {outcome or _text(facts, 'outcome')}",
                "left": (stamp - self._begun) / self._measured * max(0, shown["of"] - done),
            }
        elif what == RUN_ENDED:
            shown |= {"step": 0, "left": math.nan, "ended": _text(facts, "outcome") or "ended"}

    def _start(self, stamp: float, facts: Mapping[str, str]) -> None:
        kind = next((kind for kind in ("campaign", "plan") if kind in facts), "run")
        if "campaign" in facts:
            of, done = _count(facts, "points"), _count(facts, "done before")
        else:
            of, done = _count(facts, "steps"), 0
        self._begun, self._measured = stamp, 0
        self.shown = {
            "kind": kind,
            "title": _text(facts, kind) if kind != "run" else "",
            "of": of,
            "done": done,
            "failed": 0,
            "step": 0,
            "doing": "",
            "last": "",
            "left": math.nan,
            "ended": "",
        }


def _text(facts: Mapping[str, str], name: str) -> str:
    return str(facts.get(name, ""))[:_LONGEST]


def _count(facts: Mapping[str, str], name: str) -> int:
    text = facts.get(name, "")
    return int(text) if text.isdecimal() and len(text) < 10 else 0
