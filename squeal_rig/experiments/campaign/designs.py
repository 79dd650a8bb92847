"""Designs: which values the factors of a campaign take at each of its points, made for any range of points at once."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]

GRID, LIST, LATIN_HYPERCUBE, SOBOL = "grid", "list", "latin_hypercube", "sobol"
DESIGNS = (GRID, LIST, LATIN_HYPERCUBE, SOBOL)
AS_GIVEN, RANDOM, SERPENTINE = "as_given", "random", "serpentine"
ORDERS = (AS_GIVEN, RANDOM, SERPENTINE)
#: Most points of a design, and of one that has to be held in memory whole (a hypercube, an order that mixes).
MOST_POINTS, MOST_HELD = 100_000_000, 1_000_000


@dataclass(frozen=True)
class Factor:
    """A parameter that varies: its levels (grid, list), or the range it is sampled from; `log`: evenly in its
    logarithm.
    """

    name: str
    levels: tuple[float, ...] = ()
    low: float = math.nan
    high: float = math.nan
    log: bool = False

    def scaled(self, share: Values) -> Values:
        """Values at shares (n,) of the range, 0 to 1."""
        if self.log:
            return np.asarray(self.low * (self.high / self.low) ** share, dtype=np.float64)
        return np.asarray(self.low + (self.high - self.low) * share, dtype=np.float64)


@dataclass(frozen=True)
class Design:
    """Points of a campaign. `by_hand`: factors that somebody has to change by hand, which vary slowest."""

    kind: str
    factors: tuple[Factor, ...]
    samples: int = 0
    order: str = AS_GIVEN
    repeats: int = 1
    seed: int = 1
    by_hand: tuple[str, ...] = ()

    @property
    def shape(self) -> tuple[int, ...]:
        """Levels of each factor; of a design that is no grid, its points."""
        return tuple(len(f.levels) for f in self.factors) if self.kind == GRID else (self._one_pass,)

    @property
    def _one_pass(self) -> int:
        if self.kind == GRID:
            return math.prod(len(f.levels) for f in self.factors)
        if self.kind == LIST:
            return len(self.factors[0].levels)
        return self.samples

    @property
    def count(self) -> int:
        """Points in all, repeats included."""
        return self._one_pass * self.repeats

    def points(self, first: int, last: int) -> NDArray[np.int64]:
        """Numbers (n,) of the points measured from place `first` to `last` of the order; a point is the same
        combination of values at every repeat.
        """
        places = np.arange(first, min(last, self.count), dtype=np.int64)
        passes, within = np.divmod(places, self._one_pass)
        if self.order == RANDOM or self.by_hand:
            found = np.empty_like(within)
            for number in np.unique(passes):
                found[passes == number] = self._mixed(int(number))[within[passes == number]]
            return found
        return self._serpentine(within) if self.order == SERPENTINE else within

    def repeat_of(self, first: int, last: int) -> NDArray[np.int64]:
        """Number of the repeat, from 0, at places `first` to `last`."""
        return np.arange(first, min(last, self.count), dtype=np.int64) // self._one_pass

    def values(self, points: NDArray[np.int64]) -> dict[str, Values]:
        """Factor -> value at points (n,)."""
        if self.kind == GRID:
            which = np.unravel_index(points, self.shape)
            return {f.name: np.array(f.levels)[index] for f, index in zip(self.factors, which, strict=True)}
        if self.kind == LIST:
            return {f.name: np.array(f.levels)[points] for f in self.factors}
        shares = self._hypercube[points] if self.kind == LATIN_HYPERCUBE else self._sobol(points)
        return {f.name: f.scaled(shares[:, column]) for column, f in enumerate(self.factors)}

    @cached_property
    def _hypercube(self) -> Values:
        from scipy.stats import qmc

        return np.asarray(qmc.LatinHypercube(len(self.factors), seed=self.seed).random(self.samples))

    def _sobol(self, points: NDArray[np.int64]) -> Values:
        """Shares (n, factors): the sequence itself goes on from any point, so none of it is kept."""
        from scipy.stats import qmc

        low, high = int(points.min()), int(points.max())
        sequence = qmc.Sobol(len(self.factors), scramble=True, seed=self.seed)
        with warnings.catch_warnings():  # the whole is a power of 2, its pieces need not be
            warnings.simplefilter("ignore", UserWarning)
            if low:
                sequence.fast_forward(low)
            return np.asarray(sequence.random(high - low + 1)[points - low])

    def _serpentine(self, within: NDArray[np.int64]) -> NDArray[np.int64]:
        """Every other line of the grid backwards, so that neighbours in the order are neighbours in the grid."""
        if self.kind != GRID:
            return within
        which = [np.array(index) for index in np.unravel_index(within, self.shape)]
        turned = np.zeros_like(within)
        for axis, size in enumerate(self.shape):
            position = np.where(turned % 2 == 1, size - 1 - which[axis], which[axis])
            turned = turned * size + which[axis]
            which[axis] = position
        return np.ravel_multi_index(tuple(which), self.shape).astype(np.int64)

    def _mixed(self, number: int) -> NDArray[np.int64]:
        within = np.arange(self._one_pass, dtype=np.int64)
        if self.order == RANDOM:
            within = np.random.default_rng([self.seed, number]).permutation(within)
        elif self.order == SERPENTINE:
            within = self._serpentine(within)
        if self.by_hand:
            values = self.values(np.arange(self._one_pass, dtype=np.int64))
            keys = [values[name][within] for name in reversed(self.by_hand)]
            within = within[np.lexsort(keys)]
        return within


def spread(low: float, high: float, count: int, log: bool) -> tuple[float, ...]:
    """Levels from `low` to `high`, evenly, or evenly in the logarithm."""
    if count == 1:
        return (low,)
    values: Sequence[float] = (np.geomspace if log else np.linspace)(low, high, count).tolist()
    return tuple(values)
