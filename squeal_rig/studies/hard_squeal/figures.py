"""Pictures of branches, multipliers, cycles and zones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from squeal_rig.configuration.declared import declarations
from squeal_rig.model.core.law import friction_coefficient
from squeal_rig.model.cycles.branch import Branch
from squeal_rig.model.cycles.path import PAD_STIFFNESS
from squeal_rig.model.cycles.tracing import FLUTTER
from squeal_rig.model.cycles.zone_map import BISTABLE, NOT_IN_CONTACT, QUIET, SQUEAL, UNKNOWN
from squeal_rig.model.parameters import RigParameters
from squeal_rig.report.paper_style import Picture, legend_below, picture
from squeal_rig.studies.hard_squeal.branches import Diagram, Values, from_rest, normal_force
from squeal_rig.studies.hard_squeal.chart import Chart

#: Fill and hatch of each zone, distinct in grey too.
_FILLS = {
    UNKNOWN: ("none", "not known", ".."),
    NOT_IN_CONTACT: ("none", "no contact", "xx"),
    QUIET: ("#ffffff", "quiet whatever happens", ""),
    BISTABLE: ("#d9e6f2", "bistable: quiet until hit", ""),
    SQUEAL: ("#f0c9c4", "squeals by itself", "////"),
}
_STABLE, _UNSTABLE = "#000000", "#b2182b"
# Room around a label, as a share of the picture.
_CLEAR = 0.03
_MARKS = {"fold": "o", "period doubling": "s", "Neimark-Sacker": "^"}
_HATCH_COLOR, _HIT = "#d79a93", "#2166ac"


def axis_of(diagram: Diagram) -> tuple[str, float, float]:
    """Label of the field's axis, and scale and shift from the field to it: mu0 is shown as the friction coefficient."""
    if diagram.field == "mu0":
        return "friction coefficient $\\mu$ (by mu0)", 1.0, friction_coefficient(diagram.rig) - diagram.rig.mu0
    if diagram.field == PAD_STIFFNESS:
        return "pad stiffness k [10$^7$ N/m]", 1e-7, 0.0
    unit = declarations(RigParameters)[diagram.field].unit
    return diagram.field + (f" [{unit}]" if unit else ""), 1.0, 0.0


def value_text(diagram: Diagram, value: float) -> str:
    """A value of the field in words, with the friction coefficient that mu0 gives."""
    if diagram.field == "mu0":
        return f"mu = {value + axis_of(diagram)[2]:.6g} (mu0 = {value:.6g})"
    unit = declarations(RigParameters)["k1" if diagram.field == PAD_STIFFNESS else diagram.field].unit
    return f"{diagram.field} = {value:.6g} {unit}".rstrip()


def branch_figure(diagram: Diagram, name: str = "branch") -> Picture:
    """Peak of x and frequency along the branches, the equilibrium, the folds, and the zones behind."""
    label, scale, shift = axis_of(diagram)
    curves, over = [_curve(diagram, branch) for branch in diagram.branches], scale * diagram.values + shift

    def draw(axes: Any) -> None:
        left, right = axes[0]
        for axis in (left, right):
            _shade(axis, over, diagram.zones)
            axis.axvline(scale * _own_value(diagram) + shift, color="0.45", ls=(0, (1, 2)), lw=1.0)
            axis.set(xlabel=label, xlim=(over[0], over[-1]))
        _equilibrium(left, over, diagram.zones)
        for branch, curve in zip(diagram.branches, curves, strict=True):
            curve.draw(left, curve.peak)
            curve.draw(right, curve.frequency)
            for end, i in zip(branch.ends, (0, -1), strict=True):
                if end.how == FLUTTER:  # the linear mode at its threshold, of any amplitude up to separation
                    text = "linear mode at its threshold"
                    left.plot([curve.at[i]] * 2, [0.0, curve.peak[i]], ":", color=_UNSTABLE, lw=1.4, label=text)
        top = max(float(curve.peak.max()) for curve in curves)
        left.set(ylabel="peak of x from rest [$\\mu$m]", title="(a)", ylim=(-0.03 * top, 1.45 * top))
        both = np.concatenate([curve.frequency for curve in curves])
        room = 0.05 * float(np.ptp(both)) or 1.0
        right.set(ylabel="frequency [Hz]", title="(b)", ylim=(both.min() - room, both.max() + 6.0 * room))
        _one_of_each(left, "upper left")
        _zone_legend(right, np.unique(diagram.zones).tolist())

    caption = (
        "(a) Peak displacement along the belt of the squeal cycle (solid) and of the unstable cycle (dashed), in the"
        " bistable zone the separatrix; both meet in a fold. The equilibrium lies at zero. (b) Their frequency. Fine"
        " dots: the rig's own value."
    )
    return picture(name, caption, draw, columns=2, height=3.8)


def multiplier_figure(diagram: Diagram, name: str = "multipliers") -> Picture:
    """Multipliers besides 1 along the branches, in the complex plane and as their largest modulus."""
    label, _, _ = axis_of(diagram)
    points = np.concatenate([branch.points for branch in diagram.branches])

    def draw(axes: Any) -> None:
        left, right = axes[0]
        turn = np.linspace(0.0, 2.0 * np.pi, 361)
        left.plot(np.cos(turn), np.sin(turn), "-", color="0.5", lw=1.0, label="unit circle")
        stable = points["stable"]
        for mask, color, marker, text in (
            (stable, _STABLE, "o", "stable cycle"),
            (~stable, _UNSTABLE, "x", "unstable cycle"),
        ):
            values = points["multipliers"][mask][:, 1:].ravel()
            left.plot(values.real, values.imag, marker, color=color, ms=3.0, mfc="none", mew=0.7, ls="", label=text)
        left.set(xlabel="Re", ylabel="Im", title="(a)")
        left.set_aspect("equal", adjustable="datalim")
        left.legend(loc="upper left")
        right.axhline(1.0, color="0.5", lw=1.0)
        for branch in diagram.branches:
            curve = _curve(diagram, branch)
            curve.draw(right, curve.largest)
        right.set(xlabel=label, ylabel="largest modulus", title="(b)")
        right.set_ylim(0.0, 1.1 * float(points["largest_multiplier"].max()))
        _one_of_each(right, "best")

    caption = (
        "Multipliers of the cycles besides the 1 along the flow: (a) in the complex plane, three marks a point of the"
        " branch; (b) the largest. A cycle is stable where all lie within the unit circle; at a fold one passes 1."
    )
    return picture(name, caption, draw, columns=2, height=3.8)


def cycle_figure(diagram: Diagram, name: str = "cycles") -> Picture:
    """The cycles at one value of the field: their path in the x-y plane, and the contact force over a period."""
    rig = diagram.rig_of_cycles
    edge = 1e6 * float(from_rest(rig, np.array([[0.0, rig.pretension_length, 0.0, 0.0]]))[0, 1])

    def draw(axes: Any) -> None:
        left, right = axes[0]
        for cycle in diagram.cycles:
            color, line = (_STABLE, "-") if cycle.stable else (_UNSTABLE, "--")
            text = f"{diagram.kind_of(cycle)}, {cycle.frequency:.1f} Hz"
            path = 1e6 * from_rest(rig, _closed(cycle.states))
            left.plot(path[:, 0], path[:, 1], color=color, ls=line, lw=1.3, label=text)
            times = 1e3 * np.append(cycle.times, cycle.period)
            right.plot(times, normal_force(rig, _closed(cycle.states)), color=color, ls=line, lw=1.3, label=text)
        left.axhline(edge, color="0.4", lw=1.0, ls=":")
        left.annotate("off the belt above", (0.02, edge), xycoords=("axes fraction", "data"), va="bottom", fontsize=8)
        left.plot(0.0, 0.0, "+", color="k", ms=8, label="equilibrium")
        rest = normal_force(rig, np.array([[0.0, rig.pretension_length - edge * 1e-6, 0.0, 0.0]]))[0]
        right.axhline(rest, color="0.4", lw=1.0, ls=":", label=f"at rest, {rest:.4g} N")
        left.set(xlabel="x from rest [$\\mu$m]", ylabel="y from rest [$\\mu$m]", title="(a)")
        right.set(xlabel="time [ms]", ylabel="contact force N [N]", title="(b)")
        for axis in (left, right):
            low, high = axis.get_ylim()
            axis.set_ylim(low, high + 0.28 * (high - low))
            axis.legend(loc="upper right", ncols=2 if axis is left else 1)

    where = value_text(diagram, diagram.begun_at)
    caption = f"Cycles at {where}: (a) path of the pad along (x) and away from (y) the belt, (b) contact force."
    return picture(name, caption, draw, columns=2, height=3.8)


def zone_figure(chart: Chart, name: str = "zones") -> Picture:
    """The three zones over preload and belt speed, lines of equal smallest hit, and the flutter threshold."""

    def draw(axes: Any) -> None:
        axis, found = axes[0, 0], chart.map
        borders: list[Values] = []
        for code in np.unique(found.zone).tolist():
            fill, _, hatch = _FILLS[code]
            inside = np.where(found.zone == code, 1.0, 0.0)
            area = axis.contourf(
                chart.preloads, chart.speeds, inside, levels=[0.5, 1.5], colors=[fill], hatches=[hatch or None]
            )
            # Before matplotlib 3.8 a filled contour was several collections.
            for part in [area] if hasattr(area, "set_edgecolor") else area.collections:
                part.set_edgecolor(_HATCH_COLOR)
                part.set_linewidth(0.0)
        for border, color, width in ((found.fold_mu, _STABLE, 1.6), (found.flutter_mu, _UNSTABLE, 2.0)):
            margin = found.mu - border
            if np.isfinite(margin).all() and margin.min() < 0.0 < margin.max():
                line = axis.contour(chart.preloads, chart.speeds, margin, levels=[0.0], colors=color, linewidths=width)
                borders += _pieces(line)
        _hit_lines(axis, chart, borders)
        axis.set(xlabel="preload F [N]", ylabel="belt speed V [m/s]")
        axis.grid(visible=False)
        _chart_legend(axis, chart)

    caption = (
        "Zones over preload and belt speed. Red: the flutter threshold, the one border that eigenvalues, and the paper,"
        " know. Blue: smallest hit from rest that starts lasting squeal [N s], in the best direction. Black, where it"
        " lies in the picture: the fold, below which nothing squeals."
    )
    return picture(name, caption, draw, height=4.8)


def _hit_lines(axis: Any, chart: Chart, borders: Sequence[Values]) -> None:
    """Lines of equal smallest hit, labelled [N s] where there is room beside each other and the borders."""
    from matplotlib.ticker import MaxNLocator

    found = chart.map
    if found.smallest_hit is None:
        return
    hits = np.where(found.zone == BISTABLE, found.smallest_hit, np.nan)
    if not np.isfinite(hits).any():
        return
    low, high = float(np.nanmin(hits)), float(np.nanmax(hits))
    levels = np.asarray(MaxNLocator(10, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high))
    levels = levels[(levels > max(low, 0.0)) & (levels < high)]
    if len(levels):
        lines = axis.contour(chart.preloads, chart.speeds, hits, levels=levels, colors=_HIT, linewidths=0.9)
        places = _label_places(_pieces(lines), borders, chart)
        if places:
            axis.clabel(lines, fmt=lambda value: f"{value:.4g}", fontsize=8, manual=places)


def _label_places(lines: Sequence[Values], borders: Sequence[Values], chart: Chart) -> list[tuple[float, float]]:
    """One place on each line (n, 2) for its label, near the falling diagonal: none where other lines or edges are."""
    origin = np.array([chart.preloads[0], chart.speeds[0]])
    size = np.array([np.ptp(chart.preloads), np.ptp(chart.speeds)])
    scaled = [(line - origin) / size for line in lines]
    taken = [(line - origin) / size for line in borders]
    places = []
    for i, line in enumerate(scaled):
        others = np.concatenate([*scaled[:i], *scaled[i + 1 :], *taken, np.full((1, 2), np.inf)])
        clear = [np.hypot(*(others - q).T).min() > _CLEAR for q in line]
        free = line[((line > 0.06) & (line < 0.94)).all(axis=1) & clear]
        if len(free):
            best = free[np.argmin(np.abs(free.sum(axis=1) - 1.0))]
            places.append(tuple((origin + best * size).tolist()))
    return places


def _pieces(contours: Any) -> list[Values]:
    """The lines (n, 2) of a contour plot, each piece for itself."""
    return [piece for level in contours.allsegs for piece in level if len(piece)]


def _own_value(diagram: Diagram) -> float:
    rig = diagram.rig
    return 0.5 * (rig.k1 + rig.k2) if diagram.field == PAD_STIFFNESS else float(getattr(rig, diagram.field))


def _closed(states: Values) -> Values:
    return np.vstack([states, states[:1]])


def _shade(axis: Any, at: Values, zones: Any) -> None:
    """Fill the zones behind a diagram."""
    edges = np.concatenate([[0], np.flatnonzero(np.diff(zones)) + 1, [len(zones) - 1]])
    for first, last in pairwise(edges.tolist()):
        fill, _, hatch = _FILLS[int(zones[first])]
        axis.axvspan(at[first], at[last], facecolor=fill, hatch=hatch, edgecolor=_HATCH_COLOR, lw=0.0, zorder=0)


def _equilibrium(axis: Any, at: Values, zones: Any) -> None:
    """The equilibrium at zero: solid where stable."""
    for kinds, line in (((QUIET, BISTABLE), "-"), ((SQUEAL,), "--")):
        axis.plot(at, np.where(np.isin(zones, kinds), 0.0, np.nan), line, color=_HIT, lw=1.8, label="equilibrium")


@dataclass(frozen=True)
class _Curve:
    """What is drawn of a branch, along it: its points with the special ones between them, where curves change style."""

    at: Values
    peak: Values
    frequency: Values
    largest: Values
    stable: NDArray[np.bool_]
    special: NDArray[np.bool_]
    kinds: tuple[str, ...]

    def draw(self, axis: Any, values: Values) -> None:
        """Draw values over the field, solid where the cycle is stable and dashed where not, and mark special points."""
        for kind, color, line, text in (
            (self.stable, _STABLE, "-", "squeal cycle, stable"),
            (~self.stable, _UNSTABLE, "--", "unstable cycle"),
        ):
            # A special point belongs to both sides; a change without one is drawn with the point before it.
            shown = kind | self.special
            shown[:-1] |= kind[1:] & ~self.special[1:] & ~self.special[:-1]
            if np.any(kind & ~self.special):
                at, drawn = np.where(shown, self.at, np.nan), np.where(shown, values, np.nan)
                axis.plot(at, drawn, line, color=color, lw=1.4, label=text)
        for i, name in zip(np.flatnonzero(self.special), self.kinds, strict=True):
            axis.plot(self.at[i], values[i], _MARKS[name], color="k", mfc="w", ms=6, zorder=5, label=name)


def _curve(diagram: Diagram, branch: Branch) -> _Curve:
    points, (_, scale, shift) = branch.points, axis_of(diagram)
    stable = points["stable"].copy()
    for end, last, before in zip(branch.ends, (0, -1), (1, -2), strict=True):
        if end.how == FLUTTER and len(stable) > 1:
            stable[last] = stable[before]  # the linear mode, whose multiplier is 1 but for rounding
    columns = np.column_stack(
        [points["parameter"], points["peak_x"], points["frequency"], points["largest_multiplier"], stable]
    )
    spans = [float(np.ptp(points[name])) or 1.0 for name in ("parameter", "frequency")]
    rows: list[tuple[int, str, list[float]]] = []
    for special in branch.specials if len(points) > 1 else ():
        away = np.hypot(
            (points["parameter"] - special.parameter) / spans[0], (points["frequency"] - special.frequency) / spans[1]
        )
        # It lies between the two neighbours that are nearest together; its peak by the share of the way in frequency.
        i = int(np.argmin(away[:-1] + away[1:]))
        first, second = columns[i], columns[i + 1]
        apart = second[2] - first[2]
        share = (special.frequency - first[2]) / apart if apart != 0.0 else 0.5
        largest = float(np.abs(special.multipliers[1:]).max())
        peak = first[1] + share * (second[1] - first[1])
        rows.append((i + 1, special.kind, [special.parameter, peak, special.frequency, largest, second[4]]))
    rows.sort(key=lambda row: row[0])
    special_points = np.zeros(len(columns), dtype=np.bool_)
    if rows:
        places = [place for place, _, _ in rows]
        columns = np.insert(columns, places, [values for _, _, values in rows], axis=0)
        special_points = np.insert(special_points, places, True)
    at, peaks, frequency, largest_modulus, kinds = columns.T
    names = tuple(name for _, name, _ in rows)
    return _Curve(scale * at + shift, 1e6 * peaks, frequency, largest_modulus, kinds > 0.5, special_points, names)


def _one_of_each(axis: Any, where: str) -> None:
    """A legend without repetitions."""
    handles, labels = axis.get_legend_handles_labels()
    known = dict(zip(reversed(labels), reversed(handles), strict=True))
    axis.legend([known[text] for text in dict.fromkeys(labels)], list(dict.fromkeys(labels)), loc=where)


def _patches(codes: list[int]) -> list[Any]:
    from matplotlib.patches import Patch

    return [
        Patch(facecolor=_FILLS[code][0], hatch=_FILLS[code][2], edgecolor="0.6", label=_FILLS[code][1])
        for code in codes
    ]


def _zone_legend(axis: Any, codes: list[int]) -> None:
    axis.legend(handles=_patches(codes), loc="upper right")


def _chart_legend(axis: Any, chart: Chart) -> None:
    from matplotlib.lines import Line2D

    codes = [QUIET, BISTABLE, SQUEAL, *(code for code in (NOT_IN_CONTACT, UNKNOWN) if chart.share(code) > 0.0)]
    patches = _patches(codes)
    for patch, code in zip(patches, codes, strict=True):
        patch.set_label(f"{patch.get_label()}, {chart.share(code):.0%}")
    lines = [
        Line2D([], [], color=_UNSTABLE, lw=2.0, label="flutter threshold: all that the paper knows"),
        Line2D([], [], color=_HIT, lw=0.9, label="smallest hit [N s]"),
    ]
    legend_below(axis.figure, [*patches, *lines], 2)
