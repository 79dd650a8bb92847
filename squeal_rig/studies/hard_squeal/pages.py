"""The commands `cycles` and `map`: a page with pictures, and the data beside; and their sections on other pages."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from squeal_rig.configuration.declared import declarations
from squeal_rig.errors import ModelError
from squeal_rig.model.core.law import friction_coefficient
from squeal_rig.model.cycles.cycle import SquealCycle
from squeal_rig.model.cycles.path import refuse_what_has_no_cycles
from squeal_rig.model.cycles.zone_map import BISTABLE, NAMES, QUIET, SQUEAL
from squeal_rig.model.cycles.zones import Zone
from squeal_rig.model.parameters import RigParameters
from squeal_rig.report.page import DataTable, Section, check_folder, write_report
from squeal_rig.studies.hard_squeal.branches import Diagram, branch_diagram, from_rest, normal_force
from squeal_rig.studies.hard_squeal.chart import Chart, zone_chart
from squeal_rig.studies.hard_squeal.figures import (
    branch_figure,
    cycle_figure,
    multiplier_figure,
    value_text,
    zone_figure,
)

PAGE = "index.html"


def run_cycles(
    p: RigParameters, field: str, bounds: tuple[float, float] | None, folder: Path, force: bool, console: Console
) -> None:
    """Follow the squeal cycle of a rig along a field; write the page, its pictures and tables, and say what was found.

    Raises:
        DiskError: the folder has something in it, or cannot be written.
        ModelError, ParameterError: as `branch_diagram`.
    """
    refuse_what_has_no_cycles(p)
    check_folder(folder, force)
    diagram = branch_diagram(p, field, bounds)
    sections = list(cycle_sections(diagram))
    lead = [_rig_text(p), _zone_text(diagram.zone)]
    write_report(f"Squeal cycles along {field}", lead, sections, folder / PAGE, force)
    console.print(_zone_text(diagram.zone))
    for kind, value, frequency in _special_rows(diagram):
        console.print(f"{kind}: {value_text(diagram, value)}, {frequency:.1f} Hz")
    console.print(f"page: {folder / PAGE}")


def run_map(
    p: RigParameters,
    preloads: tuple[float, float],
    speeds: tuple[float, float],
    folder: Path,
    force: bool,
    console: Console,
) -> None:
    """Compute the zones over preload and belt speed; write the page, its picture and table, and say what was found.

    Raises:
        DiskError: the folder has something in it, or cannot be written.
        ModelError, ParameterError: as `zone_chart`.
    """
    refuse_what_has_no_cycles(p)
    check_folder(folder, force)
    chart = zone_chart(p, preloads, speeds)
    section = zone_section(chart)
    write_report("Zones over preload and belt speed", [_rig_text(p)], [section], folder / PAGE, force)
    for text in section.text:
        console.print(text)
    console.print(f"page: {folder / PAGE}")


def cycle_sections(diagram: Diagram) -> Iterable[Section]:
    """Branch, multipliers and cycles, with their tables."""
    ends = [f"One end: {end.sentence}." for branch in diagram.branches for end in branch.ends]
    title = f"The branch along {diagram.field}"
    yield Section(title, ends, [special_table(diagram)], [branch_figure(diagram)], [branch_table(diagram)])
    yield Section("Multipliers", pictures=[multiplier_figure(diagram)])
    yield Section("The cycles", [], [cycle_table(diagram)], [cycle_figure(diagram)], [period_table(diagram)])


def what_figure_9_does_not_show(diagram: Diagram | ModelError, chart: Chart | ModelError) -> Section:
    """The section of the reproduction page: map and branch of its rig, or the sentence why there are none."""
    section = Section("What Fig. 9 does not show")
    if isinstance(chart, ModelError) or isinstance(diagram, ModelError):
        section.text = [f"{error}." for error in (chart, diagram) if isinstance(error, ModelError)]
        return section
    k, c = 0.5 * (chart.rig.k1 + chart.rig.k2), chart.rig.damping_x
    section = zone_section(chart, section.title, "fig_09_zones")
    section.text = [
        "Fig. 9 has the border beyond which the rig squeals by itself, and calls all else stable. Below it a squeal"
        " cycle stands beside the stable equilibrium, down to the fold; a hit takes the rig from one to the other."
        f" Here at k = {k:.3g} N/m with a damping of {c:g} N s/m in x and y: zones over the paper's preloads and"
        " speeds, and the branch of cycles over the friction coefficient.",
        *section.text,
        _zone_text(diagram.zone),
    ]
    section.tables += [special_table(diagram, "fig_09_specials"), cycle_table(diagram, "fig_09_cycles_summary")]
    section.pictures += [branch_figure(diagram, "fig_09_branch"), cycle_figure(diagram, "fig_09_cycles")]
    section.data += [branch_table(diagram, "fig_09_branch"), period_table(diagram, "fig_09_cycles")]
    return section


def zone_section(chart: Chart, title: str = "Zones", name: str = "zones") -> Section:
    """The map of zones with what it says in words."""
    found = chart.map
    text = [_shares_text(chart)]
    hits = found.smallest_hit
    if hits is not None and np.any(found.zone == BISTABLE):
        inside = hits[found.zone == BISTABLE]
        if np.isfinite(inside).any():
            text.append(
                f"In the bistable zone the smallest hit from rest that starts lasting squeal is up to"
                f" {np.nanmax(inside):.3g} N s; hits are interpolated, and within {found.hit_error:.1%} of those"
                " searched for one by one."
            )
    text += [f"No border: {reason}." for reason in found.reasons]
    return Section(title, text, [], [zone_figure(chart, name)], [chart_table(chart, name)])


def special_table(diagram: Diagram, name: str = "specials") -> DataTable:
    """Folds, other bifurcations and both ends of the branch."""
    rows = [
        [kind, value, friction_coefficient(diagram.rig_at(value)), frequency]
        for kind, value, frequency in _special_rows(diagram)
    ]
    return DataTable(name, "Special points and ends", ("what", _column(diagram), "mu [-]", "frequency [Hz]"), rows)


def branch_table(diagram: Diagram, name: str = "branch") -> DataTable:
    """Every point of the branch."""
    columns = [
        "branch", _column(diagram), "mu [-]", "frequency [Hz]", "peak_x [m]", "peak_y [m]", "off_belt_share", "stable",
        "largest_multiplier", *(f"multiplier_{i} {part}" for i in (2, 3, 4) for part in ("re", "im")),
    ]  # fmt: skip
    rows = []
    for number, branch in enumerate(diagram.branches, 1):
        for point in branch.points:
            mu = friction_coefficient(diagram.rig_at(float(point["parameter"])))
            multipliers = [part for m in point["multipliers"][1:] for part in (float(m.real), float(m.imag))]
            numbers = [float(point[name]) for name in ("frequency", "peak_x", "peak_y", "off_belt_share")]
            largest = float(point["largest_multiplier"])
            rows.append([number, float(point["parameter"]), mu, *numbers, bool(point["stable"]), largest, *multipliers])
    return DataTable(name, "Every point of the branch", columns, rows)


def cycle_table(diagram: Diagram, name: str = "cycles_summary") -> DataTable:
    """The cycles at one value of the field, one row each."""
    columns = ("cycle", "frequency [Hz]", "peak_x [m]", "peak_y [m]", "off_belt_share", "multipliers besides 1")
    rows = [
        [diagram.kind_of(c), c.frequency, c.peak_x, c.peak_y, c.off_belt_share, _multipliers_text(c)]
        for c in diagram.cycles
    ]
    return DataTable(name, f"Cycles at {value_text(diagram, diagram.begun_at)}", columns, rows)


def period_table(diagram: Diagram, name: str = "cycles") -> DataTable:
    """One period of each cycle: states, and the contact force."""
    columns = ("cycle", "t [s]", "x - x* [m]", "y - y* [m]", "vx [m/s]", "vy [m/s]", "N [N]")
    rig, rows = diagram.rig_of_cycles, []
    for cycle in diagram.cycles:
        values = np.column_stack(
            [cycle.times, from_rest(rig, cycle.states), cycle.states[:, 2:], normal_force(rig, cycle.states)]
        )
        rows += [[diagram.kind_of(cycle), *row] for row in values.tolist()]
    return DataTable(name, "One period of each cycle", columns, rows)


def chart_table(chart: Chart, name: str = "zones") -> DataTable:
    """Every point of the map."""
    found = chart.map
    f, v = np.meshgrid(chart.preloads, chart.speeds)
    hits = found.smallest_hit if found.smallest_hit is not None else np.full(f.shape, math.nan)
    zones = [NAMES[code] for code in found.zone.ravel().tolist()]
    numbers = (f, v, found.mu, found.fold_mu, found.flutter_mu, hits)
    rows = [
        [*row, name] for row, name in zip(zip(*(a.ravel().tolist() for a in numbers), strict=True), zones, strict=True)
    ]
    columns = ("F [N]", "V [m/s]", "mu [-]", "fold_mu [-]", "flutter_mu [-]", "smallest_hit [N s]", "zone")
    return DataTable(name, "Every point of the map", columns, rows)


def _column(diagram: Diagram) -> str:
    known = declarations(RigParameters)
    unit = known["k1" if diagram.field == "pad_stiffness" else diagram.field].unit or "-"
    return f"{diagram.field} [{unit}]"


def _multipliers_text(cycle: SquealCycle) -> str:
    texts = []
    for m in cycle.multipliers[1:]:
        if abs(m.imag) < 1e-12:
            texts.append(f"{m.real:.6g}")
        elif m.imag > 0.0:
            texts.append(f"{m.real:.6g} ± {m.imag:.6g} i")
    return ", ".join(texts)


def _special_rows(diagram: Diagram) -> Iterable[tuple[str, float, float]]:
    for branch in diagram.branches:
        first, last = branch.ends
        yield f"end: {first.how}", first.parameter, first.frequency
        for special in branch.specials:
            yield special.kind, special.parameter, special.frequency
        yield f"end: {last.how}", last.parameter, last.frequency


def _rig_text(p: RigParameters) -> str:
    names = ("preload", "belt_speed", "k1", "k2", "damping_x", "damping_y")
    known = declarations(RigParameters)
    values = ", ".join(f"{name} = {getattr(p, name):.6g} {known[name].unit}".rstrip() for name in names)
    return f"Rig: {values}; friction coefficient {friction_coefficient(p):.4g}."


def _zone_text(zone: Zone) -> str:
    """Zone and margins in a sentence."""
    words = {"quiet": "no hit starts squeal that lasts", "bistable": "quiet until hit", "squeal": "squeals by itself"}
    borders = []
    for what, fold, flutter, form in (
        ("mu", zone.fold_mu, zone.flutter_mu, ".4f"),
        ("k [N/m]", zone.fold_pad_stiffness, zone.flutter_pad_stiffness, ".4g"),
    ):
        known = [
            f"{name} at {value:{form}}"
            for name, value in (("fold", fold), ("flutter", flutter))
            if math.isfinite(value)
        ]
        borders.append(f"in {what}: {', '.join(known) or 'no border'}")
    return f"Zone: {zone.name} ({words[zone.name]}), mu = {zone.mu:.4f}; borders {'; '.join(borders)}."


def _shares_text(chart: Chart) -> str:
    parts = [f"{NAMES[code]} {chart.share(code):.1%}" for code in (QUIET, BISTABLE, SQUEAL)]
    parts += [f"{NAMES[code]} {chart.share(code):.1%}" for code in NAMES if code < 0 and chart.share(code) > 0.0]
    found = chart.map
    borders = []
    for name, border in (("fold", found.fold_mu), ("flutter threshold", found.flutter_mu)):
        if np.isfinite(border).any():
            borders.append(f"{name} at mu = {_range_text(border)}")
    low, high = float(np.nanmin(found.mu)), float(np.nanmax(found.mu))
    text = f"Shares of the map: {', '.join(parts)}. The friction coefficient is {low:.3f} to {high:.3f}"
    return text + (f", with the {' and the '.join(borders)}." if borders else ".")


def _range_text(values: Any) -> str:
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    return f"{low:.4f}" if high - low < 1e-4 else f"{low:.4f} to {high:.4f}"
