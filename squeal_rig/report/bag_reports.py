"""What was computed again from a bag, in words."""

from __future__ import annotations

from pathlib import Path

from squeal_rig.analysis.estimate import compare_estimates, estimate_bag
from squeal_rig.recording import Bag


def estimate_text(source: Path | str, directory: Path | str) -> str:
    """Estimate a bag anew into another; what was computed, and how it compares with what was recorded live."""
    report = estimate_bag(source, directory)
    took = f"{report.recorded:.1f} s computed in {report.computing:.1f} s, {report.speed:.0f} times real time"
    lines = [f"{took}, to {directory}"]
    for c in compare_estimates(Bag(source), Bag(directory)):
        if c.recorded:
            lines.append(
                f"{c.topic}: {c.recorded} recorded live, {c.computed} computed, {c.equal} equal in every field"
            )
        elif c.computed:
            lines.append(f"{c.topic}: {c.computed} computed, none recorded")
    if report.rejected:
        lines.append(f"{report.rejected} blocks or values were refused")
    if report.unexplained:
        lines.append(f"{report.unexplained} summaries of stability name causes that the bag does not hold")
    return "\n".join(lines)
