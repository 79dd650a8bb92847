"""The command `squeal-rig calibrate`: progress while it searches, tables when it is done, a preset as its result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from squeal_rig.errors import ConfigurationError
from squeal_rig.estimation.calibration.problem import load_calibration
from squeal_rig.estimation.calibration.residuals import (
    residual_lines,
    residuals,
    rounded,
    shown_kinds,
    spread_lines,
    write_preset,
)
from squeal_rig.estimation.calibration.search import GENERATIONS, Found, calibrate


@dataclass(frozen=True)
class Effort:
    """Seed, starts and generations of each start."""

    seed: int
    starts: int
    generations: int = GENERATIONS


def run_calibration(path: Path, free: Sequence[str], effort: Effort, out: Path, console: Console) -> Found:
    """Read the problem, search, print what was found and write the preset `out`.

    Raises:
        ConfigurationError, ParameterError: something is wrong with the file, with `free`, or `out` cannot be written.
    """
    problem = load_calibration(path)
    if free:
        problem = problem.with_free(free)
    if not out.parent.is_dir():
        raise ConfigurationError(f"cannot write {out}: there is no folder {out.parent}")
    if out.exists():
        raise ConfigurationError(f"{out} exists already: name another file with --out, or remove it")
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("calibrating", total=None)

        def step(start: int, generations: int, generation: int) -> None:
            done = start * generations + generation
            bar.update(
                task,
                completed=done,
                total=effort.starts * generations,
                description=f"start {start + 1} of {effort.starts}",
            )

        found = calibrate(problem, effort.seed, effort.starts, effort.generations, step)
    # First what took long to find, then the words about it.
    chosen = f" --free {','.join(free)}" if free else ""
    asked = f"--seed {effort.seed} --starts {effort.starts}"
    asked += f" --generations {effort.generations}" if effort.generations != GENERATIONS else ""
    write_preset(found, out, f"squeal-rig calibrate {path}{chosen} {asked}")
    items = residuals(problem, rounded(found), shown_kinds(problem))
    for line in [*residual_lines(items), "", *spread_lines(found)]:
        console.print(line, markup=False, highlight=False, soft_wrap=True)
    if found.missing:
        console.print(f"{found.missing} roots that the targets ask for do not exist: none is reported in their place")
    if found.outside > 0.0:
        console.print(
            f"[bold]demands or limits of the calibration are broken by {found.outside:.3g}[/bold]: search longer"
        )
    console.print(f"preset: {out}")
    return found
