"""The live console: a table that follows the rig, or a line a second where there is no terminal."""

from __future__ import annotations

import math
import time

from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from squeal_rig.session.live import LiveState

_LINE_PERIOD = 1.0


class StateDisplay:
    """Shows a `LiveState`: as a table in place on a terminal, as a line a second elsewhere."""

    def __init__(self, console: Console, state: LiveState) -> None:
        self._console = console
        self._state = state
        self._live = Live(console=console, auto_refresh=False, transient=False) if console.is_terminal else None
        self._note = ""
        self._last_line = -math.inf

    def __enter__(self) -> StateDisplay:
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(self, *_error: object) -> None:
        if self._live is not None:
            self._live.stop()

    def note(self, text: str) -> None:
        """Say what the plan is at."""
        self._note = text
        if self._live is None:
            self._console.print(_plain(f"-- {text}"))

    def refresh(self) -> None:
        """Show the state as it is now."""
        if self._live is not None:
            self._live.update(self._table(), refresh=True)
        elif time.monotonic() - self._last_line >= _LINE_PERIOD:
            self._last_line = time.monotonic()
            line = ", ".join(f"{name} {value}" for name, value in self._rows())
            self._console.print(_plain(line), soft_wrap=True)

    def _table(self) -> Table:
        table = Table(title=_plain(self._note or "squeal_rig"), title_justify="left", show_header=False)
        table.add_column(style="bold")
        table.add_column(min_width=48)
        for name, value in self._rows():
            table.add_row(name, _plain(value))
        return table

    def _rows(self) -> list[tuple[str, str]]:
        s = self._state
        squeal = "-" if s.squealing is None else f"{s.level:.1f} dB re 1 um" if s.level > -200.0 else "silent"
        if s.squealing:
            squeal = f"SQUEAL {squeal} at {s.frequency:.0f} Hz"
        stable = {None: "-", True: "unstable", False: "stable"}[s.unstable]
        recorded = f"{_number(s.recorded_bytes / 1e6, '.1f')} MB"
        rows = [
            ("time", f"{_number(s.sampled_time, '.1f')} s"),
            ("in force", f"F = {_number(s.preload, '.0f')} N, V = {_number(s.belt_speed, '.2f')} m/s"),
            (
                "mu",
                f"set {_number(s.mu_set, '.4f')}, (2.2) {_number(s.mu_estimated, '.4f')},"
                f" ratio of means {_number(s.mu_ratio_of_means, '.4f')}",
            ),
            (
                "k_cr",
                f"{_number(s.critical_stiffness, '.3g')} N/m at k = {_number(s.pad_stiffness, '.3g')} N/m,"
                f" margin {_number(s.margin, '+.2f')}: {stable}",
            ),
            ("zone", _zone(s)),
            ("squeal", squeal),
            ("recorded", recorded),
        ]
        troubles = [f"{name}: {text}" for name, (level, text) in sorted(s.health.items()) if level > 0]
        return [*rows, ("health", "; ".join(troubles))] if troubles else rows


def _plain(text: str) -> Text:
    """A text that others wrote: no markup, no control characters."""
    return Text("".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in text))


def _zone(s: LiveState) -> str:
    hit = f", smallest hit {s.smallest_hit:.3g} N s" if s.smallest_hit > 0.0 else ""
    return f"{s.zone or '-'}{hit}"


def _number(value: float, form: str) -> str:
    return "-" if math.isnan(value) else format(value, form)
