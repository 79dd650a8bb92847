"""The hit below which the pad provably stays on the belt and comes to rest again: a lower bound, not an estimate.

A hit J in any direction starts the motion z' = A z + B g(r) about the equilibrium, as long as the pad is in contact:
A the linear part there, friction included, g what the arms' rotation adds. Linear: y(t) = h(t) . J/m, h the response of
y to unit changes of vx and vy, so y stays below |h(t)| J/m. With

    G_y >= max_t |h|,  G_r >= max_t of the same for r,      I_y, I_r >= their integrals over all time,
    |g(r)| <= beta |r|^2 as long as |r| <= D:               beta = sum k_i/(m L_i) (0.58 + 4 D/L_i)

(`motion.propagator`: 0.58 is the bound of the second order, 2 (r/L)^n of each further one, taken about r* with
|r*| + D in place of D) variation of constants gives y <= G_y J/m + I_y beta D^2 and |r| <= G_r J/m + I_r beta D^2: D
that satisfies the second with equality bounds the motion, and J is safe where the first stays below u. The motion then
dies out where the quadratic Lyapunov function falls in spite of g.

The maxima are taken rigorously: on samples of the matrix exponential, between two of them no further than the chord by
h^2/8 max|y''|, and after the last by the Lyapunov function V = z^T P z, A^T P + P A = -I (in units u, u omega).
"""

from __future__ import annotations

import math

import numpy as np

from squeal_rig.model.core.forces import jacobian_of
from squeal_rig.model.core.kernel import kernel
from squeal_rig.model.core.layout import Vector, pack
from squeal_rig.model.core.statics import equilibrium
from squeal_rig.model.cycles.path import refuse_what_has_no_cycles
from squeal_rig.model.parameters import RigParameters

# Samples per radian of the fastest rate, and at most so many; after them the Lyapunov bound stands alone.
_SAMPLES_PER_RADIAN, _MOST = 25.0, 2_000_000
# Rounding of a million products of matrices, and of the solution of the Lyapunov equation.
_ROUNDING = 1e-6
_SECOND_ORDER = 0.58


def safe_hit(p: RigParameters) -> float:
    """Largest impulse [N s] that is proven safe: no hit up to it, in any direction, lets the pad at rest leave the
    belt, and the motion dies out.

    0 where the equilibrium is unstable. A lower bound of `smallest_hit`: near it where damping is not too light, since
    what the arms' rotation could add is bounded at its worst.

    Raises:
        ModelError: the rig is refused (friction that sees the slip, no damping), or has no equilibrium in contact.
    """
    refuse_what_has_no_cycles(p)
    x, y = equilibrium(p)
    u = p.pretension_length - y
    a = jacobian_of(x, y, 0.0, pack(p))
    values = np.linalg.eigvals(a)
    if not float(values.real.max()) < 0.0:
        return 0.0
    rate = float(np.abs(values).max())
    # In units of length u and time 1/rate.
    scale = np.array([1.0, 1.0, rate, rate])
    unit = a * scale / scale[:, None] / rate
    lyapunov = _lyapunov(unit)
    if lyapunov is None:
        return 0.0
    inverse = np.linalg.inv(lyapunov)
    # |y| <= sqrt(V inverse_yy) and |r| likewise; V falls at least at 1/max eigenvalue of P.
    spread = np.array([inverse[1, 1], inverse[0, 0] + inverse[1, 1], 0.0])
    row = unit[3]
    spread[2] = float(row @ inverse @ row) + float(unit[2] @ inverse @ unit[2])
    eigen = np.linalg.eigvalsh(lyapunov)
    step = 1.0 / _SAMPLES_PER_RADIAN
    sums = np.empty(4)
    _responses(_exponential(unit, step), lyapunov, spread, float(eigen[-1]), step, _MOST, sums)
    g_y, g_r, i_y, i_r = (1.0 + _ROUNDING) * sums
    # u/mass: an impulse J changes the speed by J/m, in units of u rate.
    lengths = (p.arm_length_1, p.arm_length_2)
    stiffness = (p.k1, p.k2)
    rest = math.hypot(x, y)

    def allowed(displacement: float) -> float:
        """Speed J/m in units of u rate at which |r| stays within a displacement [u], y within 1, and V falls."""
        far = (rest + displacement * u) / min(lengths)
        if far >= 0.1:
            return 0.0
        beta = sum(
            k / (p.mass * length) * (_SECOND_ORDER + 4.0 * far) for k, length in zip(stiffness, lengths, strict=True)
        )
        force = beta * u / rate**2 * displacement**2
        falls = 2.0 * float(np.linalg.norm(lyapunov[:, 2:], 2)) * beta * u / rate**2 * displacement < 1.0
        return min((1.0 - i_y * force) / g_y, (displacement - i_r * force) / g_r) if falls else 0.0

    # The best displacement bound: a maximum of one variable, any value of which is a valid bound.
    start = g_r / g_y
    best = max(allowed(start * (1.0 + share)) for share in np.geomspace(1e-4, 3.0, 60).tolist())
    return max(0.0, best) * u * rate * p.mass


def _lyapunov(a: Vector) -> Vector | None:
    """P of A^T P + P A = -I, with the right side's error bounded away; None where it is not positive definite."""
    n = len(a)
    eye = np.eye(n)
    system = np.kron(eye, a.T) + np.kron(a.T, eye)
    try:
        found = np.linalg.solve(system, -eye.ravel()).reshape(n, n)
    except np.linalg.LinAlgError:
        return None
    found = 0.5 * (found + found.T)
    # V falls where A^T P + P A is negative definite, whatever rounding did to P.
    off = float(np.abs(a.T @ found + found @ a + eye).max())
    if not (off < 1e-3 and float(np.linalg.eigvalsh(found)[0]) > 0.0):
        return None
    return np.asarray(found)


def _exponential(a: Vector, h: float) -> Vector:
    """e^{Ah} to rounding; |A| h is far below 1."""
    whole = np.eye(len(a))
    term = np.eye(len(a))
    for n in range(1, 20):
        term = term @ a * (h / n)
        whole = whole + term
    return whole


@kernel
def _responses(
    flow: Vector, lyapunov: Vector, spread: Vector, largest: float, h: float, most: int, out: Vector
) -> None:
    """Bounds of max |y|, max |r| and of their integrals over all time into `out` (4,): responses to unit speeds."""
    z = np.zeros((4, 2))
    z[2, 0] = z[3, 1] = 1.0
    following = np.empty((4, 2))
    out[:] = 0.0
    y_before, r_before = 0.0, 0.0
    v = 0.0
    for n in range(most):
        v = 0.0
        for c in range(2):
            for i in range(4):
                for j in range(4):
                    v += z[i, c] * lyapunov[i, j] * z[j, c]
        # What is left cannot exceed the maxima any more, and adds little to the integrals.
        tail = 2.0 * largest * math.sqrt(v)
        small = n > 0 and tail * math.sqrt(spread[0]) <= 1e-3 * out[2] and tail * math.sqrt(spread[1]) <= 1e-3 * out[3]
        if small and math.sqrt(v * spread[0]) <= out[0] and math.sqrt(v * spread[1]) <= out[1]:
            break
        for i in range(4):
            for c in range(2):
                following[i, c] = 0.0
                for j in range(4):
                    following[i, c] += flow[i, j] * z[j, c]
        z[:] = following
        y = math.hypot(z[1, 0], z[1, 1])
        r = math.sqrt(z[0, 0] ** 2 + z[0, 1] ** 2 + z[1, 0] ** 2 + z[1, 1] ** 2)
        off_chord = 0.125 * h * h * math.sqrt(v * spread[2])
        out[0] = max(out[0], max(y, y_before) + off_chord)
        out[1] = max(out[1], max(r, r_before) + off_chord)
        out[2] += h * (max(y, y_before) + off_chord)
        out[3] += h * (max(r, r_before) + off_chord)
        y_before, r_before = y, r
    out[0] = max(out[0], math.sqrt(v * spread[0]))
    out[1] = max(out[1], math.sqrt(v * spread[1]))
    out[2] += 2.0 * largest * math.sqrt(v * spread[0])
    out[3] += 2.0 * largest * math.sqrt(v * spread[1])
