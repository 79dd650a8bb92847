"""What becomes of a start: quiet for good, or squeal for good, by a criterion and not after a fixed time.

- Quiet: the pad is in contact, and the bound of its coming maximum, sum_j |w_j . z| |v_j,y| over the eigenvalues at
  the equilibrium (w, v: left and right eigenvectors, none of which grows), stays below u, so it does not leave the
  belt again, and dies out. The arms' nonlinearity, r/L of their force, has a margin.
- Squeal, settling: the motion passes the section inside the neighbourhood of the stable cycle that reaches half way to
  the separatrix, in the norm of the return map's eigenvectors, and its distance has halved in there.
- Squeal, outlasting: where that is not so after eight times the slowest decay of the linear motions on and off the
  belt, and the pad still leaves the belt: without friction's work nothing of the start would be left. Other cycles,
  tori and irregular motions end so.
- Left: the displacement passed the share of the arms up to which the model holds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from squeal_rig.errors import ModelError
from squeal_rig.model.core.forces import jacobian_of
from squeal_rig.model.core.kernel import kernel
from squeal_rig.model.core.layout import (
    A1X,
    A1Y,
    A2X,
    A2Y,
    C_X,
    C_Y,
    CACHE_LINE,
    K1,
    K2,
    K34,
    L1,
    L2,
    L_PRE,
    MASS,
    STATE_SIZE,
    VX,
    Vector,
    pack,
    sample_room,
)
from squeal_rig.model.core.statics import equilibrium
from squeal_rig.model.cycles import flow
from squeal_rig.model.cycles.path import refuse_what_has_no_cycles
from squeal_rig.model.cycles.shooting import Orbit
from squeal_rig.model.motion import exact, stepping
from squeal_rig.model.motion.propagator import ALL_PASSED, PASSED, RATE_TIMES_STEP, STEPS, fastest_rate, propagators
from squeal_rig.model.motion.series import MAX_ORDER, ROWS
from squeal_rig.model.motion.trajectory import LARGE_DISPLACEMENT
from squeal_rig.model.parameters import RigParameters

#: Verdicts.
QUIET, SETTLES, OUTLASTS, LEFT = range(4)
_FAR = 4  # no verdict yet: the motion has left the engine's near range, and the start is where it did
SENTENCES = (
    "dies out",
    "squeals for good: it settles on the squeal cycle",
    "squeals for good: it outlasts every transient without coming near the squeal cycle known",
    "leaves the range of displacements in which the model holds",
)
# Samples between two looks at a motion, about eight periods; of the last ones passages of the section are looked at.
_BLOCK, _LOOK = 256, 72
_MARGIN = 0.999
_OUTLASTED = 8.0
# Shares of the squared distance to the separatrix: the neighbourhood, and what counts as coming nearer in it.
_NEIGHBOURHOOD, _NEARER = 0.25, 0.5


@dataclass(frozen=True)
class Judge:
    """What verdicts on one rig need. `unit_impulse` m omega u [N s]: the impulse that moves the pad by about u."""

    p: RigParameters
    q: Vector
    flow: Vector
    rest: Vector
    compression: float
    rate: float
    quiet: Vector
    cycle: Vector
    limits: Vector

    @property
    def unit_impulse(self) -> float:
        return self.p.mass * self.rate * self.compression

    def verdicts(self, starts: Vector) -> tuple[NDArray[np.int64], Vector]:
        """Verdict and time simulated [s] of each start (n, 4): x, y, vx, vy."""
        states = np.array(starts, dtype=np.float64, order="C")
        found, times = self._judged(states)
        for i in np.flatnonzero(found == _FAR).tolist():
            found[i], times[i] = self._from_far(states[i], float(times[i]))
        return found, times

    def _judged(self, states: Vector) -> tuple[NDArray[np.int64], Vector]:
        found, times = np.empty(len(states), dtype=np.int64), np.empty(len(states))
        _judge(states, self.q, self.flow.copy(), self.rest, self.quiet, self.cycle, self.limits, found, times)
        return found, times

    def _from_far(self, state: Vector, spent: float) -> tuple[int, float]:
        """Verdict of a motion that has left the near range at `state` after a time [s]; and its time in all.

        None of the criteria can be met out there: the full equations bring it back, which few starts need.
        """
        _, outlasted, interval, _, far = self.limits
        maps, w, tally = self.flow.copy(), exact.workspace(), np.zeros(exact.TALLY_SIZE)
        block, events = sample_room(_BLOCK, STATE_SIZE), np.empty((0, 2))
        while True:
            ended, _ = stepping.advance(state, self.q, maps, 1, w, tally, events, block)
            spent += _BLOCK * interval
            if ended != exact.DONE or not float(np.abs(state[:2]).max()) <= far:
                return LEFT, spent
            if spent > outlasted:
                return OUTLASTS, spent
            again = state[None].copy()
            found, times = self._judged(again)
            spent += float(times[0])
            if found[0] != _FAR:
                return int(found[0]), spent
            state = again[0]
            maps[PASSED], maps[STEPS] = ALL_PASSED, 0.0

    def struck(self, impulse: float, direction: float) -> Vector:
        """The state (4,) after a hit at rest: impulse [N s], direction [rad] from the belt's, -pi/2 towards it."""
        kick = impulse / self.p.mass
        moved = np.array([0.0, 0.0, kick * math.cos(direction), kick * math.sin(direction)])
        return np.asarray(self.rest + moved)


def judge(p: RigParameters, squeal: Orbit | None = None, separatrix: Orbit | None = None) -> Judge:
    """The judge of one rig; with its stable squeal cycle and separatrix, verdicts of squeal come sooner.

    Raises:
        ModelError: the rig is refused, has no equilibrium, or one that grows by itself.
    """
    refuse_what_has_no_cycles(p)
    q = pack(p)
    x, y = equilibrium(p)
    rest = np.array([x, y, 0.0, 0.0])
    compression = p.pretension_length - y
    values, right = np.linalg.eig(jacobian_of(x, y, 0.0, q))
    if float(values.real.max()) >= 0.0:
        raise ModelError(
            f"no start dies out here: the equilibrium is unstable, Re lambda = {float(values.real.max()):.4g} 1/s"
        )
    left = np.linalg.inv(right) * np.abs(right[1])[:, None] / compression
    quiet = np.concatenate([left.real, left.imag]).astype(np.float64)
    rate = float(np.abs(values.imag).max()) or float(np.abs(values).max())
    cycle = np.zeros((7, 3))
    reach = math.nan
    if squeal is not None and separatrix is not None and squeal.stable:
        scale = np.array([compression, compression, compression * rate])
        own = squeal.return_map * scale / scale[:, None]
        _, modes = np.linalg.eig(own)
        rows = np.linalg.inv(modes) / scale
        cycle[0], cycle[1:4], cycle[4:7] = squeal.state[[0, 1, 3]], rows.real, rows.imag
        apart = separatrix.state[[0, 1, 3]] - cycle[0]
        reach = _NEIGHBOURHOOD * float(np.sum(np.abs(rows @ apart) ** 2))
    slowest = min(-float(values.real.max()), _slowest_off_belt(q))
    interval = RATE_TIMES_STEP / fastest_rate(q)
    maps = exact.empty_flow()
    propagators(q, interval, maps)
    far = LARGE_DISPLACEMENT * min(p.arm_length_1, p.arm_length_2)
    limits = np.array([reach, _OUTLASTED / slowest, interval, flow.RATE_TIMES_STEP / fastest_rate(q), far])
    return Judge(p, q, maps, rest, compression, rate, quiet, cycle, limits)


def _slowest_off_belt(q: Vector) -> float:
    """Slowest decay [1/s] of the linear motion off the belt; that of a drift, if it drifts, is c/m."""
    m = q[MASS]
    c1, s1, c2, s2 = q[A1X] / q[L1], q[A1Y] / q[L1], q[A2X] / q[L2], q[A2Y] / q[L2]
    ab = q[K1] * s1 * c1 + q[K2] * s2 * c2
    matrix = np.zeros((4, 4))
    matrix[0, 2] = matrix[1, 3] = 1.0
    matrix[2, :2] = -(q[K1] * c1 * c1 + q[K2] * c2 * c2 + q[K34]) / m, -ab / m
    matrix[3, :2] = -ab / m, -(q[K1] * s1 * s1 + q[K2] * s2 * s2) / m
    matrix[2, 2], matrix[3, 3] = -q[C_X] / m, -q[C_Y] / m
    rates = -np.linalg.eigvals(matrix).real
    falling = rates[rates > 1e-9 * np.abs(matrix).max() ** 0.5]
    return float(falling.min()) if len(falling) else math.inf


@kernel
def _coming_maximum(state: Vector, rest: Vector, quiet: Vector) -> float:
    """Bound of the coming max y - y*, in units of u, while the pad is in contact."""
    bound = 0.0
    for j in range(4):
        real, imaginary = 0.0, 0.0
        for i in range(4):
            real += quiet[j, i] * (state[i] - rest[i])
            imaginary += quiet[4 + j, i] * (state[i] - rest[i])
        bound += math.hypot(real, imaginary)
    return bound


@kernel
def _distance(state: Vector, cycle: Vector) -> float:
    """Squared distance of a state on the section from the cycle, in the norm of the return map's eigenvectors."""
    dx, dy, dv = state[0] - cycle[0, 0], state[1] - cycle[0, 1], state[3] - cycle[0, 2]
    total = 0.0
    for j in range(1, 7):
        total += (cycle[j, 0] * dx + cycle[j, 1] * dy + cycle[j, 2] * dv) ** 2
    return total


@kernel
def _judge(
    starts: Vector,
    q: Vector,
    maps: Vector,
    rest: Vector,
    quiet: Vector,
    cycle: Vector,
    limits: Vector,
    found: NDArray[np.int64],
    times: Vector,
) -> None:
    reach, outlasted, interval, longest, far = limits
    # As `sample_room`, which compiled code cannot call.
    block, w = np.empty((STATE_SIZE, _BLOCK + CACHE_LINE)).T[:_BLOCK], np.zeros((ROWS, MAX_ORDER + 1))
    tally, events = np.zeros(exact.TALLY_SIZE), np.empty((0, 2))
    room, columns, sums = np.zeros((flow.ROWS, flow.ORDER + 1)), np.zeros((4, 5)), np.zeros(flow.TALLY_SIZE)
    state, on_section = np.empty(4), np.empty(4)
    latest = 2.0 * interval
    for n in range(starts.shape[0]):
        state[:] = starts[n]
        tally[:] = 0.0
        time, entered, verdict = 0.0, math.nan, -1
        maps[PASSED], maps[STEPS] = ALL_PASSED, 0.0
        while verdict < 0:
            if state[1] < q[L_PRE] and _coming_maximum(state, rest, quiet) < _MARGIN:
                verdict = QUIET
                break
            before = tally[exact.SEPARATIONS]
            ended, _ = exact.advance(state, q, maps, 1, w, tally, events, block)
            if ended == exact.BEYOND:
                verdict = _FAR
                starts[n] = state
                break
            time += _BLOCK * interval
            if ended != exact.DONE or not max(abs(state[0]), abs(state[1])) <= far:
                verdict = LEFT
                break
            if tally[exact.SEPARATIONS] == before:
                continue
            if reach > 0.0:
                nearest = math.inf
                for i in range(_BLOCK - _LOOK, _BLOCK - 1):
                    if block[i, VX] > 0.0 >= block[i + 1, VX]:
                        on_section[:] = block[i]
                        took = flow.to_section(on_section, columns, q, longest, latest, room, sums)
                        if took <= latest:
                            nearest = min(nearest, _distance(on_section, cycle))
                if nearest <= reach:
                    if math.isnan(entered):
                        entered = nearest
                    elif nearest <= _NEARER * entered:
                        verdict = SETTLES
                        break
                else:
                    entered = math.nan
            if time > outlasted:
                verdict = OUTLASTS
        found[n], times[n] = verdict, time
