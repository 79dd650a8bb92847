"""The reproduction's pictures, from its computed results."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from squeal_rig.estimation.spectra import REFERENCE
from squeal_rig.model.core.law import friction_law
from squeal_rig.report.paper_style import Picture, picture, style
from squeal_rig.studies.inverse.tradeoff import WEIGHT_ALONG_MASSES, TradeOff
from squeal_rig.studies.reproduction.friction_law import PRELOADS, FrictionExperiment
from squeal_rig.studies.reproduction.inverse import InverseResults
from squeal_rig.studies.reproduction.linear import STIFFNESS_LINES, Locus, ThresholdRow, Values
from squeal_rig.studies.reproduction.nonlinear import ForceCase, PeakCurve, SpectrumCase

_FLOOR_DB = -80.0


def friction_figure(experiment: FrictionExperiment) -> Picture:
    """Fig. 4b."""

    def draw(axes: Any) -> None:
        axis = axes[0, 0]
        for number, preload in enumerate(PRELOADS):
            points = np.array([point for point in experiment.points if point[1] == preload])
            model = experiment.model
            fitted = friction_law(model.coefficients, points[:, 0], preload)
            look = style(number, markers=True)
            axis.plot(
                points[:, 0],
                points[:, 2],
                ls="",
                marker=look["marker"],
                mfc="none",
                color=look["color"],
                label=f"estimated, F = {preload:g} N",
            )
            axis.plot(
                points[:, 0], fitted, ls=look["ls"], color=look["color"], label=f"refitted law, F = {preload:g} N"
            )
        axis.set(xlabel="belt speed V [m/s]", ylabel="friction coefficient $\\mu$", ylim=(0.0, None))
        axis.legend()

    caption = (
        "Fig. 4b: friction coefficient over belt speed, estimated by Eq. (2.2) from the channels of the virtual"
        " rig, and the law refitted to the points."
    )
    return picture("fig_04b_friction", caption, draw, height=3.6)


def locus_figure(locus: Locus) -> Picture:
    """One of Figs. 5 to 8."""

    def draw(axes: Any) -> None:
        k = locus.stiffness / 1e7
        real = np.sort(locus.eigenvalues.real, axis=1)
        imaginary = np.sort(np.abs(locus.eigenvalues.imag), axis=1)[:, [1, 3]]
        left, right = axes[0]
        left.plot(k, real[:, 3], **style(0), label="largest")
        left.plot(k, real[:, 0], **style(1), label="smallest")
        left.set(xlabel="pad stiffness k [10$^7$ N/m]", ylabel="Re $\\lambda$ [1/s]", title="(a)")
        right.plot(k, imaginary[:, 1] / (2e3 * np.pi), **style(0), label="upper mode")
        right.plot(k, imaginary[:, 0] / (2e3 * np.pi), **style(1), label="lower mode")
        right.set(xlabel="pad stiffness k [10$^7$ N/m]", ylabel="|Im $\\lambda$|/2$\\pi$ [kHz]", title="(b)")
        for axis in (left, right):
            for line in STIFFNESS_LINES:
                axis.axvline(line / 1e7, color="0.75", ls="--", lw=0.8)
            axis.axvline(locus.k_cr / 1e7, color="k", ls=":", lw=1.4, label=f"k$_{{cr}}$ = {locus.k_cr / 1e7:.2f}")
            axis.legend()

    caption = (
        f"Fig. {locus.figure}: eigenvalues of the linear model over k1 = k2 at F = {locus.preload:g} N,"
        f" V = {locus.belt_speed:g} m/s; grey dashes: 2, 4, 6e7 N/m."
    )
    return picture(f"fig_{locus.figure:02d}_eigenvalues", caption, draw, columns=2)


def critical_figure(preloads: Values, curves: dict[float, Values], rows: Sequence[ThresholdRow]) -> Picture:
    """Fig. 9."""

    def draw(axes: Any) -> None:
        for number, (axis, (speed, curve)) in enumerate(zip(axes[0], curves.items(), strict=True)):
            axis.plot(preloads, curve / 1e7, **style(0), label="rig")
            points = [row.paper for row in rows if row.paper.belt_speed == speed]
            axis.plot(
                [p.preload for p in points],
                [p.value / 1e7 for p in points],
                "s",
                color="#b2182b",
                mfc="none",
                label="paper",
            )
            for line in STIFFNESS_LINES:
                axis.axhline(line / 1e7, color="0.6", ls="--", lw=0.8)
            axis.set(
                xlabel="preload F [N]",
                ylabel="k$_{cr}$ [10$^7$ N/m]",
                title=f"({'ab'[number]}) V = {speed:g} m/s",
                ylim=(0, 9),
            )
            axis.legend()

    caption = (
        "Fig. 9: critical pad stiffness over preload; unstable above the curve. Grey dashes: 2, 4, 6e7 N/m."
        " Squares: every threshold the paper's text reports."
    )
    return picture("fig_09_critical_stiffness", caption, draw, columns=2)


def map_figures(
    preloads: Values,
    speeds: Values,
    critical: Values,
    stiffnesses: Values,
    growth: dict[float, Values],
    boundary: dict[float, tuple[Values, Values]],
) -> list[Picture]:
    """Beyond the paper: k_cr over (F, V), and growth rate over (F, k) with its boundary (F, k_cr/1e7) at each speed."""

    def draw_critical(axes: Any) -> None:
        axis = axes[0, 0]
        levels = [1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0]
        filled = axis.contourf(preloads, speeds, critical / 1e7, levels=levels, cmap="Greys", extend="both")
        lines = axis.contour(preloads, speeds, critical / 1e7, levels=levels, colors="k", linewidths=0.6)
        axis.clabel(lines, fmt="%g")
        axis.figure.colorbar(filled, ax=axis, label="k$_{cr}$ [10$^7$ N/m]")
        axis.set(xlabel="preload F [N]", ylabel="belt speed V [m/s]")

    def draw_growth(axes: Any) -> None:
        top = max(float(np.max(values)) for values in growth.values())
        for axis, (speed, values) in zip(axes[0], growth.items(), strict=True):
            levels = np.linspace(0.0, top, 8)
            levels[0] = min(1.0, 0.5 * levels[1])  # white is stable, and what hardly grows
            filled = axis.contourf(preloads, stiffnesses / 1e7, values.T, levels=levels, cmap="Greys")
            axis.plot(*boundary[speed], color="#b2182b", lw=1.5, label="k$_{cr}$")
            axis.legend(loc="upper left")
            axis.set(xlabel="preload F [N]", ylabel="k1 = k2 [10$^7$ N/m]", title=f"V = {speed:g} m/s", ylim=(0, 10))
        axes[0, 0].figure.colorbar(filled, ax=list(axes[0]), label="largest Re $\\lambda$ [1/s]")

    return [
        picture(
            "map_critical_stiffness",
            "Beyond the paper: critical pad stiffness over preload and belt speed.",
            draw_critical,
            height=4.0,
        ),
        picture(
            "map_growth_rate",
            "Beyond the paper: growth rate over preload and pad stiffness; white is stable.",
            draw_growth,
            columns=2,
        ),
    ]


def spectra_figure(cases: Sequence[SpectrumCase]) -> Picture:
    """Fig. 10."""
    preloads = sorted({case.preload for case in cases})

    def draw(axes: Any) -> None:
        for number, preload in enumerate(preloads):
            for row, case in enumerate(c for c in cases if c.preload == preload):
                _draw_spectrum(axes[row, number], case)
            axes[0, number].set_title(f"({'ab'[number]}) F = {preload:g} N", loc="left")
            axes[-1, number].set_xlabel("frequency [kHz]")

    caption = (
        "Fig. 10: spectra of x after the transient, Hann window of 1 s, peak amplitude in dB re 1 um, V = 1 m/s."
        " Triangles: super-harmonics found by the program (within 2 % of the fundamental, 20 dB out of the median"
        " around, at most 80 dB below the fundamental)."
    )
    rows = max(sum(case.preload == preload for case in cases) for preload in preloads)
    return picture("fig_10_spectra", caption, draw, rows=rows, columns=len(preloads), height=2.2)


def _draw_spectrum(axis: Any, case: SpectrumCase) -> None:
    shown = case.frequencies <= 6000.0
    level = 20.0 * np.log10(np.maximum(case.amplitudes[shown] / REFERENCE, 10.0 ** (_FLOOR_DB / 20.0)))
    axis.plot(case.frequencies[shown] / 1e3, level, color="k", lw=0.7)
    for harmonic in case.harmonics:
        axis.plot(harmonic.frequency / 1e3, harmonic.level + 6.0, "v", color="#b2182b", ms=5)
        axis.annotate(f"{harmonic.order}f", (harmonic.frequency / 1e3, harmonic.level + 10.0), ha="center", fontsize=8)
    word = "unstable" if case.unstable else "stable"
    text = f"k = {case.stiffness / 1e7:g}e7 N/m, {word}\nf = {case.fundamental:.0f} Hz"
    axis.annotate(text, (0.98, 0.95), xycoords="axes fraction", ha="right", va="top", fontsize=8)
    axis.set(ylim=(_FLOOR_DB, 40.0), ylabel="x [dB re 1 $\\mu$m]")


def force_figure(cases: Sequence[ForceCase]) -> Picture:
    """Fig. 11."""

    def draw(axes: Any) -> None:
        for number, (axis, case) in enumerate(zip(axes[0], cases, strict=True)):
            axis.plot(case.t * 1e3, case.normal_force / 1e3, color="k", lw=1.0)
            off = case.normal_force <= 0.0
            axis.plot(case.t[off] * 1e3, np.zeros(int(off.sum())), ".", color="#b2182b", ms=2, label="off the belt")
            axis.set(
                xlabel="time [ms]", ylabel="N [kN]", title=f"({'ab'[number]}) k1 = k2 = {case.stiffness / 1e7:g}e7 N/m"
            )
            axis.legend(loc="upper right")

    caption = "Fig. 11: normal contact force in squeal at F = 300 N, V = 1 m/s, 10 ms after the transient."
    return picture("fig_11_contact_force", caption, draw, columns=len(cases))


def peak_figure(small: Sequence[PeakCurve], impact: Sequence[PeakCurve]) -> Picture:
    """Fig. 12."""
    stiffnesses = sorted({curve.stiffness for curve in small})

    def draw(axes: Any) -> None:
        for row, curves in enumerate((small, impact)):
            for column, stiffness in enumerate(stiffnesses):
                axis = axes[row, column]
                for number, curve in enumerate(c for c in curves if c.stiffness == stiffness):
                    _draw_peaks(axis, curve, number)
                start = f"{'small' if row == 0 else 'impact'} start, {curves[0].start:g} u"
                axis.set_title(f"({'abc'[column]}) {stiffness / 1e7:g}e7 N/m, {start}", loc="left", fontsize=9)
                axis.set(yscale="log", ylim=(1e-3, 100.0))
                axis.legend(loc="lower right", fontsize=7)
            axes[row, 0].set_ylabel("peak |x - x*| [$\\mu$m]")
        for axis in axes[-1]:
            axis.set_xlabel("preload F [N]")

    caption = (
        "Fig. 12: peak displacement along the belt after the transient, over preload, from a small start and from an"
        " impact (u: static compression). Vertical lines: the rig's own threshold preload from the eigenvalues."
    )
    return picture("fig_12_peak_displacement", caption, draw, rows=2, columns=len(stiffnesses), height=2.9)


def _draw_peaks(axis: Any, curve: PeakCurve, number: int) -> None:
    look = style(number, markers=True)
    axis.plot(
        curve.preloads, np.maximum(curve.peaks * 1e6, 1e-3), ms=3, lw=1.0, label=f"V = {curve.belt_speed:g} m/s", **look
    )
    if curve.threshold is not None and curve.threshold <= curve.preloads[-1]:
        axis.axvline(curve.threshold, color=look["color"], ls=look["ls"], lw=0.8)


def trade_off_figure(inverse: InverseResults) -> Picture:
    """Mean error of the thresholds over the mean error of the frequencies, and over mass."""
    along_weight = [point for point in inverse.curve if point.largest_mass == inverse.curve[0].largest_mass]
    same_weight = [point for point in inverse.curve if point.weight == WEIGHT_ALONG_MASSES]
    along_mass = sorted(same_weight, key=lambda point: point.rig.mass)

    def draw(axes: Any) -> None:
        left, right = axes[0]
        by_frequency = sorted(along_weight, key=lambda point: point.frequency_mean)
        _draw_errors(left, [100.0 * p.frequency_mean for p in by_frequency], by_frequency, inverse, 0)
        _draw_errors(right, [p.rig.mass for p in along_mass], along_mass, inverse, 1)
        left.set(xlabel="linear frequencies, mean error [%]", title="(a)")
        right.set(xlabel="mass [kg]", title="(b)", xscale="log")

    caption = "Beyond the paper: what better thresholds cost in Table 1's frequencies (a) and in mass (b)."
    return picture("trade_off", caption, draw, columns=2)


def _draw_errors(
    axis: Any, at: Sequence[float], points: Sequence[TradeOff], inverse: InverseResults, number: int
) -> None:
    axis.plot(at, [100.0 * point.threshold_mean for point in points], ms=4, **style(number, markers=True))
    axis.axhline(100.0 * inverse.floors.mean, color="0.5", ls=":", label="floor")
    axis.set(ylabel="thresholds, mean error [%]", ylim=(0.0, None))
    axis.legend()
