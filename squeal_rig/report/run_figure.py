"""One picture of a recorded run."""

from __future__ import annotations

import math
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from squeal_rig.analysis.segments import NOT_AVAILABLE, Analysis, Segment
from squeal_rig.configuration.new_files import check_free, new_file
from squeal_rig.errors import RecordingError
from squeal_rig.estimation.spectra import REFERENCE

_QUIET, _SQUEAL, _LAW = "#4d4d4d", "#b2182b", "#2166ac"
_TOP_FREQUENCY = 5000.0
_LOWEST_LEVEL = -80.0
# Share of the run that a label of an operating point needs.
_LABEL_SHARE = 0.09


PICTURES = (".png", ".pdf", ".svg")


def check_picture(path: Path, force: bool = False) -> None:
    """Raise RecordingError where a name ends with none of `PICTURES`, or is taken and not to be overwritten."""
    if path.suffix not in PICTURES:
        raise RecordingError(f"The picture is {str(path)!r}; its name must end with one of {', '.join(PICTURES)}.")
    check_free(path, force)


def draw_run(analysis: Analysis, path: Path, force: bool = False) -> None:
    """Write a picture: operating point, displacement, friction, squeal level, time off the belt, spectra.

    Raises:
        RecordingError: as `check_picture`, or it cannot be written.
    """
    check_picture(path, force)
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure = plt.figure(figsize=(13.0, 10.5), layout="constrained")
    grid = figure.add_gridspec(5, 2, width_ratios=(1.9, 1.0))
    first = figure.add_subplot(grid[0, 0])
    axes = [first, *(figure.add_subplot(grid[row, 0], sharex=first) for row in range(1, 5))]
    for axis, draw in zip(axes, (_operating_point, _displacement, _friction, _level, _off_belt), strict=True):
        draw(axis, analysis)
        axis.grid(alpha=0.3)
        _shade_squeal(axis, analysis)
        axis.label_outer()
    axes[-1].set_xlabel("time [s]")
    axes[-1].set_xlim(0.0, analysis.duration)
    _spectra(figure, grid, analysis)
    figure.suptitle(
        f"Run {analysis.title}: {analysis.duration:.1f} s at {analysis.sample_rate / 1e3:g} kHz",
        x=0.01,
        ha="left",
    )
    with new_file(path, force) as draft:
        figure.savefig(draft, dpi=110, format=path.suffix[1:])
    plt.close(figure)


def _shade_squeal(axis: Any, analysis: Analysis) -> None:
    label = "squeal"
    for segment in analysis.segments:
        if segment.squealing and not segment.rings_down:  # as the table says it
            axis.axvspan(segment.begin, segment.end, color=_SQUEAL, alpha=0.08, lw=0.0, label=label)
            label = "_"


def _operating_point(axis: Any, analysis: Analysis) -> None:
    course = analysis.course
    t = course.block_column("t")
    axis.plot(t, course.block_column("preload"), color="k", label="preload F in force")
    axis.set_ylabel("F [N]")
    axis.set_ylim(bottom=0.0)
    # One label for what is one operating point, squealing or not; none where there is no room for it.
    for _, group in groupby(analysis.segments, lambda segment: segment.parameters):
        segments = list(group)
        segment, begin, end = segments[0], segments[0].begin, segments[-1].end
        s = segment.stability
        if s is None or math.isnan(s.critical_pad_stiffness) or end - begin < _LABEL_SHARE * analysis.duration:
            continue
        word = "unstable" if s.unstable else "stable"
        zone = "" if segment.zone == NOT_AVAILABLE else f"\nzone: {segment.zone}"
        axis.annotate(
            f"k/k$_{{cr}}$ = {s.pad_stiffness / s.critical_pad_stiffness:.2f}\n{word}{zone}",
            (0.5 * (begin + end), 0.5),
            xycoords=("data", "axes fraction"),
            ha="center",
            va="center",
            fontsize=8,
            color=_SQUEAL if s.unstable else _QUIET,
        )
    axis.set_title("Operating point, and what the eigenvalues say of it", loc="left", fontsize=10)


def _legend_above(axis: Any, columns: int) -> None:
    """A legend in room of its own above what is drawn."""
    low, high = axis.get_ylim()
    axis.set_ylim(low, high + 0.25 * (high - low))
    axis.legend(loc="upper right", fontsize=8, ncols=columns)


def _displacement(axis: Any, analysis: Analysis) -> None:
    course = analysis.course
    t = course.block_column("t")
    for name, color, hatch in (("x", _LAW, ""), ("y", "0.45", "////")):
        low, high = course.block_column(f"{name}_min") * 1e6, course.block_column(f"{name}_max") * 1e6
        axis.fill_between(t, low, high, step="post", color=color, alpha=0.55, lw=0.5, hatch=hatch, label=name)
    axis.set_ylabel("range [$\\mu$m]")
    _legend_above(axis, 2)
    axis.set_title(
        "Pad displacement along (x) and away from (y) the belt, range in each block of 10 ms",
        loc="left",
        fontsize=10,
    )


def _friction(axis: Any, analysis: Analysis) -> None:
    course = analysis.course
    if course.windows:
        t = 0.5 * (course.window_column("t_start") + course.window_column("t_end"))
        truth = course.window_column("mu_true")
        axis.plot(t, course.window_column("mu"), "o", ms=3.0, color=_SQUEAL, label="Eq. (2.2), mean of ratios")
        axis.plot(
            t,
            course.window_column("mu_ratio_of_means"),
            "s",
            ms=3.0,
            mfc="none",
            color=_LAW,
            label="ratio of means",
        )
        if np.isfinite(truth).any():
            axis.plot(t, truth, "-", lw=1.0, color="k", label="true")
        _legend_above(axis, 3)
    axis.set_ylabel("$\\mu$")
    axis.set_title("Friction coefficient in windows of 0.2 s", loc="left", fontsize=10)


def _level(axis: Any, analysis: Analysis) -> None:
    course = analysis.course
    level = np.maximum(course.level_column("level"), _LOWEST_LEVEL)
    axis.step(course.level_column("t"), level, where="pre", color="k", lw=1.2)
    axis.set_ylabel("level\n[dB re 1 $\\mu$m]")
    axis.set_ylim(_LOWEST_LEVEL, max(30.0, float(level.max(initial=0.0)) + 5.0))
    axis.set_title(
        f"Level of x, 0.5 to 5 kHz, RMS over 0.1 s (drawn from {_LOWEST_LEVEL:g} dB up)",
        loc="left",
        fontsize=10,
    )


def _off_belt(axis: Any, analysis: Analysis) -> None:
    axis.plot(analysis.course.block_column("t"), 100.0 * analysis.course.block_column("off_belt"), color="k", lw=0.8)
    axis.set_ylabel("off belt [%]")
    axis.set_ylim(0.0, 100.0)
    axis.set_title("Share of time the pad is off the belt (known to the simulator only)", loc="left", fontsize=10)


def _spectra(figure: Any, grid: Any, analysis: Analysis) -> None:
    """Spectra of the loudest segments, at most three, one under the other."""
    by_weight = sorted(analysis.segments, key=lambda s: (bool(s.squealing), s.duration), reverse=True)
    chosen = by_weight[:3]
    chosen.sort(key=lambda segment: segment.begin)
    inner = grid[:, 1].subgridspec(max(1, len(chosen)), 1)
    first = None
    for row, segment in enumerate(chosen):
        axis = figure.add_subplot(inner[row], sharex=first, sharey=first)
        first = first or axis
        _spectrum(axis, segment)
        axis.label_outer()
    if first is not None:
        figure.axes[-1].set_xlabel("frequency [kHz]")


def _spectrum(axis: Any, segment: Segment) -> None:
    frequencies, amplitudes = segment.spectrum()
    shown = frequencies <= _TOP_FREQUENCY
    rms = amplitudes[shown] / math.sqrt(2.0)  # of a line, as of the level beside it
    level = 20.0 * np.log10(np.maximum(rms / REFERENCE, 10.0 ** (_LOWEST_LEVEL / 20.0)))
    axis.plot(frequencies[shown] / 1e3, level, color="k", lw=0.8)
    if level.max() <= _LOWEST_LEVEL:
        where = (0.5, 0.5)
        axis.annotate(f"nothing above {_LOWEST_LEVEL:g} dB", where, xycoords="axes fraction", ha="center", fontsize=8)
    s = segment.stability
    if s is not None and not math.isnan(s.squeal_frequency):
        axis.axvline(
            s.squeal_frequency / 1e3,
            color=_LAW,
            ls="--",
            lw=1.2,
            label=f"eigenvalue {s.squeal_frequency:.0f} Hz",
        )
    if segment.squealing:
        measured = segment.squeal_frequency()
        axis.axvline(measured / 1e3, color=_SQUEAL, ls=":", lw=1.5, label=f"squeal {measured:.0f} Hz")
    axis.set_ylim(_LOWEST_LEVEL, 40.0)
    axis.set_ylabel("x [dB re 1 $\\mu$m]")
    axis.grid(alpha=0.3)
    if axis.get_legend_handles_labels()[0]:
        axis.legend(loc="upper right", fontsize=8)
    axis.set_title(
        f"Spectrum of x, {segment.begin:.1f} to {segment.end:.1f} s, F = {segment.parameters.preload:.0f} N",
        loc="left",
        fontsize=10,
    )
