"""Evidence on the paper's inverse problem, as CSV: floors, trade-off, readings of the geometry, Table 1.

`python -m squeal_rig.studies.inverse.evidence FOLDER [part ...]`, or `make evidence`.
"""

from __future__ import annotations

import csv
import os
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from squeal_rig.configuration.files import config_directory
from squeal_rig.errors import ConfigurationError, SquealRigError
from squeal_rig.estimation.calibration.floors import bilinear_floors, searched_floor
from squeal_rig.estimation.calibration.problem import Calibration, load_calibration
from squeal_rig.estimation.calibration.search import calibrate
from squeal_rig.estimation.calibration.targets import Targets
from squeal_rig.model.parameters import RigParameters
from squeal_rig.studies.inverse.disagreements import Region, region_rows, regions, search_region
from squeal_rig.studies.inverse.readings import fit_readings, reading_rows
from squeal_rig.studies.inverse.starts import start_rows
from squeal_rig.studies.inverse.tradeoff import trade_off, trade_off_rows

SEED = 1
#: Starts of the search for the rig that the disagreements are searched around.
_STARTS = 3
#: Candidates a generation, and generations, by the length of the record.
_EFFORT = {"short": (30, 16), "long": (20, 8)}

Row = dict[str, str]
Tell = Callable[[int, int], object]


def floor_rows(problem: Calibration, tell: Tell) -> list[Row]:
    """Floors of a bilinear k + D/k, by local searches or a linear programme, and by global search."""
    floors = bilinear_floors(problem.targets)
    rows = []
    for done, measure in enumerate(("rms", "mean", "largest"), 1):
        searched = searched_floor(problem.targets, measure, SEED)
        rows.append(
            {"measure": measure, "floor": f"{getattr(floors, measure):.5f}", "global_search": f"{searched:.5f}"}
        )
        tell(done, 3)
    return rows


def disagreement_rows(problem: Calibration, tell: Tell, areas: Sequence[Region] | None = None) -> list[Row]:
    """Two rows a region of switches; the regions are searched on all cores, the rows do not depend on how many."""
    base = closest_to_thresholds(problem.targets)
    chosen = regions() if areas is None else areas
    rows = []
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        for done, own in enumerate(pool.map(partial(_searched, base, problem.targets), chosen), 1):
            rows += own
            tell(done, len(chosen))
    return rows


def closest_to_thresholds(targets: Targets) -> RigParameters:
    """The rig that the disagreements are searched around: targets alone, the usual free parameters and weights."""
    return calibrate(Calibration.of(targets), SEED, _STARTS).rig


def _searched(base: RigParameters, targets: Targets, region: Region) -> list[Row]:
    return region_rows(region, search_region(base, targets, region, SEED, *_EFFORT[region.record]))


def mirrored_rows(problem: Calibration, tell: Tell) -> list[Row]:
    """Table 1 of the mirrored arms calibrated at their true equilibrium, over starts and records."""
    return start_rows(RigParameters.preset("yavuz_sen_2023_mirrored"), problem.targets, progress=tell)


PARTS: dict[str, Callable[[Calibration, Tell], list[Row]]] = {
    "floors": floor_rows,
    "trade_off": lambda problem, tell: trade_off_rows(trade_off(problem, seed=SEED, progress=tell)),
    "readings": lambda problem, tell: reading_rows(fit_readings(problem, seed=SEED, progress=tell)),
    "disagreements": disagreement_rows,
    "mirrored": mirrored_rows,
}


def write_evidence(folder: Path, parts: Sequence[str], console: Console) -> None:
    """Write the tables named in `parts` into `folder`, all of them where none is named.

    Raises:
        ConfigurationError: no such folder or part.
    """
    if not folder.is_dir():
        raise ConfigurationError(f"no folder {folder} to write to")
    for part in parts:
        if part not in PARTS:
            raise ConfigurationError(f"no part {part!r}: there are {', '.join(PARTS)}")
    problem = load_calibration(config_directory() / "calibrations" / "yavuz_sen_2023.yaml")
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console) as bar:
        for part in parts or PARTS:
            task = bar.add_task(part, total=None)
            rows = PARTS[part](problem, lambda done, total, t=task: bar.update(t, completed=done, total=total))  # type: ignore[misc]
            _write(folder / f"{part}.csv", rows)


def _write(path: Path, rows: Sequence[Row]) -> None:
    names = list(dict.fromkeys(name for row in rows for name in row))
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, names, restval="", lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def main() -> int:
    """Folder, then parts, from the command line."""
    if len(sys.argv) < 2:
        sys.stderr.write(f"usage: python -m squeal_rig.studies.inverse.evidence FOLDER [{' | '.join(PARTS)} ...]\n")
        return 2
    try:
        write_evidence(Path(sys.argv[1]), sys.argv[2:], Console())
    except SquealRigError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
