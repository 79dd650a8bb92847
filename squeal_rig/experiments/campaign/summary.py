"""What the tables of a campaign say: what was seen against zones and eigenvalues, occurrence, the worst point."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from squeal_rig.errors import ModelError, ParameterError, RecordingError
from squeal_rig.experiments.campaign.bench import Bench, EngineBench
from squeal_rig.experiments.campaign.measuring import FAILED, QUIET, SQUEAL, STOPPED, Table, is_unstable, measure_point
from squeal_rig.experiments.campaign.plans import EVENTS, Campaign
from squeal_rig.experiments.campaign.store import header, journal, read
from squeal_rig.model.core.law import COEFFICIENTS, friction_basis
from squeal_rig.model.cycles.zone_map import NAMES, UNKNOWN, zone_map

Values = NDArray[np.float64]

# A zone takes some 80 ms for each machine; and pictures of more points than this show nothing more.
_MOST_MACHINES, _MOST_ZONES = 40, 20_000
NOT_AVAILABLE = "not available"
#: Fields of an operating point: with them zones need no new machine.
OPERATING = ("preload", "belt_speed", *COEFFICIENTS)


@dataclass(frozen=True)
class Results:
    """A campaign and its tables; `zones`: zone of each point by the cycles, and why there is none."""

    folder: Path
    campaign: Campaign
    live: bool
    points: Table
    events: Table
    steps: Table
    entries: list[dict[str, Any]]
    zones: NDArray[Any]
    no_zone: str

    @property
    def count(self) -> int:
        """Points measured."""
        return len(self.points.get("place", ()))

    @property
    def squealing(self) -> NDArray[np.bool_]:
        """Which points squeal: with a tone, also where the plan's rule on the level has ended them."""
        verdicts = np.asarray(self.points["verdict"])
        stopped = (verdicts == STOPPED) & np.isfinite(np.asarray(self.points["frequency"], dtype=np.float64))
        return np.asarray((verdicts == SQUEAL) | stopped, dtype=np.bool_)

    @property
    def main_events(self) -> Table:
        """Events that are no harmonic of a louder tone."""
        if not self.events:
            return {}
        own = np.isnan(np.asarray(self.events["harmonic_of"], dtype=np.float64))
        return {name: values[own] for name, values in self.events.items()}

    def worst(self) -> int | None:
        """Row of the loudest point that squeals; None where none does."""
        levels = np.where(self.squealing, np.nan_to_num(self.points["level"], nan=-np.inf), -np.inf)
        return int(np.argmax(levels)) if len(levels) and np.isfinite(levels.max()) else None

    def occurrence(self) -> float:
        """Share of the points that squeal, of those that have a verdict."""
        judged = self.points["verdict"] != FAILED if self.count else np.zeros(0, dtype=bool)
        return float(np.mean(self.squealing[judged])) if judged.any() else math.nan


def load_results(folder: Path) -> Results:
    """Everything measured so far in the folder of a campaign.

    Raises:
        ExperimentError: there is no campaign.
    """
    campaign, first = header(folder)
    points, events, steps = (read(folder, name) for name in ("points", "events", "steps"))
    zones, reason = _zones(campaign, points)
    return Results(folder, campaign, bool(first.get("live")), points, events, steps, journal(folder), zones, reason)


def _zones(campaign: Campaign, points: Table) -> tuple[NDArray[Any], str]:
    count = len(points.get("place", ()))
    missing = np.full(count, NOT_AVAILABLE)
    names = [f.name for f in campaign.design.factors]
    machine = [name for name in names if name not in OPERATING]
    machines = (
        {tuple(row) for row in np.column_stack([points[n] for n in machine]).tolist()} if machine and count else {()}
    )
    if not count or count > _MOST_ZONES or len(machines) > _MOST_MACHINES:
        return missing, f"zones are computed for at most {_MOST_ZONES} points of {_MOST_MACHINES} machines"
    try:
        grids: dict[str, Any] = {name: points[name] for name in names}
        found = zone_map(campaign.base, **grids)
    except (ModelError, ParameterError) as error:
        return missing, str(error)
    return np.array([NAMES[int(code)] for code in found.zone]), ""


def contradictions(results: Results) -> list[str]:
    """Sentences on points where what was seen and what is predicted do not go together.

    Unstable by the eigenvalues and quiet: it should squeal. Squealing in the zone where no hit starts squeal: it should
    not. Squealing in the bistable zone is no contradiction, it is hard squeal.
    """
    points = results.points
    found: list[str] = []
    if not results.count:
        return found
    unstable = is_unstable(points)
    verdict = points["verdict"]
    for what, which in (
        ("unstable by the eigenvalues, and quiet", unstable & (verdict == QUIET)),
        ("squealing where the cycles say no hit starts squeal", results.squealing & (results.zones == "quiet")),
        (
            "squealing where eigenvalues say stable and no zone is known",
            results.squealing & ~unstable & np.isin(results.zones, (NOT_AVAILABLE, NAMES[UNKNOWN])),
        ),
    ):
        if which.any():
            numbers = ", ".join(str(n) for n in points["point"][which][:10])
            found.append(f"{int(which.sum())} points {what}: {numbers}{' ...' if which.sum() > 10 else ''}.")
    hard = int(np.sum(results.squealing & ~unstable & (results.zones == "bistable")))
    if hard:
        found.append(f"{hard} points squeal in the bistable zone, where the eigenvalues alone say stable: hard squeal.")
    return found


def crosstable(results: Results) -> list[list[Any]]:
    """Rows: zone by the cycles, eigenvalues, verdict, number of points."""
    words = np.where(is_unstable(results.points), "unstable", "stable")
    found = Counter(zip(results.zones.tolist(), words.tolist(), results.points["verdict"].tolist(), strict=True))
    return [[*key, number] for key, number in sorted(found.items())]


@dataclass(frozen=True)
class LawFit:
    """The friction law refitted to points that slide quietly: coefficients and half widths of their 95 % intervals
    [SI], residuals (n,) in the order of measurement, how many points.

    - largest: of the residuals, in their standard deviations
    - neighbours: correlation of a residual with the one before it; beyond `bound` either way drift is likely
    """

    coefficients: dict[str, float]
    half_widths: dict[str, float]
    rms: float
    largest: float
    neighbours: float
    bound: float
    count: int


def fit_law(results: Results) -> LawFit | None:
    """Refit mu(V, F) to what was measured; None where nothing was, or points do not tell all coefficients.

    Ordinary least squares, intervals of Student's t with the scatter of the residuals (Draper and Smith, Applied
    Regression Analysis, 3rd ed., 1.4 and 5.1). In squeal Eq. (2.1) is biased, so those points are left out.
    """
    points = results.points
    if "mu_measured" not in points or any(f.name in COEFFICIENTS for f in results.campaign.design.factors):
        return None
    mu = np.asarray(points["mu_measured"], dtype=np.float64)
    used = np.isfinite(mu) & (points["verdict"] == QUIET)
    base = results.campaign.base
    speed, preload = (
        np.broadcast_to(np.asarray(points.get(name, getattr(base, name)), dtype=np.float64), mu.shape)[used]
        for name in ("belt_speed", "preload")
    )
    basis, count = friction_basis(speed, preload), int(used.sum())
    scale = np.sqrt(np.sum(basis**2, axis=0))
    freedom = count - len(COEFFICIENTS)
    if freedom < 1 or np.linalg.matrix_rank(basis / scale) < len(COEFFICIENTS):
        return None
    found = np.linalg.lstsq(basis / scale, mu[used], rcond=None)[0] / scale
    residuals = mu[used] - basis @ found
    deviation = math.sqrt(float(residuals @ residuals) / freedom)
    inverse = np.linalg.inv((basis / scale).T @ (basis / scale))
    half = float(stdtrit(freedom, 0.975)) * deviation * np.sqrt(np.diag(inverse)) / scale
    power = float(residuals @ residuals)
    return LawFit(
        dict(zip(COEFFICIENTS, found.tolist(), strict=True)),
        dict(zip(COEFFICIENTS, half.tolist(), strict=True)),
        math.sqrt(power / count),
        float(np.abs(residuals).max()) / deviation if deviation else 0.0,
        float(residuals[1:] @ residuals[:-1]) / power if power else 0.0,
        2.0 / math.sqrt(count),
        count,
    )


class _Listening:
    """A bench that keeps what comes from another one."""

    def __init__(self, bench: Bench) -> None:
        self._bench, self.pieces = bench, []  # type: tuple[Bench, list[Values]]
        self.sample_rate = bench.sample_rate

    def __getattr__(self, name: str) -> Any:
        return getattr(self._bench, name)

    def run(self, duration: float) -> Iterable[Values]:
        for x in self._bench.run(duration):
            self.pieces.append(x)
            yield x


def signal_of(results: Results, row: int) -> tuple[Values, int]:
    """x (n,) [m] of a point, and its sample rate [Hz]: out of the bag of a live campaign, by the engine again of a
    direct one, which gives the same numbers.

    Raises:
        RecordingError: the bag cannot be read, or has no samples of the point.
    """
    campaign, points = results.campaign, results.points
    if results.live:
        return _recorded(results, row)
    values = {f.name: float(points[f.name][row]) for f in campaign.design.factors}
    listening = _Listening(EngineBench(campaign.base))
    if campaign.measure == EVENTS:
        measure_point(campaign, values, listening)  # type: ignore[arg-type]
    else:
        from squeal_rig.model.motion.trajectory import displaced_state, simulate

        p = campaign.rig(values)
        run = simulate(p, campaign.point_duration, listening.sample_rate, displaced_state(p, campaign.start))
        listening.pieces.append(run.x)
    return np.concatenate(listening.pieces), listening.sample_rate


def _recorded(results: Results, row: int) -> tuple[Values, int]:
    from squeal_rig.recording import Bag
    from squeal_rig.samples.blocks import recorded_blocks

    first, last = int(results.points["first_sample"][row]), int(results.points["last_sample"][row])
    pieces, rate = [], 0
    for block in recorded_blocks(Bag(results.folder / str(results.points["bag"][row]))):
        seq = np.asarray(block.daq["seq"], dtype=np.int64)
        inside = (seq >= first) & (seq < last)
        rate = block.rig.sample_rate
        if inside.any():
            pieces.append(np.asarray(block.daq["x"][inside], dtype=np.float64))
    if not pieces:
        raise RecordingError(f"the bag has no samples of point {results.points['point'][row]}")
    return np.concatenate(pieces), rate
