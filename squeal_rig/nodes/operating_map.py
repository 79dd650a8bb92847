"""No node: the process beside the node `page`. A line of JSON in, the rig's parameters and a number of points;
one out, its operating map of so many points along each axis."""

from __future__ import annotations

import json
from typing import Any

from squeal_rig.errors import SquealRigError
from squeal_rig.graph.answering import answer_beside
from squeal_rig.model.parameters import RigParameters
from squeal_rig.studies.hard_squeal.chart import zone_chart

# Ranges of the map.
_PRELOADS, _SPEEDS = (1.0, 500.0), (0.1, 5.0)


def main() -> int:
    """Answer until standard input ends."""
    return answer_beside(lambda line: operating_map(*json.loads(line)))


def _middles(span: tuple[float, float], points: int) -> tuple[float, float]:
    """First and last middle of the cells that tile a range: that is how they are drawn."""
    half = 0.5 * (span[1] - span[0]) / points
    return span[0] + half, span[1] - half


def operating_map(values: dict[str, Any], points: int) -> dict[str, Any]:
    """Ranges of F [N] and V [m/s] and, a row a speed, a letter a point: quiet, bistable, squeal, - where there is no
    contact, ? where it is not known.
    """
    try:
        spans = _middles(_PRELOADS, points), _middles(_SPEEDS, points)
        chart = zone_chart(RigParameters.from_mapping(values), *spans, points)
    except SquealRigError as error:
        return {"state": f"there is none: {error}"}
    letters = {-2: "?", -1: "-", 0: "q", 1: "b", 2: "s"}
    rows = ["".join(letters[int(code)] for code in row) for row in chart.map.zone]
    return {"state": "computed", "preloads": _PRELOADS, "speeds": _SPEEDS, "rows": rows}
