"""Cycles, branches, hits and maps beside the same by finite differences on SciPy's DOP853, restarted at events."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from benchmarks.case import best_time
from squeal_rig.model import RigParameters, equilibrium, follow_cycle, smallest_hit, squeal_cycle, zone_map
from squeal_rig.model.core.layout import Vector, pack
from squeal_rig.model.cycles.zones import located
from tests.model.dop853 import derivative

CASE = RigParameters().replace(damping_x=200.0, damping_y=200.0)
_SCALE = np.array([1e-6, 1e-6, 1e-2, 1e-2])
_RTOL, _ATOL = 1e-10, 1e-10
_STEP = 1e-5


def _flow(p: RigParameters, start: Vector, duration: float) -> Vector:
    """State after a time, in units of `_SCALE`, by DOP853 restarted at each contact event; compiled right-hand side."""
    q, edge = pack(p), p.pretension_length / _SCALE[1]
    z, t = np.array(start), 0.0
    contact = z[1] < edge or (z[1] == edge and z[3] < 0.0)
    while t < duration:
        sign = 1.0 if contact else -1.0

        def rate(_: float, z: Vector, contact: bool = contact) -> Vector:
            out = np.empty(4)
            derivative(z, q, contact, _SCALE, out)
            return out

        def crossing(_: float, z: Vector, sign: float = sign) -> float:
            return sign * float(z[1] - edge)

        crossing.terminal, crossing.direction = True, 1.0  # type: ignore[attr-defined]
        part = solve_ivp(rate, (t, duration), z, method="DOP853", rtol=_RTOL, atol=_ATOL, events=crossing)
        t, z = float(part.t[-1]), part.y[:, -1]
        if part.status == 1:
            z[1], contact = edge, not contact
    return z


class _Peer:
    """Newton's method and pseudo-arclength on finite differences of that flow: unknowns z, T, mu0."""

    def __init__(self, p: RigParameters) -> None:
        self._p, self._scale = p, np.array([1.0, 1.0, 1.0, 1.0, 1e-4, 0.1])

    def _end(self, x: Vector) -> Vector:
        x = x * self._scale
        return _flow(self._p.replace(mu0=float(x[5])), x[:4], float(x[4])) - x[:4]

    def jacobian(self, x: Vector, at: Vector) -> Vector:
        columns = []
        for i in range(6):
            step = np.zeros(6)
            step[i] = _STEP
            columns.append((self._end(x + step) - at) / _STEP)
        return np.column_stack(columns)

    def close(self, x: Vector, row: Vector) -> tuple[Vector, Vector]:
        """The closed orbit on the plane through a guess, and the Jacobian there."""
        guess = np.array(x)
        phase = np.zeros(6)
        phase[2] = 1.0
        for _ in range(10):
            at = self._end(x)
            matrix = np.vstack([self.jacobian(x, at), phase, row])
            step = np.linalg.solve(matrix, -np.concatenate([at, [x[2]], [row @ (x - guess)]]))
            x = x + step
            if float(np.abs(step).max()) < 1e-6:
                break
        return x, matrix[:5]

    def branch(self, x: Vector, points: int) -> None:
        row = np.zeros(6)
        row[5] = 1.0
        for _ in range(points):
            x, jacobian = self.close(x, row)
            row = np.linalg.solve(np.vstack([jacobian, row]), np.eye(6)[5])
            row /= np.linalg.norm(row)
            x = x + 0.2 * row

    def start(self, state: Vector, period: float) -> Vector:
        return np.concatenate([state / _SCALE, [period], [self._p.mu0]]) / self._scale


def _once(run: Callable[[], Any]) -> float:
    begin = time.perf_counter()
    run()
    return time.perf_counter() - begin


def _hit_by_dop853(direction: float, low: float, high: float, periods: int, steps: int) -> float:
    """Seconds of a bisection of so many steps, each hit followed for a fixed number of periods."""
    x, y = equilibrium(CASE)

    def run() -> None:
        nonlocal low, high
        for _ in range(steps):
            middle = 0.5 * (low + high)
            kick = middle / CASE.mass
            start = np.array([x, y, kick * math.cos(direction), kick * math.sin(direction)]) / _SCALE
            _flow(CASE, start, periods * 1e-3)
            low = middle

    return _once(run)


def section() -> str:
    """Measure; the section of docs/benchmarks.md."""
    cycle = squeal_cycle(CASE)
    start = cycle.state * (1.0 + 1e-3)
    squeal_cycle(CASE, start)
    one = best_time(lambda: squeal_cycle(CASE, start), 20)
    peer = _Peer(CASE)
    fixed = np.zeros(6)
    fixed[5] = 1.0
    guess = peer.start(start, cycle.period)
    other_one = _once(lambda: peer.close(guess, fixed))
    found = follow_cycle(CASE, cycle, "mu0", bounds=(-0.1, 0.5))
    points = len(found.points)
    branch = best_time(lambda: follow_cycle(CASE, cycle, "mu0", bounds=(-0.1, 0.5)), 5) / points * 100.0
    some = 5
    other_branch = _once(lambda: peer.branch(peer.start(cycle.state, cycle.period), some)) / some * 100.0
    known, direction = located(CASE), 0.5 * math.pi
    hit = smallest_hit(CASE, direction, known=known)
    aided = best_time(lambda: smallest_hit(CASE, direction, known=known), 9)
    alone = best_time(lambda: smallest_hit(CASE, direction), 9)
    # Ten halvings bring a scan step to the same tolerance; 100 periods do where nothing is known of the cycle.
    other_hit = 5.0 * _hit_by_dop853(direction, 0.9 * hit.impulse, 1.1 * hit.impulse, 100, 2)
    grid = {"preload": np.linspace(10.0, 300.0, 200)[:, None], "belt_speed": np.linspace(1.0, 4.0, 200)[None, :]}
    zones = best_time(lambda: zone_map(CASE, **grid), 5)
    with_hits = best_time(lambda: zone_map(CASE, hits=True, **grid), 2)
    # Per point the peer would follow the branch from the squeal cycle over its fold: 30 orbits.
    other_zones = 40_000 * 0.3 * other_branch

    def line(name: str, asked: str, ours: float, theirs: float) -> str:
        return f"| {name} | {asked} | {1e3 * ours:.3g} ms | {theirs:.3g} s | {theirs / ours:.0f} |"

    return "\n".join(
        [
            "Case: preset, c = 200 N s/m. The peer: Newton's method and pseudo-arclength by one-sided differences on",
            f"SciPy's DOP853, rtol {_RTOL:g}, restarted at events, compiled right-hand side. Its longer figures are",
            "multiples of shorter ones measured in the same run: branch 5 points, hit 2 of 10 halvings of 100 periods,",
            "map 30 orbits a point (the map here solves a few machines and scales; the peer's does not).",
            "",
            "| what | asked | here | peer | ratio |",
            "|---|---|---|---|---|",
            line("a cycle from a start within 1e-3", "5 ms", one, other_one),
            line("a branch of 100 points", "300 ms", branch, other_branch),
            line("smallest hit in one direction, cycles known", "20 ms", aided, other_hit),
            line("the same, cycles to be found first", "", alone, other_hit),
            line("F x V map of 200 x 200 zones", "60 s", zones, other_zones),
            f"| the same with the smallest hit of each point | | {with_hits:.3g} s | | |",
            "",
        ]
    )
