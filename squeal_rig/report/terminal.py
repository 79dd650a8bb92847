"""The console that commands print to."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.text import Text

from squeal_rig.errors import printable


class PlainConsole(Console):
    """Prints texts as they are: nothing in them is markup, and nothing in them steers the terminal.

    Much of what is printed stands in bags and files of others. Tables and styles are rich's as ever.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(markup=False, highlight=False, emoji=False, **options)

    def render_str(self, text: str, **options: Any) -> Text:
        """Every text passes here on its way, also titles and cells of tables."""
        return super().render_str(printable(text, keep="\n"), **options)
