"""The command `study friction-bias`: a page with pictures, and the tables beside."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from rich.console import Console

from squeal_rig.instruments.data_sheets import load_data_sheets
from squeal_rig.model.parameters import RigParameters
from squeal_rig.report.page import DataTable, Section, check_folder, write_report
from squeal_rig.studies.friction_bias.errors import (
    SPECIMENS,
    WINDOW,
    Errors,
    FrictionErrors,
    by_source,
    friction_errors,
)
from squeal_rig.studies.friction_bias.estimators import CORRECTED, ESTIMATORS, MEAN_OF_RATIOS, RATIO_OF_MEANS
from squeal_rig.studies.friction_bias.figures import averaging_figure, source_figure
from squeal_rig.studies.friction_bias.sources import ALL, IDEAL, sources

PAGE = "index.html"
_MOTIONS = ("steady sliding", "squeal")


def run_friction_bias(p: RigParameters, instruments: str, folder: Path, force: bool, console: Console) -> None:
    """Compute the errors, write page, pictures and tables, and say what was found.

    Raises:
        ConfigurationError, ParameterError: as `load_data_sheets`.
        DiskError: the folder has something in it, or cannot be written.
        ModelError: the rig cannot slide at the study's operating points.
    """
    chosen = sources(load_data_sheets(instruments))
    check_folder(folder, force)
    found = friction_errors(p, chosen)
    sections = [_sources_section(found), _averaging_section(found)]
    lead = [
        f"Data sheets: {instruments}. Each source of error stands alone, all else ideal; then all together."
        f" {SPECIMENS} specimens of every instrument are drawn within its tolerances, windows are {WINDOW:g} s long."
        " Errors are relative to the true friction coefficient, in percent."
    ]
    write_report("Errors of estimated friction", lead, sections, folder / PAGE, force)
    for sentence in findings(found):
        console.print(sentence)
    console.print(f"page: {folder / PAGE}")


def findings(found: FrictionErrors) -> list[str]:
    """What the numbers say, one sentence a motion and instruments."""
    sentences = []
    for motion in _MOTIONS:
        table = by_source(found.table, motion)
        for source in (IDEAL, ALL):
            errors = ", ".join(
                f"{name} {100.0 * table[source][name].rms:.3g} %"
                for name in (MEAN_OF_RATIOS, RATIO_OF_MEANS, CORRECTED)
            )
            sentences.append(f"{motion}, {source}: RMS error of mu by {errors}")
    return sentences


def _sources_section(found: FrictionErrors) -> Section:
    section = Section(
        "One source at a time",
        [
            *(f"{sentence}." for sentence in findings(found)),
            "Bias is the mean over windows and specimens. The scatter between windows is what longer averaging makes"
            " smaller; the scatter between specimens is what it does not: it is the same in every window of one rig,"
            " and belongs into the interval of a result as a bound.",
            "Corrected estimators add m y'' + c_y y' to the denominator, from the displacement channel. The ratio of"
            " means needs it at a window's two ends only. Every correction asks for a torque that follows the contact"
            " force; behind a drum with inertia and an inverter it does not, and in squeal nothing is gained.",
        ],
        pictures=[source_figure(found, _MOTIONS)],
    )
    measures: tuple[tuple[str, str, Callable[[Errors], float]], ...] = (
        ("bias", "bias", lambda e: e.bias),
        ("window_scatter", "standard deviation between windows", lambda e: e.window_scatter),
        ("specimen_scatter", "standard deviation between specimens", lambda e: e.specimen_scatter),
    )
    for motion in _MOTIONS:
        for stem, what, measure in measures:
            rows = [
                [source, *(100.0 * measure(row[name]) for name in ESTIMATORS)]
                for source, row in by_source(found.table, motion).items()
            ]
            name = f"{motion.replace(' ', '_')}_{stem}"
            section.tables.append(
                DataTable(name, f"{motion}: {what} [%]", ("source", *(f"{e} [%]" for e in ESTIMATORS)), rows)
            )
    return section


def _averaging_section(found: FrictionErrors) -> Section:
    rows = [
        [
            e.motion,
            e.source,
            e.estimator,
            e.window,
            100.0 * e.bias,
            100.0 * e.window_scatter,
            100.0 * e.specimen_scatter,
        ]
        for e in found.averaging
    ]
    columns = ("motion", "source", "estimator", "T [s]", "bias [%]", "between windows [%]", "between specimens [%]")
    text = [
        "Independent noise falls as 1/sqrt(T). What a window cuts off at its two ends falls as 1/T: that is what squeal"
        " leaves in the ratio of means, and what the correction takes away. Sensitivity and zero stay."
    ]
    data = [DataTable("averaging", "Errors over the window's length", columns, rows)]
    return Section("What averaging buys", text, pictures=[averaging_figure(found, _MOTIONS)], data=data)
