"""How the figures of the reproduction look: readable in grey, by line style and marker as well as by colour."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

#: One style a curve: colour, line, marker; distinct in grey too.
STYLES: tuple[dict[str, Any], ...] = (
    {"color": "#000000", "ls": "-", "marker": "o"},
    {"color": "#b2182b", "ls": "--", "marker": "s"},
    {"color": "#2166ac", "ls": "-.", "marker": "^"},
    {"color": "#7f7f7f", "ls": ":", "marker": "D"},
)
_DOTS_PER_INCH = 130


@dataclass(frozen=True)
class Picture:
    """A drawn figure: file stem, caption, PNG bytes."""

    name: str
    caption: str
    png: bytes

    def as_data_uri(self) -> str:
        """The PNG for an <img> of a page that needs no other file."""
        return "data:image/png;base64," + base64.b64encode(self.png).decode("ascii")


def style(number: int, markers: bool = False) -> dict[str, Any]:
    """Keyword arguments of `plot` for the n-th curve."""
    chosen = dict(STYLES[number % len(STYLES)])
    if not markers:
        chosen.pop("marker")
    return chosen


def legend_below(figure: Any, handles: list[Any], columns: int) -> None:
    """A legend of labelled handles under all axes of a figure; before matplotlib 3.7 at their lower edge."""
    import matplotlib

    where = "outside lower center" if matplotlib.__version_info__ >= (3, 7) else "lower center"
    figure.legend(handles, [handle.get_label() for handle in handles], loc=where, ncols=columns)


def picture(
    name: str, caption: str, draw: Callable[[Any], None], rows: int = 1, columns: int = 1, height: float = 3.4
) -> Picture:
    """Draw a figure; `draw` gets its axes as an array (rows, columns)."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    with plt.rc_context({"font.size": 9, "axes.grid": True, "grid.alpha": 0.3, "legend.fontsize": 8}):
        size = (4.6 * columns + 0.4, height * rows)
        figure, axes = plt.subplots(rows, columns, figsize=size, layout="constrained", squeeze=False)
        draw(axes)
        buffer = io.BytesIO()
        figure.savefig(buffer, dpi=_DOTS_PER_INCH, format="png")
        plt.close(figure)
    return Picture(name, caption, buffer.getvalue())
