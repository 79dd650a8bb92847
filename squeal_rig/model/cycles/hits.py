"""The smallest hit that starts lasting squeal, and the share of starts that do."""

from __future__ import annotations

import math
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from squeal_rig.errors import ParameterError
from squeal_rig.model.core.layout import Vector
from squeal_rig.model.core.statics import equilibrium
from squeal_rig.model.cycles.path import Path, refuse_what_has_no_cycles
from squeal_rig.model.cycles.threshold import growth
from squeal_rig.model.cycles.verdict import LEFT, OUTLASTS, QUIET, SENTENCES, SETTLES, Judge, judge
from squeal_rig.model.cycles.zones import Located, cycles_of
from squeal_rig.model.parameters import RigParameters

# Scan: step in unit impulses m omega u up to the first crossing, factor between hits beyond it.
_SCAN_STEP, _BEYOND_STEP = 0.05, 1.25
_UPPER_BOUND = 20.0
_BEYOND = 3.0
_TOLERANCE = 1e-4
_DIRECTIONS = 36
_GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)
_CHUNK = 64
# Two-sided 95 % quantile of the normal distribution.
_QUANTILE = 1.959963984540054


@dataclass(frozen=True)
class Hit:
    """The smallest hit at rest that starts lasting squeal. Impulses in N s, directions in rad from the belt's, -pi/2
    towards the belt.

    - impulse, direction: `impulse` is the larger end of the bracket; 0 where the rig squeals by itself, nan where no
      hit up to `upper_bound` starts squeal
    - bracket: the largest that was seen to die out below it, and the smallest seen to squeal
    - scan_step, upper_bound: hits were tried in steps of `scan_step`, above one unit impulse m omega u in steps that
      grow with the impulse, up to the first that squeals or `upper_bound`; squeal in a range of impulses narrower than
      a step can be missed
    - larger: larger hits tried in that direction that die out again
    - left: hits tried that left the range of displacements in which the model holds, which is neither
    - sentence: what was found
    """

    impulse: float
    direction: float
    bracket: tuple[float, float]
    scan_step: float
    upper_bound: float
    larger: tuple[float, ...]
    left: tuple[float, ...]
    sentence: str

    @property
    def found(self) -> bool:
        return math.isfinite(self.impulse)


def smallest_hit(
    p: RigParameters,
    direction: float | None = None,
    upper_bound: float | None = None,
    scan_step: float | None = None,
    tolerance: float = _TOLERANCE,
    beyond: float = _BEYOND,
    known: Located | None = None,
) -> Hit:
    """The smallest impulse on the pad at rest from which on it squeals for good (criterion: `cycles.verdict`).

    Hits are tried from zero upwards in steps, and the first crossing is bisected.

    Args:
        p: parameters.
        direction: of the impulse [rad]; None: the direction with the smallest one, 36 scanned and the best refined.
        upper_bound: largest impulse tried [N s]; 20 unit impulses m omega u when None.
        scan_step: between hits tried [N s], up to one unit impulse; above it in proportion. 0.05 unit impulses when
            None.
        tolerance: width of the bracket, as a share.
        beyond: up to this multiple of the smallest hit larger ones are tried, to see whether they die out again.
        known: `located(p)` where that is at hand.

    Raises:
        ModelError: the rig is refused (friction that sees the slip, no damping), or has no equilibrium in contact.
        ParameterError: an argument is out of its bounds.
    """
    refuse_what_has_no_cycles(p)
    _refuse_wrong(direction, upper_bound, scan_step, tolerance, beyond)
    equilibrium(p)
    path = Path(p, "mu0")
    if growth(path.packed(path.value)) >= 0.0:
        way = 0.0 if direction is None else direction
        return Hit(0.0, way, (0.0, 0.0), 0.0, 0.0, (), (), "the rig squeals by itself: its equilibrium is unstable")
    judged = judge(p, *(cycles_of(p) if known is None else (known.squeal, known.separatrix)))
    unit = judged.unit_impulse
    step = _SCAN_STEP * unit if scan_step is None else scan_step
    top = _UPPER_BOUND * unit if upper_bound is None else upper_bound
    search = _Search(judged, step, top, tolerance)
    if direction is None:
        angles = np.arange(_DIRECTIONS, dtype=np.float64) * (2.0 * math.pi / _DIRECTIONS) - math.pi
        crossing = search.first(angles)
        if crossing is not None:
            crossing = search.best_near(crossing, 2.0 * math.pi / _DIRECTIONS)
    else:
        crossing = search.first(np.array([direction]))
    if crossing is None:
        way = math.nan if direction is None else direction
        where = "in any direction scanned" if direction is None else "in that direction"
        return Hit(
            math.nan,
            way,
            (top, math.nan),
            step,
            top,
            (),
            tuple(search.left),
            f"no hit up to {top:.4g} N s, tried in steps from {step:.4g} N s on, starts lasting squeal {where}",
        )
    angle, low, high = crossing
    low, high = search.bisected(angle, low, high)
    larger = search.larger(angle, high, min(top, beyond * high))
    sentence = f"hits from {high:.4g} N s on squeal for good, up to {low:.4g} N s they die out"
    if larger:
        sentence += f"; of larger ones {len(larger)} die out again"
    return Hit(high, angle, (low, high), step, top, larger, tuple(search.left), sentence)


class _Search:
    """Hits tried on one rig."""

    def __init__(self, judged: Judge, step: float, top: float, tolerance: float) -> None:
        self._judge, self._step, self._top, self._tolerance = judged, step, top, tolerance
        self.left: list[float] = []

    def _verdicts(self, impulses: Vector, angles: Vector) -> NDArray[np.int64]:
        starts = np.array([self._judge.struck(j, a) for j, a in zip(impulses, angles, strict=True)])
        found, _ = self._judge.verdicts(starts)
        self.left.extend(float(j) for j, verdict in zip(impulses, found, strict=True) if verdict == LEFT)
        return found

    def _squeals(self, impulse: float, angle: float) -> bool:
        verdict = self._verdicts(np.array([impulse]), np.array([angle]))[0]
        return bool(verdict in (SETTLES, OUTLASTS))

    def first(self, angles: Vector) -> tuple[float, float, float] | None:
        """Of some directions the one that squeals first, with the last hit that dies out and the first that squeals."""
        low = 0.0
        while low < self._top * (1.0 - 1e-9):
            high = min(low + self._step * max(1.0, low / self._judge.unit_impulse), self._top)
            verdicts = self._verdicts(np.full(len(angles), high), angles)
            squealing = np.flatnonzero((verdicts == SETTLES) | (verdicts == OUTLASTS))
            if len(squealing):
                return self._best_of(angles[squealing], low, high)
            low = high
        return None

    def _best_of(self, angles: Vector, low: float, high: float) -> tuple[float, float, float]:
        """Of directions that squeal at `high` and not at `low` the one that does first, bisected together."""
        while len(angles) > 1 and high - low > self._tolerance * high:
            middle = 0.5 * (low + high)
            verdicts = self._verdicts(np.full(len(angles), middle), angles)
            squealing = (verdicts == SETTLES) | (verdicts == OUTLASTS)
            if squealing.any():
                angles, high = angles[squealing], middle
            else:
                low = middle
        return float(angles[0]), low, high

    def bisected(self, angle: float, low: float, high: float) -> tuple[float, float]:
        """The crossing between a hit that dies out and one that squeals, to the tolerance."""
        while high - low > self._tolerance * high:
            middle = 0.5 * (low + high)
            if self._squeals(middle, angle):
                high = middle
            else:
                low = middle
        return low, high

    def best_near(self, crossing: tuple[float, float, float], width: float) -> tuple[float, float, float]:
        """The direction within a width of the one given that squeals first: golden section on the bisected hit."""
        centre = crossing[0]
        low, high = centre - width, centre + width
        best = (centre, *self.bisected(*crossing))

        def at(angle: float) -> float:
            nonlocal best
            below, above = 0.9 * best[2], 1.3 * best[2]
            if self._squeals(below, angle):
                below, above = 0.0, below
            elif not self._squeals(above, angle):
                return math.inf
            below, above = self.bisected(angle, below, above)
            if above < best[2]:
                best = (angle, below, above)
            return above

        left, right = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
        f_left, f_right = at(left), at(right)
        while high - low > 0.01:
            if f_left < f_right:
                high, right, f_right = right, left, f_left
                left = high - _GOLDEN * (high - low)
                f_left = at(left)
            else:
                low, left, f_left = left, right, f_right
                right = low + _GOLDEN * (high - low)
                f_right = at(right)
        return best

    def larger(self, angle: float, first: float, top: float) -> tuple[float, ...]:
        """Larger hits tried in a direction that die out again."""
        if not top > first:
            return ()
        count = max(1, math.ceil(math.log(top / first) / math.log(_BEYOND_STEP)))
        impulses = first * (top / first) ** (np.arange(1, count + 1) / count)
        verdicts = self._verdicts(impulses, np.full(count, angle))
        return tuple(float(j) for j in impulses[verdicts == QUIET])


def _refuse_wrong(
    direction: float | None, upper_bound: float | None, scan_step: float | None, tolerance: float, beyond: float
) -> None:
    if direction is not None and not math.isfinite(direction):
        raise ParameterError(f"direction = {direction} rad must be a finite number")
    for name, value in (("upper_bound", upper_bound), ("scan_step", scan_step)):
        if value is not None and not 0.0 < value < math.inf:
            raise ParameterError(f"{name} = {value} N s is out of bounds: it must be above 0 N s")
    if not 1e-12 <= tolerance < 1.0:
        raise ParameterError(f"tolerance = {tolerance} is out of bounds: it must be 1e-12 to below 1")
    if not 1.0 <= beyond <= 1e3:
        raise ParameterError(f"beyond = {beyond} is out of bounds: it must be 1 to 1000")


@dataclass(frozen=True)
class BasinShare:
    """Share of starts that squeal for good, with its 95 % confidence interval (Wilson's score interval).

    `verdicts`: how many of the samples ended each way, by sentence; those that left the model's range count as starts
    that do not squeal.
    """

    share: float
    interval: tuple[float, float]
    samples: int
    verdicts: dict[str, int]


def basin_share(
    p: RigParameters, region: ArrayLike = 3.0, samples: int = 1000, seed: int = 0, threads: int | None = None
) -> BasinShare:
    """Share of the starts in a region that squeal for good.

    Args:
        p: parameters.
        region: half the width of the box of starts about the equilibrium: one number in units u for x and y, u omega
            for vx and vy; or lower and upper bounds (4, 2) of x, y, vx, vy relative to the equilibrium [m, m/s].
        samples: how many starts, uniform in the box.
        seed: of the starts; sample i is the same whatever the number of threads.
        threads: how many work at once; one a core when None.

    Raises:
        ModelError: the rig is refused (friction that sees the slip, no damping), or has no equilibrium in contact, or
            one that grows by itself: there every start but one squeals.
        ParameterError: an argument is out of its bounds.
    """
    refuse_what_has_no_cycles(p)
    if not 1 <= samples <= 10_000_000:
        raise ParameterError(f"samples = {samples} is out of bounds: it must be 1 to 10000000")
    if threads is not None and threads < 1:
        raise ParameterError(f"threads = {threads} is out of bounds: it must be 1 or more")
    judged = judge(p, *cycles_of(p))
    box = _box(region, judged)
    starts = judged.rest + box[:, 0] + np.random.default_rng(seed).random((samples, 4)) * (box[:, 1] - box[:, 0])
    with ThreadPoolExecutor(threads or os.cpu_count() or 1) as pool:
        parts = pool.map(lambda i: judged.verdicts(starts[i : i + _CHUNK])[0], range(0, samples, _CHUNK))
        found = np.concatenate(list(parts))
    squealing = int(np.count_nonzero((found == SETTLES) | (found == OUTLASTS)))
    counts = {sentence: int(np.count_nonzero(found == code)) for code, sentence in enumerate(SENTENCES)}
    return BasinShare(squealing / samples, _wilson(squealing, samples), samples, counts)


def _box(region: ArrayLike, judged: Judge) -> Vector:
    given = np.asarray(region, dtype=np.float64)
    if given.shape == () and 0.0 < float(given) < math.inf:
        half = float(given) * judged.compression * np.array([1.0, 1.0, judged.rate, judged.rate])
        return np.column_stack([-half, half])
    if given.shape == (4, 2) and np.isfinite(given).all() and (given[:, 0] <= given[:, 1]).all():
        return given
    raise ParameterError(
        "region must be one number above 0, in static compressions, or finite bounds (4, 2), lower before upper, of"
        " x, y [m], vx, vy [m/s]"
    )


def _wilson(successes: int, samples: int) -> tuple[float, float]:
    share, z2 = successes / samples, _QUANTILE**2
    centre = (share + 0.5 * z2 / samples) / (1.0 + z2 / samples)
    half = _QUANTILE / (1.0 + z2 / samples) * math.sqrt(share * (1.0 - share) / samples + 0.25 * z2 / samples**2)
    # Exact where none or all do: rounding leaves a last bit.
    return (max(0.0, centre - half) if successes else 0.0), (min(1.0, centre + half) if successes < samples else 1.0)
