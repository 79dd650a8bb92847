"""Pictures of a campaign."""

from __future__ import annotations

from itertools import zip_longest
from typing import Any

import numpy as np
from numpy.typing import NDArray

from squeal_rig.configuration.declared import declarations
from squeal_rig.estimation.spectra import amplitude_spectrum
from squeal_rig.experiments.campaign.measuring import BACK, IRREGULAR, OUT, QUIET, SQUEAL, is_unstable
from squeal_rig.experiments.campaign.plans import PAD_STIFFNESS
from squeal_rig.experiments.campaign.summary import Results
from squeal_rig.model.parameters import RigParameters
from squeal_rig.report.paper_style import Picture, legend_below, picture, style

Values = NDArray[np.float64]

_MARKS = {QUIET: ("o", "none"), SQUEAL: ("s", "#b2182b"), IRREGULAR: ("D", "#e08214")}
_OTHER = ("x", "#000000")
_ZONE_COLORS = {"quiet": "#ffffff", "bistable": "#9ecae1", "squeal": "#fcbba1", "not known": "#d9d9d9"}
_TOP_FREQUENCY, _LOWEST = 5000.0, -80.0
_MOST_DRAWN = 5000
# Axes of the operating map, and how many panels it has at most.
_MAP_AXES, _MOST_PANELS = ("preload", "belt_speed"), 6
_MEASURED = {
    "level": "dB re 1 um", "tonality": "dB", "frequency": "Hz", "predicted_growth": "1/s", "onset": "s",
    "duration": "s", "growth": "1/s", "growth_error": "1/s", "decay": "1/s", "decay_error": "1/s",
}  # fmt: skip


def unit_of(name: str) -> str:
    """Unit of a factor or of a measured column, in brackets; empty where it has none."""
    declared = declarations(RigParameters).get("k1" if name == PAD_STIFFNESS else name)
    unit = _MEASURED.get(name, "") if declared is None else declared.unit
    return f" [{unit}]" if unit else ""


def operating_map(results: Results) -> Picture:
    """Verdicts on the zones, over preload and belt speed where both are factors, else over the first two; a panel for
    each value of a third where these are few, else it shifts the marks.
    """
    names = [f.name for f in results.campaign.design.factors]
    if set(_MAP_AXES) <= set(names):
        names = [*_MAP_AXES, *(name for name in names if name not in _MAP_AXES)]
    first, second = names[0], names[1] if len(names) > 1 else names[0]
    third = results.points[names[2]].astype(float) if len(names) > 2 else np.zeros(results.count)
    panels = np.unique(third)
    shown = np.zeros(results.count, dtype=bool)
    shown[:: max(1, results.count // _MOST_DRAWN)] = True
    caption = f"What was seen at each point (marks) over {first} and {second}, on the zones of the cycles (discs)."

    if len(panels) > _MOST_PANELS:
        caption += f" Marks beside each other differ in {names[2]}."
        shift = 0.02 * (third - third.mean()) / np.ptp(third)
        return _wide("operating_map", caption, lambda axes: _draw_map(axes[0, 0], results, first, second, shown, shift))
    if len(panels) == 1:
        return _wide("operating_map", caption, lambda axes: _draw_map(axes[0, 0], results, first, second, shown))

    def draw(axes: Any) -> None:
        for axis, value in zip_longest(axes.flat, panels):
            if value is None:
                axis.remove()
                continue
            _draw_map(axis, results, first, second, shown & (third == value), legend=False)
            axis.set_title(f"{names[2]} = {value:.6g}{unit_of(names[2])}")
        marks: dict[str, Any] = {}
        for axis in axes.flat[: len(panels)]:
            marks |= dict(zip(*axis.get_legend_handles_labels()[::-1], strict=True))
        legend_below(axes[0, 0].figure, list(marks.values()), 8)

    columns = min(3, len(panels))
    caption += f" A panel for each {names[2]}."
    return picture("operating_map", caption, draw, rows=-(-len(panels) // columns), columns=columns, height=3.6)


def _draw_map(
    axis: Any, results: Results, first: str, second: str, shown: Any, shift: Any = None, legend: bool = True
) -> None:
    """Points of a map, as many as are `shown`; `shift` moves them along the first axis, as a share of its span."""
    x, y = results.points[first].astype(float), results.points[second].astype(float)
    if shift is not None:
        x = x + shift * (np.ptp(x) or 1.0)
    if second == first:
        y = np.maximum(results.points["level"].astype(float), _LOWEST)
    zones, verdicts = results.zones, results.points["verdict"]
    for zone, color in _ZONE_COLORS.items():
        inside = shown & (zones == zone)
        if inside.any():
            disc = {"s": 190, "marker": "o", "color": color, "edgecolors": "0.6", "lw": 0.5}
            axis.scatter(x[inside], y[inside], label=f"zone: {zone}", **disc)
    for verdict in dict.fromkeys(verdicts[shown].tolist()):
        mark, color = _MARKS.get(verdict, _OTHER)
        which = shown & (verdicts == verdict)
        kind = {"facecolors": color, "edgecolors": "k"} if mark != "x" else {"color": color}
        axis.scatter(x[which], y[which], s=36, marker=mark, label=verdict, **kind)
    axis.set_xlabel(first + unit_of(first))
    axis.set_ylabel("level [dB re 1 um]" if second == first else second + unit_of(second))
    if legend:
        axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), labelspacing=1.2)


def _wide(name: str, caption: str, draw: Any, height: float = 4.6) -> Picture:
    """One axis as wide as two."""

    def over_both(axes: Any) -> None:
        grid = axes[0, 0].get_gridspec()
        figure = axes[0, 0].figure
        for axis in axes.flat:
            axis.remove()
        draw(np.array([[figure.add_subplot(grid[0, :])]]))

    return picture(name, caption, over_both, columns=2, height=height)


def occurrence_figure(results: Results) -> Picture:
    """How many events have which frequency, weighed by nothing."""
    events = results.main_events

    def draw(axes: Any) -> None:
        frequency = np.asarray(events["frequency"], dtype=float)
        axis = axes[0, 0]
        axis.hist(frequency, bins=np.arange(frequency.min() // 25 * 25, frequency.max() + 50.0, 25.0), color="0.4")
        axis.set_xlabel("frequency of the event [Hz]")
        axis.set_ylabel("events")
        axis = axes[0, 1]
        axis.scatter(frequency, events["level"], s=14, color="k")
        axis.set_xlabel("frequency [Hz]")
        axis.set_ylabel("highest level [dB re 1 um]")

    return picture("occurrence", "Events by frequency, in classes of 25 Hz, and their levels.", draw, columns=2)


def campbell_figure(results: Results) -> Picture:
    """Frequency seen over each factor, beside the eigenvalues'."""
    names = [f.name for f in results.campaign.design.factors][:3]
    points = results.points
    squealing = points["verdict"] == SQUEAL

    def draw(axes: Any) -> None:
        for axis, name in zip(axes[0], names, strict=True):
            axis.plot(points[name][squealing], points["frequency"][squealing], "s", ms=4, color="#b2182b", label="seen")
            if np.isfinite(points["predicted_frequency"]).any():
                axis.plot(points[name], points["predicted_frequency"], "k_", ms=8, label="eigenvalue")
            axis.set_xlabel(name + unit_of(name))
            axis.set_ylabel("frequency [Hz]")
            axis.legend()

    return picture(
        "campbell", "Squeal frequency over each factor, seen and by the eigenvalues.", draw, columns=len(names)
    )


def root_locus(results: Results) -> Picture | None:
    """Growth measured at onset over the eigenvalue's; None where none was measured."""
    events = results.main_events
    if not events or not np.isfinite(events["growth"]).any():
        return None
    row_of = {int(place): i for i, place in enumerate(results.points["place"])}
    rows = np.array([row_of[int(place)] for place in events["place"]])
    predicted = results.points["predicted_growth"][rows]
    growth = np.asarray(events["growth"], dtype=float)

    def draw(axes: Any) -> None:
        axis = axes[0, 0]
        axis.plot(predicted, growth, "ks", ms=4, label="measured at onset")
        low, high = np.nanmin(predicted), np.nanmax(predicted)
        axis.plot([low, high], [low, high], **style(1), label="the eigenvalue's")
        axis.set_xlabel("growth of the eigenvalue [1/s]")
        axis.set_ylabel("growth measured [1/s]")
        axis.legend()
        axis = axes[0, 1]
        axis.plot(growth, events["growth_frequency"], "ks", ms=4, label="measured at onset")
        unstable = is_unstable(results.points)
        axis.plot(
            results.points["predicted_growth"][unstable], results.points["predicted_frequency"][unstable],
            "x", color="#b2182b", label="eigenvalue",
        )  # fmt: skip
        axis.axvline(0.0, color="0.4", ls=":", lw=1.2)
        low, high = axis.get_ylim()
        spare = 0.5 * max(0.0, 0.01 * high - (high - low))  # of few points that agree the differences would fill it
        axis.set_ylim(low - spare, high + spare)
        axis.set_xlabel("growth [1/s]")
        axis.set_ylabel("frequency [Hz]")
        axis.legend()

    return picture(
        "root_locus", "Growth at onset against the eigenvalues' and the root locus of both.", draw, columns=2
    )


def friction_map(results: Results) -> Picture:
    """The friction coefficient at the points, measured where it was, else of the law."""
    points = results.points
    name = "mu_measured" if "mu_measured" in points else "mu"
    factors = [f.name for f in results.campaign.design.factors]

    def draw(axes: Any) -> None:
        axis = axes[0, 0]
        x = points[factors[0]]
        y = points[factors[1]] if len(factors) > 1 else points[name]
        shown = axis.scatter(x, y, c=points[name], s=60, cmap="viridis", edgecolors="k", lw=0.4)
        if len(factors) > 1:
            axis.figure.colorbar(shown, ax=axis, label="$\\mu$")
        axis.set_xlabel(factors[0] + unit_of(factors[0]))
        axis.set_ylabel(factors[1] + unit_of(factors[1]) if len(factors) > 1 else "$\\mu$")

    source = (
        "measured (ratio of means)" if name == "mu_measured" else "of the law that the model has: nothing was measured"
    )
    return _wide("friction_map", f"Friction coefficient at the points, {source}.", draw, 3.6)


def hysteresis_figure(results: Results, place: int, borders: tuple[float, float]) -> Picture:
    """Level over the ramped parameter, up and down, of one point; `borders`: fold and flutter threshold in it."""
    steps = results.steps
    own = steps["place"] == place
    parameter = str(steps["parameter"][own][0])

    def draw(axes: Any) -> None:
        axis = axes[0, 0]
        for number, leg in enumerate((OUT, BACK)):
            which = own & (steps["leg"] == leg)
            level = np.maximum(steps["level"][which].astype(float), _LOWEST)
            axis.plot(steps["value"][which], level, **style(number), label=leg)
        for value, word in zip(borders, ("fold", "flutter threshold"), strict=True):
            if np.isfinite(value):
                axis.axvline(value, color="0.4", ls=":", lw=1.2)
                axis.annotate(
                    word, (value, 0.5), xycoords=("data", "axes fraction"), rotation=90, ha="right", fontsize=8
                )
        axis.set_xlabel(parameter + unit_of(parameter))
        axis.set_ylabel("level [dB re 1 um]")
        axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))

    caption = f"Level on the ramp of {parameter}, out and back, drawn from {_LOWEST:g} dB up."
    return _wide(f"hysteresis_{place}_{parameter}", caption, draw, 3.6)


def spectrogram_figure(x: Values, rate: int, title: str) -> Picture:
    """Spectrogram of x, and a waterfall of its spectra."""
    window = min(len(x), round(0.05 * rate))
    hop = max(1, round(0.01 * rate), len(x) // 600)
    starts = range(0, len(x) - window + 1, hop)
    spectra = []
    for start in starts:
        frequencies, amplitudes = amplitude_spectrum(x[start : start + window], rate)
        spectra.append(20.0 * np.log10(np.maximum(amplitudes / 1e-6, 10.0 ** (_LOWEST / 20.0))))
    shown = frequencies <= _TOP_FREQUENCY
    levels = np.array(spectra)[:, shown]
    times = (np.array(starts) + 0.5 * window) / rate

    def draw(axes: Any) -> None:
        axis = axes[0, 0]
        axis.grid(False)
        drawn = axis.pcolormesh(
            times, frequencies[shown] / 1e3, levels.T, cmap="magma", vmin=_LOWEST, shading="nearest", rasterized=True
        )
        axis.figure.colorbar(drawn, ax=axis, label="x [dB re 1 um]")
        axis.set_xlabel("time at the point [s]")
        axis.set_ylabel("frequency [kHz]")
        axis.grid(False)
        axis = axes[0, 1]
        lines = np.linspace(0, len(times) - 1, min(24, len(times))).astype(int)
        for number, line in enumerate(lines):
            axis.plot(frequencies[shown] / 1e3, levels[line] + 12.0 * number, color="k", lw=0.6)
        axis.set_xlabel("frequency [kHz]")
        axis.set_ylabel("x [dB], each line 12 dB above the one before")

    return picture(
        "worst_point",
        f"{title}: spectrogram, and waterfall from its beginning (below) to its end.",
        draw,
        columns=2,
        height=4.2,
    )
