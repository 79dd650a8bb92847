"""Numbers as tables for people."""

from __future__ import annotations

import math
from typing import Any

from rich.console import Console, ConsoleOptions, RenderResult
from rich.measure import Measurement
from rich.table import Table

from squeal_rig.analysis.segments import Analysis, segment_rows

_FORMS = {"k [N/m]": ".3g", "k_cr [N/m]": ".3g", "margin": "+.2f", "F [N]": ".0f", "V [m/s]": ".2f"}
_FORMS |= {"from [s]": ".1f", "to [s]": ".1f", "f squeal [Hz]": ".0f", "f eigen [Hz]": ".0f"}
_FORMS |= {"± 95 % scatter": ".2g", "± 95 % with sheets": ".2g"}
_FORMS |= {"off belt [s]": ".2f", "off belt share": ".3f"}

_ANY_WIDTH, _NARROWEST = 10_000, 4  # characters: of a console, of a column


class SegmentTable:
    """The operating points of a run, a column each, to print: under one another where the console is too narrow."""

    def __init__(self, analysis: Analysis) -> None:
        self._title = f"Operating points of {analysis.title}"
        self._rows = list(segment_rows(analysis))

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        count = max(1, len(self._rows))
        unbounded = options.update_width(_ANY_WIDTH)
        for at_once in range(min(count, max(1, options.max_width // _NARROWEST)), 0, -1):
            tables = [self._table(first, first + at_once) for first in range(0, count, at_once)]
            if all(Measurement.get(console, unbounded, table).maximum <= options.max_width for table in tables):
                break
        yield from tables

    def _table(self, first: int, last: int) -> Table:
        rows = self._rows[first:last]
        table = Table(title="" if first else self._title, title_justify="left")
        table.add_column("")
        for number, _ in enumerate(rows, first + 1):
            table.add_column(str(number), justify="right")
        for name in rows[0] if rows else ():
            table.add_row(name, *(_cell(name, row[name]) for row in rows))
        return table


def zone_sentences(analysis: Analysis) -> list[str]:
    """What stands below the table: squeal that the eigenvalues do not know of, and why a zone is missing."""
    sentences = []
    hard = [(i, segment.zone) for i, segment in enumerate(analysis.segments, 1) if segment.hard_squeal]
    if hard:
        points = ", ".join(f"{i} (zone: {name})" for i, name in hard)
        which = f"operating point {points} squeals" if len(hard) == 1 else f"operating points {points} squeal"
        sentences.append(f"hard squeal: {which} where the eigenvalues call the rig stable")
    if analysis.no_zone:
        sentences.append(f"zone not available: {analysis.no_zone}")
    return sentences


def _cell(name: str, value: Any) -> str:
    if isinstance(value, float):
        return "-" if math.isnan(value) else format(value, _FORMS.get(name, ".4f"))
    return str(value)
