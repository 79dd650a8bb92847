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
_SAMPLES_PER_RADIAN, _MOST = 16.0, 2_000_000
# Share of each integral that may be left to the Lyapunov function's bound of the tail; the looser, the sooner done.
_TAIL = 0.2
# V only falls: computed at each eighth sample, it bounds those after it.
_LOOK = 8
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
    g_y, g_r, i_y, i_r = response_bounds(unit)
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


def response_bounds(a: Vector) -> tuple[float, float, float, float]:
    """Proven upper bounds for z' = a z, a (4, 4) stable with rates up to about 1: max |y|, max |r| over all time of the
    responses to unit vx and vy together, and the integrals of both. Infinite where no Lyapunov function is found.
    """
    lyapunov = _lyapunov(a)
    if lyapunov is None:
        return math.inf, math.inf, math.inf, math.inf
    inverse = np.linalg.inv(lyapunov)
    # |y|^2 <= V inverse_yy, and likewise |r|^2 and |r''|^2; V falls at least at the rate 1/max eigenvalue of P.
    turned = float(a[2] @ inverse @ a[2] + a[3] @ inverse @ a[3])
    spread = np.array([inverse[1, 1], inverse[0, 0] + inverse[1, 1], turned])
    step = 1.0 / _SAMPLES_PER_RADIAN
    out = np.empty(4)
    largest = float(np.linalg.eigvalsh(lyapunov)[-1])
    _responses(_exponential(a, step), lyapunov, spread, largest, step, _MOST, out)
    g_y, g_r, i_y, i_r = ((1.0 + _ROUNDING) * out).tolist()
    return g_y, g_r, i_y, i_r


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
    out[:] = 0.0
    y_before, r_before = 0.0, 0.0
    v = 0.0
    for n in range(most):
        if n % _LOOK == 0:
            v = 0.0
            for c in range(2):
                for i in range(4):
                    for j in range(4):
                        v += z[i, c] * lyapunov[i, j] * z[j, c]
            # What is left cannot exceed the maxima any more, and adds little to the integrals.
            tail = 2.0 * largest * math.sqrt(v)
            small = tail * math.sqrt(spread[0]) <= _TAIL * out[2] and tail * math.sqrt(spread[1]) <= _TAIL * out[3]
            if small and math.sqrt(v * spread[0]) <= out[0] and math.sqrt(v * spread[1]) <= out[1]:
                break
        for c in range(2):
            a, b, d, e = z[0, c], z[1, c], z[2, c], z[3, c]
            for i in range(4):
                z[i, c] = flow[i, 0] * a + flow[i, 1] * b + flow[i, 2] * d + flow[i, 3] * e
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
