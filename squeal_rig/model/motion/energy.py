"""Energy of the pad and the work of the forces that do not store any: friction and damping, to rounding."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from squeal_rig.errors import ModelError
from squeal_rig.model.core.forces import arm_extensions, contact_force, friction_ratio
from squeal_rig.model.core.kernel import kernel
from squeal_rig.model.core.layout import (
    C_X,
    C_Y,
    K1,
    K2,
    K34,
    K_C,
    L_PRE,
    LOAD_X,
    LOAD_Y,
    MASS,
    STATE_SIZE,
    Vector,
    pack,
    sample_room,
)
from squeal_rig.model.motion import exact, stepping
from squeal_rig.model.motion.exact import MAX_PIECES
from squeal_rig.model.motion.propagator import make_propagators, substeps_needed
from squeal_rig.model.motion.series import evaluate
from squeal_rig.model.motion.stepping import follow_piece, next_piece
from squeal_rig.model.motion.trajectory import checked_state, displaced_state, refuse_unless_positive
from squeal_rig.model.parameters import RigParameters

_BLOCK = 512
# Gauss-Legendre with 8 nodes on each smooth piece: order 16, rounding at rate times step 0.25.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
_NODES, _WEIGHTS = 0.5 * (_NODES + 1.0), 0.5 * _WEIGHTS


@dataclass(frozen=True)
class EnergyBalance:
    """Energies [J] of a motion: change of what is stored, work of friction, preload and damping on the pad.

    `turnover` is the integral of the absolute power of friction, the measure of how much went through; `largest` is
    the largest kinetic energy at a sample.
    """

    stored_change: float
    friction_work: float
    preload_work: float
    damping_work: float
    turnover: float
    largest: float
    separations: int

    @property
    def imbalance(self) -> float:
        """What the engine lost or made [J]: zero in exact arithmetic."""
        return self.stored_change - self.friction_work - self.preload_work - self.damping_work


@kernel
def stored_energy(state: Vector, q: Vector) -> float:
    """Kinetic energy and that of arms, clips and contact spring [J]."""
    e1, e2 = arm_extensions(state[0], state[1], q)
    pressed = max(0.0, q[L_PRE] - state[1])
    springs = q[K1] * e1 * e1 + q[K2] * e2 * e2 + q[K34] * state[0] * state[0] + q[K_C] * pressed * pressed
    return float(0.5 * (springs + q[MASS] * (state[2] * state[2] + state[3] * state[3])))


@kernel
def _work(samples: Vector, q: Vector, flow: Vector, interval: float, w: Vector, sums: Vector) -> int:
    """Add to `sums` (3,) the work of friction and damping and the turnover over the interval after each sample.

    Returns the number of the first sample after which the motion cannot be followed, all of them where it can.
    """
    state, at = np.empty(4), np.empty(4)
    for i in range(samples.shape[0]):
        state[:] = samples[i]
        rest = interval
        for _ in range(MAX_PIECES):
            share, order, what = next_piece(state, q, flow, rest, w)
            for n in range(_NODES.shape[0]):
                evaluate(w, order, share * _NODES[n], rest, at)
                friction = friction_ratio(at[2], q) * contact_force(at[1], q) * at[2]
                seconds = _WEIGHTS[n] * share * rest
                sums[0] += seconds * friction
                sums[1] -= seconds * (q[C_X] * at[2] * at[2] + q[C_Y] * at[3] * at[3])
                sums[2] += seconds * abs(friction)
            follow_piece(state, q, share, order, what, rest, w)
            rest *= 1.0 - share
            if rest <= 0.0:
                break
        if rest > 0.0:
            return i
    return len(samples)


def energy_balance(
    p: RigParameters, duration: float, sample_rate: float = 51200.0, initial_state: ArrayLike | None = None
) -> EnergyBalance:
    """Energy balance of a motion of the exact engine.

    The work is integrated on Taylor series from each sample on, piece by piece between contact events, so a fault
    of the engine's steps shows as imbalance.

    Args:
        p: parameters.
        duration: time simulated [s].
        sample_rate: samples per second [Hz].
        initial_state: (x, y, vx, vy) [m, m/s]; as in `simulate` when None.

    Raises:
        ParameterError: an argument is out of its bounds.
        ModelError: no equilibrium in contact to start from, or the motion left every bound.
    """
    refuse_unless_positive(duration=(duration, "s"), sample_rate=(sample_rate, "Hz"))
    q, flow, w = pack(p), exact.empty_flow(), exact.workspace()
    interval = 1.0 / sample_rate
    substeps = substeps_needed(q, interval, interval)
    make_propagators(q, interval / substeps, flow)
    state = displaced_state(p, 0.1) if initial_state is None else checked_state(initial_state)
    start = state.copy()
    tally, events, sums = np.zeros(exact.TALLY_SIZE), np.empty((0, 2)), np.zeros(3)
    block, largest = sample_room(_BLOCK, STATE_SIZE), 0.0
    samples = math.ceil(duration * sample_rate * (1.0 - 1e-12))
    for first in range(0, samples, _BLOCK):
        part = block[: samples - first]
        ended, filled = stepping.advance(state, q, flow, substeps, w, tally, events, part)
        exact.refuse_unless_done(ended, filled * interval)
        followed = _work(part, q, flow, interval, w, sums)
        exact.refuse_unless_done(exact.DONE if followed == len(part) else exact.STUCK, followed * interval)
        largest = max(largest, float(np.max(part[:, 2] ** 2 + part[:, 3] ** 2)))
    if not np.isfinite(sums).all():
        raise ModelError("the motion left every bound: no finite work")
    moved = state - start
    return EnergyBalance(
        stored_change=stored_energy(state, q) - stored_energy(start, q),
        friction_work=float(sums[0]),
        preload_work=float(q[LOAD_X] * moved[0] + q[LOAD_Y] * moved[1]),
        damping_work=float(sums[1]),
        turnover=float(sums[2]),
        largest=0.5 * p.mass * largest,
        separations=int(tally[exact.SEPARATIONS]),
    )
