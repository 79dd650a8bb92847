"""Pictures of the errors of estimated friction."""

from __future__ import annotations

from typing import Any

import numpy as np

from squeal_rig.report.paper_style import Picture, picture, style
from squeal_rig.studies.friction_bias.errors import Errors, FrictionErrors, by_source
from squeal_rig.studies.friction_bias.estimators import ESTIMATORS, LEAST_SQUARES, MEAN_OF_CORRECTED
from squeal_rig.studies.friction_bias.sources import ALL, IDEAL

# Errors below this share [%] are drawn at it.
_LOWEST = 1e-3


def source_figure(found: FrictionErrors, motions: tuple[str, ...]) -> Picture:
    """RMS error of every estimator under every source, one panel a motion."""

    def draw(axes: Any) -> None:
        for axis, motion in zip(axes[0], motions, strict=True):
            table = by_source(found.table, motion)
            names = list(table)
            for number, estimator in enumerate(ESTIMATORS):
                values = [100.0 * table[name][estimator].rms for name in names]
                height = np.arange(len(names)) + 0.13 * (number - 2)
                axis.plot(
                    np.maximum(values, _LOWEST), height, **{**_look(number), "ls": "none"}, ms=4.5, label=estimator
                )
            axis.set(xscale="log", xlabel="RMS error of $\\mu$ [%]", title=motion, xlim=(0.7 * _LOWEST, 400.0))
            axis.set_yticks(range(len(names)), names)
            axis.invert_yaxis()
            axis.label_outer()
        axes[0][0].legend(loc="upper right", fontsize=7)

    caption = (
        "RMS error of a window of 0.2 s over windows and specimens, one source of error at a time; what is below"
        " 0.001 % is drawn there. Markers of one source are shifted against each other so that all are seen."
    )
    return picture("sources", caption, draw, columns=2, height=5.6)


def averaging_figure(found: FrictionErrors, motions: tuple[str, ...]) -> Picture:
    """Scatter between windows over their length, one panel a motion, ideal instruments and all sources."""

    def draw(axes: Any) -> None:
        for row, source in zip(axes, (IDEAL, ALL), strict=True):
            for axis, motion in zip(row, motions, strict=True):
                for number, estimator in enumerate(ESTIMATORS):
                    lines = [e for e in found.averaging if _is(e, motion, source, estimator)]
                    scatter = [max(100.0 * e.window_scatter, _LOWEST) for e in lines]
                    axis.plot([e.window for e in lines], scatter, **_look(number), ms=4.0, label=estimator)
                axis.set(xscale="log", yscale="log", title=f"{motion}, {source}")
                axis.set_xticks([0.02, 0.05, 0.1, 0.2, 0.6], ["0.02", "0.05", "0.1", "0.2", "0.6"])
                axis.minorticks_off()
                axis.set_ylim(0.5 * _LOWEST, 100.0)
                axis.set(xlabel="window T [s]", ylabel="scatter of $\\mu$ [%]")
        axes[0][0].legend(loc="upper right", fontsize=7)

    caption = (
        "Standard deviation between windows of one specimen over the window's length T. In steady sliding ideal"
        " instruments leave rounding alone (drawn at 0.001 %)."
    )
    return picture("averaging", caption, draw, rows=2, columns=2, height=3.2)


def _is(errors: Errors, motion: str, source: str, estimator: str) -> bool:
    return (errors.motion, errors.source, errors.estimator) == (motion, source, estimator)


def _look(number: int) -> dict[str, Any]:
    if ESTIMATORS[number] == LEAST_SQUARES:
        return {"color": "#e08214", "ls": (0, (3, 1, 1, 1, 1, 1)), "marker": "v"}
    if ESTIMATORS[number] == MEAN_OF_CORRECTED:
        return {**style(number, markers=True), "mfc": "none"}
    return style(number, markers=True)
