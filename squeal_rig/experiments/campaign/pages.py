"""The report of a campaign: one page that needs no other file, and every picture as PNG, every table as CSV beside."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from squeal_rig.errors import ModelError, ParameterError, RecordingError
from squeal_rig.estimation.bands import SOUND_BANDS, harmonics_inside
from squeal_rig.experiments.campaign.figures import (
    campbell_figure,
    friction_map,
    hysteresis_figure,
    occurrence_figure,
    operating_map,
    root_locus,
    spectrogram_figure,
    unit_of,
)
from squeal_rig.experiments.campaign.measuring import (
    FAILED,
    IRREGULAR,
    SQUEAL,
    STOPPED,
    VERDICTS,
    VERDICTS_BY_LEVEL,
    Table,
    start_and_end,
)
from squeal_rig.experiments.campaign.plans import EVENTS, PAD_STIFFNESS
from squeal_rig.experiments.campaign.sensitivity import (
    OUTPUTS,
    even_ranges,
    rig_output,
    sobol_indices,
    squeal_probability,
)
from squeal_rig.experiments.campaign.summary import (
    OPERATING,
    Results,
    contradictions,
    crosstable,
    fit_law,
    load_results,
    signal_of,
)
from squeal_rig.model.cycles.zone_map import NAMES, zone_map
from squeal_rig.model.cycles.zones import zone
from squeal_rig.report.page import DataTable, Section, write_report
from squeal_rig.report.paper_style import Picture

FOLDER, PAGE = "report", "index.html"
_MOST_ROWS, _MOST_LOOPS = 60, 6
# Columns that fit on the page; the files have all.
_POINT_COLUMNS = ("mu", "zone", "predicted_growth", "verdict", "level", "frequency", "squeal_from", "squeal_to", "note")
_EVENT_COLUMNS = (
    "point", "onset", "duration", "frequency", "level", "tonality", "growth", "growth_error", "decay", "decay_error"
)  # fmt: skip
_LOW, _HIGH = SOUND_BANDS["sae_j2521"]


def write_campaign_report(folder: Path) -> Path:
    """Write the report of what is measured so far; returns the page.

    Raises:
        ExperimentError: the folder holds no campaign.
        DiskError: the report cannot be written.
    """
    results = load_results(folder)
    page = folder / FOLDER / PAGE
    write_report(results.campaign.title, _lead(results), _sections(results), page, force=True)
    return page


def _lead(results: Results) -> list[str]:
    campaign = results.campaign
    how = "live, on the ROS graph" if results.live else "by the engine alone"
    lead = [f"{results.count} of {campaign.design.count} points measured {how}. {campaign.note}".strip()]
    if results.count:
        squealing, share = int(results.squealing.sum()), 100.0 * results.occurrence()
        what = (
            f"a tone of at least {campaign.squeal.on_level:g} dB re 1 um between {campaign.squeal.band_low:g} and"
            f" {campaign.squeal.band_high:g} Hz that stands out of the noise beside it and lasts"
            f" {campaign.tones.least_duration:g} s; a line of white noise does so with the probability"
            f" {campaign.tones.false_alarm:g}"
            if campaign.measure == EVENTS
            else f"motion of at least {campaign.squeal.on_level:g} dB re 1 um RMS along the belt, about the equilibrium"
            " and at all frequencies, in which the pad leaves the belt or the equilibrium is unstable: no tones are"
            " followed"
        )
        lead.append(
            f"{squealing} points squeal, {share:.3g} % of those judged{_apart(results)}. Squeal is {what}. Levels are"
            " of displacement: no sound pressure is known here."
        )
    return lead


def _apart(results: Results) -> str:
    """Points that are neither quiet nor squeal, in words."""
    counts = [(word, int(np.sum(results.points["verdict"] == word))) for word in (IRREGULAR, STOPPED, FAILED)]
    told = ", ".join(f"{count} {word}" for word, count in counts if count)
    return f" ({told})" if told else ""


def _sections(results: Results) -> list[Section]:
    sections = []
    if results.count:
        sections += [_map_section(results), _event_section(results)]
        if results.steps:
            sections.append(_ramp_section(results))
        sections += [_worst_section(results), _friction_section(results)]
        if results.campaign.scatter:
            sections.append(_scatter_section(results))
    return [*sections, _provenance_section(results)]


def _map_section(results: Results) -> Section:
    text = contradictions(results) or ["What was seen and what is predicted go together at every point."]
    if results.no_zone:
        text.append(f"No zones: {results.no_zone}.")
    meant = VERDICTS if results.campaign.measure == EVENTS else VERDICTS_BY_LEVEL
    text += [f"{name}: {words}." for name, words in meant.items() if name in results.points["verdict"]]
    table = DataTable(
        "predicted", "Seen against predicted, number of points",
        ("zone by the cycles", "eigenvalues", "seen", "points"), crosstable(results),
    )  # fmt: skip
    points = {**results.points, "zone": results.zones}
    factors = [f.name for f in results.campaign.design.factors]
    ramped = {phase.parameter for phase in results.campaign.protocol if phase.kind == "ramp"}
    # Where a ramp found squeal is a value of what it changed.
    units = dict.fromkeys(("squeal_from", "squeal_to"), unit_of(*ramped)) if len(ramped) == 1 else {}
    shown = _table("points", "Points", _some(points, (*factors, *_POINT_COLUMNS)), _MOST_ROWS, units)
    all_points = _table("points_all", "Points", points)
    pictures = [operating_map(results)]
    if (results.points["verdict"] == SQUEAL).any():
        pictures.append(campbell_figure(results))
    return Section("Operating map", text, [table, shown], pictures, [all_points])


def _event_section(results: Results) -> Section:
    events = results.main_events
    if not events:
        return Section("Events", ["No event." if results.campaign.measure == EVENTS else "Tones were not followed."])
    inside = [
        " ".join(str(n) for n in harmonics_inside(float(f), _LOW, _HIGH)[:3]) + " ..." for f in events["frequency"]
    ]
    column = f"orders in {_LOW / 1e3:g}-{_HIGH / 1e3:g} kHz"
    shown = _table(
        "events",
        "Events that are no harmonic of a louder one",
        _some({**events, column: np.array(inside)}, (*_EVENT_COLUMNS, column)),
        _MOST_ROWS,
    )
    durations = np.asarray(events["duration"], dtype=float)
    text = [
        f"{len(durations)} events of {durations.min():.3g} to {durations.max():.3g} s. Growth and decay are given where"
        " the amplitude is an exponential over at least one neper, within 0.05 nepers."
    ]
    pictures = [occurrence_figure(results)]
    locus = root_locus(results)
    if locus is not None:
        pictures.append(locus)
    return Section("Events", text, [shown], pictures, [_table("events_all", "All events", results.events)])


def _ramp_section(results: Results) -> Section:
    pictures: list[Picture] = []
    rows: list[list[Any]] = []
    text = ["A ramp is a staircase: each step is held, and judged at its end."]
    steps = results.steps
    for row, place in enumerate(results.points["place"][:_MOST_ROWS]):  # the files have all
        own = steps["place"] == place
        for ramp in np.unique(steps["ramp"][own]).tolist():
            which = {name: values[own & (steps["ramp"] == ramp)] for name, values in steps.items()}
            parameter = str(which["parameter"][0])
            try:
                borders = _borders(results, row, parameter, np.unique(which["value"].astype(float)))
            except (ModelError, ParameterError) as error:
                borders = math.nan, math.nan
                text.append(
                    f"Point {which['point'][0]}, {parameter}: no borders are computed: {str(error).rstrip('.')}."
                )
            hold = [phase for phase in results.campaign.protocol if phase.kind == "ramp"][int(ramp) - 1].duration
            rows.append(_loop(which, borders, hold))
            if len(pictures) < _MOST_LOOPS:
                pictures.append(hysteresis_figure(replace(results, steps=which), int(place), borders))
    columns = (
        "point", "parameter", "squeals from (out)", "flutter threshold", "off [%]",
        "quiet from (back)", "fold", "off [%]", "step there", "hold [s]",
    )  # fmt: skip
    table = DataTable("ramps", "Where squeal starts and ends on each ramp", columns, rows)
    return Section(
        "Ramps", text, [table], pictures,
        [_table("steps_all", "Steps of the ramps", steps)],
    )  # fmt: skip


def _loop(steps: Table, borders: tuple[float, float], hold: float) -> list[Any]:
    """A row on one ramp, of its steps."""
    values = steps["value"].astype(float)
    start, end = start_and_end(values.tolist(), steps["leg"].tolist(), steps["squealing"].tolist())
    values = np.unique(values)
    near = max(1, int(np.searchsorted(values, start))) if math.isfinite(start) else 1
    step = float(values[near] - values[near - 1]) if len(values) > near else math.nan
    fold, flutter = borders
    return [
        int(steps["point"][0]), str(steps["parameter"][0]), start, flutter, 100.0 * (start / flutter - 1.0), end, fold,
        100.0 * (end / fold - 1.0), step, hold,
    ]  # fmt: skip


def _borders(results: Results, row: int, parameter: str, values: NDArray[np.float64]) -> tuple[float, float]:
    """Fold and flutter threshold along a ramp at a point; nan where there is none. Of an operating parameter, the first
    of the ramp's values (n,) beyond each.
    """
    rig = results.campaign.rig({f.name: float(results.points[f.name][row]) for f in results.campaign.design.factors})
    if parameter == PAD_STIFFNESS:
        found = zone(rig)
        return found.fold_pad_stiffness, found.flutter_pad_stiffness
    if parameter in OPERATING:
        zones = np.array([NAMES[int(code)] for code in zone_map(rig, **{parameter: values}).zone])  # type: ignore[arg-type]
        return _border(values, zones == "quiet"), _border(values, zones == "squeal")
    return math.nan, math.nan


def _border(values: NDArray[np.float64], inside: NDArray[np.bool_]) -> float:
    """Value (n,) at the edge of those inside, nan where there is no edge or more than one."""
    edges = np.flatnonzero(np.diff(inside.astype(int)))
    if len(edges) != 1:
        return math.nan
    return float(values[edges[0] + 1 if inside[-1] else edges[0]])


def _worst_section(results: Results) -> Section:
    row = results.worst()
    if row is None:
        return Section("Worst point", ["No point squeals."])
    factors = [f.name for f in results.campaign.design.factors]
    words = ", ".join(f"{name} = {results.points[name][row]:.5g}" for name in factors)
    title = f"Point {results.points['point'][row]} ({words}), {results.points['level'][row]:.1f} dB re 1 um"
    try:
        x, rate = signal_of(results, row)
    except RecordingError as error:
        return Section("Worst point", [f"{title}: no signal to show: {str(error).rstrip('.')}."])
    return Section("Worst point", [f"{title}."], pictures=[spectrogram_figure(x, rate, "Loudest point")])


def _friction_section(results: Results) -> Section:
    section, fit = Section("Friction", pictures=[friction_map(results)]), fit_law(results)
    if fit is None:
        section.text = [
            "No refit of the law: it takes friction measured at quiet points of several preloads and speeds."
        ]
        return section
    base = results.campaign.base
    rows = [[name, value, fit.half_widths[name], getattr(base, name)] for name, value in fit.coefficients.items()]
    columns = ("coefficient", "refitted", "half of the 95 % interval of the scatter", "of the rig that was set")
    section.tables = [DataTable("friction_law", f"The law refitted to {fit.count} quiet points", columns, rows)]
    drift = "no drift" if abs(fit.neighbours) <= fit.bound else "a drift, or a term that the law lacks"
    section.text = [
        "What is off alike at all points, as the zero of a torque transducer, is in no scatter: the intervals leave it"
        " out (`friction/model` has it).",
        f"Residuals: {fit.rms:.2g} RMS, the largest {fit.largest:.2g} of their standard deviations; neighbours in the"
        f" order correlate by {fit.neighbours:+.2f}, within {fit.bound:.2f} by chance alone: {drift}.",
    ]
    return section


def _scatter_section(results: Results) -> Section:
    """Which parameter's scatter from rig to rig matters, about the rig that factors were changed on."""
    rig, scatter = results.campaign.base, results.campaign.scatter
    share, error = squeal_probability(rig, scatter)
    text = [
        f"Scatter from rig to rig, as a share: {', '.join(f'{name} {value:g}' for name, value in scatter.items())}."
        f" So {100.0 * share:.3g} % (+- {100.0 * error:.2g}) of rigs squeal by themselves at F = {rig.preload:g} N,"
        f" V = {rig.belt_speed:g} m/s, k = {0.5 * (rig.k1 + rig.k2):.4g} N/m.",
        "Indices: the share of an output's variance that a parameter alone explains (first), and that goes once it is"
        " known together with all others (total). Half widths are of 95 % intervals.",
    ]
    rows: list[list[Any]] = []
    for output, samples in OUTPUTS.items():
        try:
            found = sobol_indices(rig_output(rig, output), even_ranges(rig, scatter), samples)
        except (ModelError, ParameterError) as refused:
            text.append(f"{output}: {refused}.")
            continue
        text.append(
            f"{output}: {found.mean:.5g}, standard deviation {found.std:.2g};"
            f" it does not exist at {100.0 * found.left_out:.2g} % of the samples."
        )
        columns = (found.names, found.first, found.first_confidence, found.total, found.total_confidence)
        rows += [[output, name, *map(float, numbers)] for name, *numbers in zip(*columns, strict=True)]
    header = ("output", "parameter", "first", "half width", "total", "half width")
    return Section("Sensitivity and scatter", text, [DataTable("sensitivity", "Sobol indices", header, rows)])


def _provenance_section(results: Results) -> Section:
    first = results.entries[0]
    rows = [["plan", results.campaign.crc], *([k, str(v)] for k, v in first.get("provenance", {}).items())]
    runs = [
        [_moment(entry["time"]), entry["what"], str(entry.get("outcome", "")), str(entry.get("done", ""))]
        for entry in results.entries
        if entry["what"] in ("campaign", "run started", "run ended", "resumed", "bag")
    ]
    tables = [
        DataTable("provenance", "What it was", ("what", "value"), rows),
        DataTable("runs", "When it ran, and how each run ended", ("time", "what", "outcome", "points done"), runs),
    ]
    rig = results.campaign.base.as_mapping()
    tables.append(
        DataTable(
            "rig", "The rig that factors were changed on", ("parameter", "value"), [[k, v] for k, v in rig.items()]
        )
    )
    lines = [[line.replace(" ", "\N{NO-BREAK SPACE}")] for line in results.campaign.text.splitlines()]
    tables.append(DataTable("plan", "The plan as it was run", ("line",), lines))
    return Section("Provenance", tables=tables)


def _moment(seconds: float) -> str:
    return f"{datetime.fromtimestamp(seconds, timezone.utc):%Y-%m-%d %H:%M:%S} UTC"


def _table(
    name: str, caption: str, table: Table, most: int | None = None, units: Mapping[str, str] | None = None
) -> DataTable:
    columns = list(table)
    count = len(table[columns[0]])
    if most is not None and count > most:
        caption += f" (the first {most} of {count}; all of them in {name}_all.csv)"
    rows = [[_plain(table[column][i]) for column in columns] for i in range(min(count, most or count))]
    # The files have the names of the columns as they are kept.
    return DataTable(
        name, caption, columns, rows, [column + (units or {}).get(column, unit_of(column)) for column in columns]
    )


def _some(table: Table, names: tuple[str, ...]) -> Table:
    """Those columns of a table that it has and that say anything."""
    kept = {name: table[name] for name in names if name in table}
    return {
        name: values for name, values in kept.items()
        if not (values.dtype.kind == "f" and np.isnan(values).all()) and not (name == "note" and not any(values))
    }  # fmt: skip


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value
