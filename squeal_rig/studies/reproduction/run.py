"""Computes every result of the paper and writes page, pictures and tables."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from rich.console import Console
from rich.progress import Progress as ProgressBar

from squeal_rig.configuration.declared import declarations
from squeal_rig.errors import ModelError
from squeal_rig.model.parameters import RigParameters
from squeal_rig.report.page import DataTable, Section, write_report
from squeal_rig.studies.hard_squeal.branches import Diagram, branch_diagram
from squeal_rig.studies.hard_squeal.chart import Chart, zone_chart
from squeal_rig.studies.hard_squeal.pages import what_figure_9_does_not_show
from squeal_rig.studies.reproduction import figures, linear, nonlinear, statements
from squeal_rig.studies.reproduction.friction_law import FrictionExperiment, measure_friction
from squeal_rig.studies.reproduction.inverse import InverseResults, solve_inverse
from squeal_rig.studies.reproduction.linear import Locus, ThresholdRow, Values
from squeal_rig.studies.reproduction.nonlinear import ForceCase, PeakCurve, SpectrumCase, TableRow, UndampedRow
from squeal_rig.studies.reproduction.paper import PaperNumbers, paper_numbers
from squeal_rig.studies.reproduction.statements import AGREES, DIFFERS, Statement

#: Damping of the nonlinear runs [N s/m]: the paper has none, where nothing settles; Table 1 is also run without.
DAMPING = 20.0
#: Pad stiffness [N/m] of zones and cycles, and points of their map each way.
HARD_STIFFNESS = 4e7
_CHART = 100
_WITHIN = {"k_cr": 0.08, "frequency": 0.0856, "jump": 0.08}
PAGE = "reproduction.html"

Progress = Callable[[str], None]
T = TypeVar("T")


@dataclass(frozen=True)
class Results:
    """Everything computed; `undamped` is Table 1 with the paper's zero damping."""

    preset: str
    paper: PaperNumbers
    friction: FrictionExperiment
    loci: list[Locus]
    thresholds: list[ThresholdRow]
    preloads: Values
    curves: dict[float, Values]
    speeds: Values
    critical: Values
    stiffnesses: Values
    growth: dict[float, Values]
    spectra: list[SpectrumCase]
    forces: list[ForceCase]
    table: list[TableRow]
    undamped: list[UndampedRow]
    small: list[PeakCurve]
    impact: list[PeakCurve]
    inverse: InverseResults
    chart: Chart | ModelError
    diagram: Diagram | ModelError

    def statements(self) -> list[Statement]:
        """The eight statements of the conclusions, judged."""
        return [
            statements.mode_coupling(self.loci),
            statements.preload_lowers(self.preloads, self.speeds, self.critical),
            statements.speed_raises(self.preloads, self.speeds, self.critical),
            statements.frequencies_similar(self.table),
            statements.superharmonics_when_unstable(self.spectra),
            statements.separation_at_high_stiffness(self.table),
            statements.deviation_with_separation(self.table),
            statements.jumps_at_threshold(self.small),
        ]


def compute(preset: str, progress: Progress) -> Results:
    """Compute everything from a preset; `progress` is told each stage as it begins."""
    p = RigParameters.preset(preset)
    damped = p.replace(damping_x=DAMPING, damping_y=DAMPING)
    paper = paper_numbers()
    preloads, speeds = np.linspace(10.0, 300.0, 59), np.linspace(1.0, 4.0, 13)
    stiffnesses = np.linspace(0.0, 1e8, 51)
    progress("Fig. 4b: friction law from a virtual experiment")
    friction = measure_friction(damped)
    progress("Figs. 5 to 9: eigenvalues and critical stiffness")
    loci = linear.eigenvalue_loci(p)
    curves = dict(
        zip(linear.FIGURE_9_SPEEDS, linear.critical_map(p, preloads, np.array(linear.FIGURE_9_SPEEDS)), strict=True)
    )
    progress("maps of critical stiffness and growth")
    critical = linear.critical_map(p, preloads, speeds)
    coarse = preloads[::2]
    growth = {v: linear.growth_map(p.replace(belt_speed=v), coarse, stiffnesses) for v in linear.FIGURE_9_SPEEDS}
    progress("what Fig. 9 does not show: zones and cycles")
    hard = damped.replace(pad_stiffness=HARD_STIFFNESS)
    chart, diagram = _found(lambda: zone_chart(hard, points=_CHART)), _found(lambda: branch_diagram(hard, "mu0"))
    progress("Fig. 10: spectra")
    spectra = nonlinear.spectrum_cases(damped, paper)
    progress("Fig. 11: contact force")
    forces = nonlinear.force_cases(damped, paper)
    progress("Table 1, damped and undamped")
    table = nonlinear.table_rows(damped, paper)
    undamped = nonlinear.undamped_rows(p, paper)
    small = nonlinear.peak_curves(damped, paper, nonlinear.SMALL_START, progress)
    impact = nonlinear.peak_curves(damped, paper, nonlinear.IMPACT_START, progress)
    progress("inverse problem: floors and trade-off")
    solved = solve_inverse()
    return Results(
        preset, paper, friction, loci, linear.threshold_rows(p, paper), preloads, curves, speeds, critical,
        stiffnesses, growth, spectra, forces, table, undamped, small, impact, solved, chart, diagram,
    )  # fmt: skip


def _found(compute: Callable[[], T]) -> T | ModelError:
    """A result, or the error that stands in its place on the page."""
    try:
        return compute()
    except ModelError as error:
        return error


#: Stages that `compute` tells, for a progress bar.
STAGES = 8 + 2 * 6


def write_results(results: Results, folder: Path) -> Path:
    """Write the page, every picture as PNG and every table as CSV; returns the page's path."""
    sections = list(_sections(results))
    lead = [
        f"Every number and figure of Yavuz and Sen (2023), computed from the preset {results.preset}, beside what"
        " the paper's text reports (its figures' data are not published).",
        f"Linear results are undamped, as in the paper. Nonlinear runs have a damping of {DAMPING:g} N s/m in x and y,"
        " without which nothing settles; Table 1 is given without damping too, as the range of several runs.",
    ]
    page = folder / PAGE
    write_report("The paper, reproduced and corrected", lead, sections, page, force=True)
    return page


def run_reproduction(preset: str, folder: Path, console: Console) -> None:
    """Compute and write everything with a progress bar, and print the statements with their verdicts."""
    with ProgressBar(console=console) as bar:
        task = bar.add_task("starting", total=STAGES)
        results = compute(preset, lambda stage: bar.update(task, advance=1, description=stage))
        bar.update(task, description="figures and page")
        page = write_results(results, folder)
        bar.update(task, description="done")
    for number, statement in enumerate(results.statements(), 1):
        console.print(f"{number}. {statement.text} {statement.verdict}: {statement.evidence}")
    console.print(f"page: {page}")


def _sections(r: Results) -> Iterable[Section]:
    yield Section("Every number of the text", tables=[verdict_table(r)])
    yield Section("The eight statements of the conclusions", tables=[statement_table(r)])
    model, known = r.friction.model, declarations(RigParameters)
    terms = [f"{name} = {value:.4e} {known[name].unit}".rstrip() for name, value in model.coefficients.items()]
    law = (
        f"Refitted: {', '.join(terms)}; RMS residual {model.rms_residual:.1e}"
        f" over {model.operating_points} operating points."
    )
    points = DataTable(
        "fig_04b_friction", "Fig. 4b", ("V [m/s]", "F [N]", "mu estimated", "mu true"), r.friction.points
    )
    yield Section("Friction law (Fig. 4b)", [law], [points], [figures.friction_figure(r.friction)])
    yield Section("Eigenvalues (Figs. 5 to 8)", pictures=[figures.locus_figure(locus) for locus in r.loci])
    critical = figures.critical_figure(r.preloads, r.curves, r.thresholds)
    boundary = {speed: (r.preloads, curve / 1e7) for speed, curve in r.curves.items()}
    maps = figures.map_figures(r.preloads[::2], r.speeds, r.critical[:, ::2], r.stiffnesses, r.growth, boundary)
    yield Section("Critical pad stiffness (Fig. 9) and beyond", pictures=[critical, *maps])
    yield what_figure_9_does_not_show(r.diagram, r.chart)
    yield Section("Spectra (Fig. 10)", tables=[_harmonic_table(r)], pictures=[figures.spectra_figure(r.spectra)])
    yield Section("Contact force (Fig. 11)", pictures=[figures.force_figure(r.forces)])
    yield Section(
        "Peak displacement (Fig. 12)", tables=[_jump_table(r)], pictures=[figures.peak_figure(r.small, r.impact)]
    )
    yield Section("Squeal frequency and contact loss (Table 1)", tables=[_frequency_table(r)])
    floors = (
        "However the unpublished parameters are set, k + D/k is bilinear in preload and speed in a first-order reading,"
        f" and the thresholds' errors cannot be smaller than {r.inverse.floors.largest:.1%} (largest),"
        f" {r.inverse.floors.rms:.1%} (RMS), {r.inverse.floors.mean:.1%} (mean), each for itself. Coming closer to them"
        " costs frequency or mass."
    )
    trade = figures.trade_off_figure(r.inverse)
    yield Section("What any choice of parameters can reach", [floors], [_trade_off_table(r)], [trade])


def verdict_table(r: Results) -> DataTable:
    """Paper, rig, difference and verdict for every number the text reports."""
    rows: list[list[Any]] = []

    def add(what: str, unit: str, paper: float | None, rig: float | None, within: float) -> None:
        rows.append([what, unit, paper, rig, *_difference(paper, rig, within)])

    for row in r.thresholds:
        t = row.paper
        add(
            f"k_cr, F = {t.preload:g} N, V = {t.belt_speed:g} m/s ({t.source})",
            "N/m",
            t.value,
            row.k_cr,
            _WITHIN["k_cr"],
        )
    for line in r.table:
        k, t1 = f"k = {line.paper.k / 1e7:g}e7 N/m (Table 1)", line.paper
        add(f"squeal frequency, linear, {k}", "Hz", t1.f_linear, line.f_linear, _WITHIN["frequency"])
        add(f"squeal frequency, nonlinear, {k}", "Hz", t1.f_nonlinear, line.f_nonlinear, _WITHIN["frequency"])
        loss = f"contact loss in {line.duration:g} s (the paper's length is not given), {k}"
        rows.append([loss, "s", t1.contact_loss_s, line.contact_loss_s, "", "no common length"])
    for case in r.spectra:
        same = AGREES if case.present == case.paper_present else DIFFERS
        what = f"super-harmonics, F = {case.preload:g} N, k = {case.stiffness / 1e7:g}e7 N/m (Fig. 10)"
        rows.append([what, "", _yes(case.paper_present), _yes(case.present), "", same])
    for curve in r.small:
        point = f"k = {curve.stiffness / 1e7:g}e7 N/m, V = {curve.belt_speed:g} m/s"
        what = f"jump of the peak displacement, {point} (Fig. 12)"
        in_range = curve.jump if curve.jump is not None and curve.jump <= r.preloads[-1] else None
        add(what, "N", curve.paper_jump, in_range, _WITHIN["jump"])
    columns = ("what", "unit", "paper", "rig", "difference", "verdict")
    within = (
        f"A number agrees when it lies within {_WITHIN['k_cr']:.0%} (k_cr, jumps) or {_WITHIN['frequency']:.1%}"
        " (frequencies) of the paper's."
    )
    return DataTable("every_number", within, columns, rows)


def _difference(paper: float | None, rig: float | None, within: float) -> tuple[str, str]:
    if paper is None or rig is None or math.isnan(rig):
        return "", AGREES if paper is None and rig is None else DIFFERS
    if paper == 0.0:
        return f"{rig:+.3g}", AGREES if abs(rig) <= 1e-9 else DIFFERS
    share = rig / paper - 1.0
    return f"{share:+.1%}", AGREES if abs(share) <= within else DIFFERS


def _yes(present: bool) -> str:
    return "present" if present else "absent"


def statement_table(r: Results) -> DataTable:
    """The eight statements with verdict and evidence."""
    rows = [[number, s.text, s.verdict, s.evidence] for number, s in enumerate(r.statements(), 1)]
    return DataTable("statements", "", ("", "statement", "verdict", "evidence"), rows)


def _harmonic_table(r: Results) -> DataTable:
    rows = []
    for case in r.spectra:
        lines = ", ".join(f"{h.order}f {h.frequency:.0f} Hz ({h.level:.0f} dB)" for h in case.harmonics) or "none"
        rows.append([case.preload, case.stiffness, case.fundamental, lines])
    return DataTable("fig_10_harmonics", "Super-harmonics", ("F [N]", "k [N/m]", "f [Hz]", "found"), rows)


def _jump_table(r: Results) -> DataTable:
    rows: list[Sequence[Any]] = []
    for small, impact in zip(r.small, r.impact, strict=True):
        row = (small.stiffness, small.belt_speed, small.paper_jump, small.threshold, small.jump, impact.jump)
        rows.append(row)
    columns = (
        "k [N/m]",
        "V [m/s]",
        "paper's jump [N]",
        "threshold [N]",
        "jump, small start [N]",
        "jump, impact start [N]",
    )
    caption = (
        f"Jump: the preload above which the peak exceeds {nonlinear.SQUEAL_COMPRESSIONS:g} static compressions."
        " Looked for up to the parameter's bound, beyond the figure."
    )
    return DataTable("fig_12_jumps", caption, columns, rows)


def _frequency_table(r: Results) -> DataTable:
    rows = []
    for damped, undamped in zip(r.table, r.undamped, strict=True):
        t = damped.paper
        error = abs(t.f_nonlinear - t.f_linear) / t.f_nonlinear
        linear_columns = (t.k, t.f_linear, damped.f_linear)
        f, share = undamped.frequencies, undamped.contact_loss_shares
        nonlinear_columns = (t.f_nonlinear, damped.f_nonlinear, f.min(), f.max(), error, damped.error)
        contact = (t.contact_loss_s, damped.contact_loss_share, share.min(), share.max())
        rows.append([*linear_columns, *nonlinear_columns, *contact])
    columns = (
        "k [N/m]", "f_lin paper [Hz]", "f_lin rig [Hz]", "f_nl paper [Hz]", "f_nl rig [Hz]",
        "f_nl undamped, lowest [Hz]", "f_nl undamped, highest [Hz]", "error paper", "error rig",
        "contact loss paper [s]", "share off belt, rig", "undamped, lowest", "undamped, highest",
    )  # fmt: skip
    caption = (
        f"Table 1 at F = {r.paper.table_preload:g} N, V = {r.paper.table_speed:g} m/s. Without damping the motion is"
        f" chaotic: range of {nonlinear.CHAOTIC_STARTS} runs from starts that are equal to 1e-8."
    )
    return DataTable("table_1", caption, columns, rows)


def _trade_off_table(r: Results) -> DataTable:
    rows = [
        [p.weight, p.largest_mass, p.rig.mass, p.threshold_mean, p.threshold_largest, p.frequency_mean, *p.frequencies]
        for p in r.inverse.curve
    ]
    columns = (
        "weight of frequencies",
        "mass at most [kg]",
        "mass [kg]",
        "thresholds, mean error",
        "thresholds, largest error",
        "linear frequencies, mean error",
        "lowest [Hz]",
        "highest [Hz]",
    )
    return DataTable("trade_off", "Best rigs over the weight of Table 1's frequencies, then over mass", columns, rows)
