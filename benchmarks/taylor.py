"""heyoka: Taylor series with event detection, compiled by LLVM; one motion, and several at once in SIMD lanes.

Each contact event is a terminal event that switches the contact spring and goes on, so it solves what the exact engine
solves. The switch is a callback in Python: of one motion it costs a percent or two, of lanes more, since all wait for
it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from benchmarks.case import (
    CASE,
    DURATION,
    RATE,
    SCALE,
    START,
    TIMES,
    Point,
    faster_by,
    measured,
    ratio,
    speeds_in_turns,
)
from benchmarks.throughput import operating_arrays, operating_points
from squeal_rig.model import Motion, RigParameters, displaced_state, simulate_many
from squeal_rig.model.core.layout import (
    A1X,
    A1Y,
    A2X,
    A2Y,
    C_X,
    C_Y,
    K1,
    K2,
    K34,
    K_C,
    L1,
    L2,
    L_PRE,
    LOAD_X,
    LOAD_Y,
    MASS,
    MU,
    MU_AT_ZERO,
    MU_SLOPE,
    SPEED,
    V_REG,
    Vector,
    pack,
    sample_room,
)
from tests.model.dop853 import reference

TOLERANCES = (1e-6, 1e-9, 1e-12, 1e-15)
#: Friction that falls with the slip as it does over the paper's range, and keeps the motion bounded.
_FALLING = {"mu0": 0.82, "mu_speed": -0.02, "mu_preload": 0.0, "mu_speed_preload": 0.0}
SLIPPING = {
    "direction": CASE.replace(friction_direction="slip"),
    "speed": CASE.replace(friction_speed="slip", **_FALLING),
    "both": CASE.replace(friction_direction="slip", friction_speed="slip", **_FALLING),
}
# What differs from lane to lane, as heyoka's parameters after the switch of the contact.
_VARIED = (K1, K2, LOAD_Y, MU)


def _equations(p: RigParameters, lanes: bool) -> tuple[list[Any], Any]:
    """Eq. (2.3) in units of `SCALE` with par[0] = 1 in contact, 0 off the belt; and the gap, in pretension lengths."""
    import heyoka as hy

    packed = pack(p)
    q: dict[int, Any] = dict(enumerate(packed.tolist()))
    if lanes:
        q.update({column: hy.par[1 + n] for n, column in enumerate(_VARIED)})
    zs = hy.make_vars("x", "y", "vx", "vy")
    x, y, vx, vy = (z * scale for z, scale in zip(zs, SCALE.tolist(), strict=True))
    ratio = q[MU]
    if p.friction_speed == "slip":
        ratio = q[MU_AT_ZERO] + q[MU_SLOPE] * (q[SPEED] - vx)
    if p.friction_direction == "slip":
        ratio = ratio * hy.tanh((q[SPEED] - vx) / q[V_REG])
    normal = hy.par[0] * q[K_C] * (q[L_PRE] - y)
    fx = q[LOAD_X] - q[K34] * x - q[C_X] * vx + ratio * normal
    fy = q[LOAD_Y] - q[C_Y] * vy + normal
    for k, length, ax, ay in ((q[K1], q[L1], q[A1X], q[A1Y]), (q[K2], q[L2], q[A2X], q[A2Y])):
        square = x * x + y * y - 2.0 * (ax * x + ay * y)
        stretched = hy.sqrt(length * length + square)
        pull = k * square / (stretched + length) / stretched
        fx, fy = fx - pull * (x - ax), fy - pull * (y - ay)
    rates = (vx / SCALE[0], vy / SCALE[1], fx / q[MASS] / SCALE[2], fy / q[MASS] / SCALE[3])
    return list(zip(zs, rates, strict=True)), y / q[L_PRE] - 1.0


def one_motion(p: RigParameters, start: Vector, expected: Vector) -> Iterator[Point]:
    """heyoka on one motion sampled at `TIMES`, by tolerance."""
    import heyoka as hy

    def switch(solver: Any, _: int) -> bool:
        solver.pars[0] = 1.0 - solver.pars[0]
        return True

    equations, gap = _equations(p, lanes=False)
    for tolerance in TOLERANCES:
        event = hy.t_event(gap, callback=switch)
        solver = hy.taylor_adaptive(equations, [0.0] * 4, pars=[1.0], t_events=[event], tol=tolerance)

        def run(solver: Any = solver) -> Vector:
            solver.time = 0.0
            solver.state[:], solver.pars[0] = start / SCALE, 1.0
            solver.reset_cooldowns()
            states: Vector = solver.propagate_grid(TIMES)[-1]
            return states * SCALE

        yield measured("heyoka", f"tol {tolerance:g}", run, expected)


def heyoka(expected: Vector) -> Iterator[Point]:
    """heyoka on the case."""
    yield from one_motion(CASE, START, expected)


def slip_points() -> dict[str, list[Point]]:
    """The exact engine and heyoka where friction sees the slip, by what does."""
    found = {}
    for name, p in SLIPPING.items():
        start = displaced_state(p, 3.0)
        expected = reference(p, start, TIMES)[0]
        out, motion = sample_room(len(TIMES)), Motion(p, RATE, start)

        def run(out: Vector = out, motion: Motion = motion, start: Vector = start) -> Vector:
            motion.set_state(start)
            motion.advance(out)
            return out[:, :4]

        own = measured("exact", "51.2 kHz", run, expected)
        found[name] = [own, *one_motion(p, start, expected)]
    return found


def lanes_speed(points: int, duration: float, compressions: float) -> tuple[int, float, float, float]:
    """heyoka's batch mode on operating points, a multiple of 8, no samples, in turns with `simulate_many` on the same
    ones and one thread: heyoka's best number of lanes, both speeds in simulated s per wall s, the ratio of ours to it.
    """
    import heyoka as hy

    def switch(solver: Any, _: int, lane: int) -> bool:
        solver.pars[0, lane] = 1.0 - solver.pars[0, lane]
        return True

    rigs, arrays = operating_points(points), operating_arrays(points)

    def own() -> None:
        simulate_many(CASE, duration, initial_compressions=compressions, threads=1, **arrays)

    equations, gap = _equations(CASE, lanes=True)
    found = []
    for lanes in (4, 8):
        solver = hy.taylor_adaptive_batch(
            equations,
            np.zeros((4, lanes)),
            pars=np.ones((1 + len(_VARIED), lanes)),
            t_events=[hy.t_event_batch(gap, callback=switch)],
            tol=1e-12,
        )
        # Starts and parameters are made before: only heyoka's own work is measured.
        groups = []
        for first in range(0, points, lanes):
            group = rigs[first : first + lanes]
            starts = np.stack([displaced_state(p, compressions) / SCALE for p in group], axis=1)
            groups.append((starts, np.stack([pack(p)[list(_VARIED)] for p in group], axis=1)))

        def run(solver: Any = solver, groups: list[tuple[Vector, Vector]] = groups) -> None:
            for starts, varied in groups:
                solver.set_time(0.0)
                solver.reset_cooldowns()
                solver.state[:], solver.pars[0], solver.pars[1:] = starts, 1.0, varied
                solver.propagate_until(duration)

        run()
        own()
        peer, ours = speeds_in_turns([(run, points * duration), (own, points * duration)])
        found.append((lanes, max(peer), max(ours), ratio(ours, peer)))
    return min(found, key=lambda one: one[-1])


def fastest_within(points: list[Point], error: float) -> Point:
    """The fastest setting within an error, else the most exact one."""
    good = [point for point in points if point.error <= error]
    return min(good, key=lambda point: point.seconds) if good else min(points, key=lambda point: point.error)


def slip_table(points: dict[str, list[Point]], error: float) -> str:
    """The exact engine against heyoka's fastest setting within the error, which take turns for the ratio."""
    rows = [
        f"| friction that sees the slip | exact: error | times real time | heyoka at error <= {error:g} | error |"
        " times real time | exact is faster by |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, (own, *others) in points.items():
        peer = fastest_within(others, error)
        rows.append(
            f"| {name} | {own.error:.1e} | {DURATION / own.seconds:.3g} | {peer.setting} | {peer.error:.1e} |"
            f" {DURATION / peer.seconds:.3g} | {faster_by(own, peer):.1f} |"
        )
    return "\n".join(rows)
