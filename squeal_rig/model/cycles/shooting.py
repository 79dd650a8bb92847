"""Shooting: closed orbits as roots of the exact flow, and steps along a branch of them.

Unknowns are (x, y, vx, vy, T, lambda): a state of the orbit, the period and a parameter. Closure is z(T) - z(0) = 0,
four equations; its derivative is exact, from one pass of the flow: M - I by the state, f(z) by T, dz/dlambda by the
parameter. A fifth keeps the state from sliding along the orbit, f . (z - guess) = 0; a sixth fixes lambda, or the
distance along the branch (pseudo-arclength: Kuznetsov, Elements of Applied Bifurcation Theory, 3rd ed., section 10.2).
All in units of the rig: u = N*/k_c, the frequency of the start, and a scale of the parameter.

The section vx = 0 at the maximum of x serves what is shown and judged, not the continuation: near a fold the motion
along the belt can be so small that its maximum wanders round the orbit while that hardly changes.

Multipliers are 1 and those of the return map to a plane across f: P = (I - f f^T/|f|^2) M on it, a 3 x 3 matrix. At a
fold the eigenvalue 1 of M is double, of P it is simple.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from squeal_rig.model.core.forces import acceleration
from squeal_rig.model.core.kernel import kernel
from squeal_rig.model.core.layout import C_X, C_Y, MASS, Vector
from squeal_rig.model.core.statics import rest_position
from squeal_rig.model.cycles import flow
from squeal_rig.model.cycles.path import Path
from squeal_rig.model.motion.propagator import fastest_rate

#: Places of the unknowns after the state.
PERIOD, PARAMETER = 4, 5
UNKNOWNS = 6
# Rows of the state on the section vx = 0, and the one that is zero there.
_SECTION, _TURN = (0, 1, 3), 2
_ITERATIONS = 10
# Newton's step, in units of the motion, at which an orbit is closed for good, and at which it is where rounding leaves
# no smaller one.
_LAST_STEP, _CLOSED = 1e-12, 1e-9
# A step that changes the motion by more than this is another orbit's business.
_WILD = 30.0


@dataclass(repr=False)
class Orbit:
    """An orbit of one period: unknowns (6,), closing error (4,) and its derivative (4, 6) in scaled units, M (4, 4) and
    f (4,) at its end, the return map across f (3, 3), what `flow.follow` added up.
    """

    unknowns: Vector
    closing: Vector
    jacobian: Vector
    monodromy: Vector
    along: Vector
    across: Vector
    tally: Vector
    tangent: Vector | None = None
    _multipliers: NDArray[np.complex128] | None = None

    @property
    def state(self) -> Vector:
        return self.unknowns[:4]

    @property
    def parameter(self) -> float:
        return float(self.unknowns[PARAMETER])

    @property
    def period(self) -> float:
        return float(self.unknowns[PERIOD])

    @property
    def off_belt_share(self) -> float:
        return max(0.0, 1.0 - float(self.tally[flow.ON_BELT]) / self.period) if self.separates else 0.0

    @property
    def separates(self) -> bool:
        return bool(self.tally[flow.EVENTS] > 0.0)

    @property
    def return_map(self) -> Vector:
        """Derivative (3, 3) of the return map to vx = 0 by x, y, vy, of an orbit that begins there."""
        m, f = self.monodromy, self.along
        whole = m - np.outer(f, m[_TURN]) / f[_TURN]
        return np.ascontiguousarray(whole[np.ix_(_SECTION, _SECTION)])

    @property
    def multipliers(self) -> NDArray[np.complex128]:
        """1, and those of the return map, the largest first: complex (4,)."""
        if self._multipliers is None:
            found = np.linalg.eigvals(self.across).astype(np.complex128)
            order = np.lexsort((-found.imag, -np.abs(found)))
            self._multipliers = np.concatenate([[1.0 + 0.0j], found[order]])
        return self._multipliers

    @property
    def largest(self) -> float:
        """Largest modulus of the multipliers besides 1."""
        return float(np.abs(self.multipliers[1:]).max())

    @property
    def stable(self) -> bool:
        return self.largest < 1.0

    @property
    def flow_error(self) -> float:
        """|M f - f|/|f|, x and y times the rate: zero of an exact monodromy matrix."""
        rate = 2.0 * math.pi / self.period
        weights = np.array([rate, rate, 1.0, 1.0])
        off = (self.monodromy @ self.along - self.along) * weights
        return float(np.linalg.norm(off) / np.linalg.norm(self.along * weights))

    def volume_error(self, q: Vector) -> float:
        """det M against Liouville's exp(-(c_x + c_y) T/m): relative difference."""
        expected = math.exp(-(q[C_X] + q[C_Y]) * self.period / q[MASS])
        return float(abs(np.linalg.det(self.monodromy) / expected - 1.0))


class Shooter:
    """Closed orbits of one rig along one parameter; it holds the workspace, so one thread at a time.

    `size` u [m] and `rate` [rad/s] are the units of the motion, `span` that of the parameter.
    """

    def __init__(self, path: Path, size: float, rate: float, span: float) -> None:
        self.path = path
        self.scale = np.array([size, size, size * rate, size * rate, 2.0 * math.pi / rate, span])
        self._w = np.zeros((flow.ROWS, flow.ORDER + 1))
        self._no_path, self._fixed = np.empty((0, 4)), np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])

    def orbit(self, unknowns: Vector, path: Vector | None = None) -> Orbit | None:
        """The orbit from given unknowns, closed or not; None where it cannot be followed.

        Args:
            path: room (n, 4) for its states at times i T/n.
        """
        shot = self._shot(unknowns, unknowns, self._fixed, 0.0, self._no_path if path is None else path)
        return None if shot is None else shot[0]

    def _shot(
        self, unknowns: Vector, guess: Vector, row: Vector, aim: float, path: Vector
    ) -> tuple[Orbit, Vector] | None:
        """An orbit, and Newton's step (6,) in scaled units to a closed one on the plane row . unknowns/scale = aim."""
        if not 0.0 < unknowns[PERIOD] < math.inf:
            return None
        value = float(unknowns[PARAMETER])
        out, v, tally = np.empty(_SHOT), np.empty((4, flow.COLUMNS)), np.zeros(flow.TALLY_SIZE)
        q, dq = self.path.packed(value), self.path.derivative(value)
        if not _shoot(unknowns, guess, q, dq, self.scale, row, aim, self._w, v, tally, path, out):
            return None
        jacobian, across = out[_JACOBIAN:_ACROSS].reshape(4, UNKNOWNS), out[_ACROSS:_STEP].reshape(3, 3)
        return Orbit(unknowns, out[:4], jacobian, v[:, :4], out[4:8], across, tally), out[_STEP:]

    def close(self, guess: Vector, row: Vector, target: float | None = None) -> tuple[Orbit | None, int]:
        """The closed orbit near a guess of the unknowns (6,) on the plane row . unknowns/scale = target, and the
        number of Newton steps; None where Newton's method does not converge.

        `target` None keeps the guess on its own plane; with row (0, 0, 0, 0, 0, 1) that fixes the parameter.
        """
        unknowns = np.array(guess)
        aim = float(row @ (unknowns / self.scale)) if target is None else target
        best: Orbit | None = None
        error, iterations = math.inf, 0
        while iterations < _ITERATIONS:
            iterations += 1
            shot = self._shot(unknowns, guess, row, aim, self._no_path)
            if shot is None:
                break
            orbit, step = shot
            size = float(np.abs(step).max())
            if size < error:
                best, error = orbit, size
            elif error <= _CLOSED:
                break  # rounding: it gets no smaller
            if size <= _LAST_STEP or not size < _WILD:
                break
            unknowns = unknowns + step * self.scale
        # Large motions close to their own rounding, not to that of u.
        if best is None or not error <= _CLOSED * max(1.0, float(np.abs(best.unknowns[:4] / self.scale[:4]).max())):
            return None, _ITERATIONS
        return best, iterations

    def close_at(self, guess: Vector, value: float) -> Orbit | None:
        """The closed orbit near a guess at a given value of the parameter."""
        start = np.array(guess)
        start[PARAMETER] = value
        return self.close(start, self._fixed)[0]

    def on_section(self, orbit: Orbit, path: Vector | None = None) -> Orbit:
        """The same orbit from its largest maximum of x on, where vx = 0; itself where it has none. `path` as above."""
        q = self.path.packed(orbit.parameter)
        z, v, tally = np.array(orbit.state), np.empty((4, flow.COLUMNS)), np.zeros(flow.TALLY_SIZE)
        longest = flow.RATE_TIMES_STEP / fastest_rate(q)
        passed, highest, start = 0.0, -math.inf, np.array(orbit.unknowns)
        while passed < 1.001 * orbit.period:
            took = flow.to_section(z, v, q, longest, 1.1 * orbit.period, self._w, tally)
            if not took > 0.0:
                break
            passed += took
            # The first of equal ones: the orbit passes each once more.
            if z[0] > highest + 1e-9 * self.scale[0]:
                highest, start[:4] = z[0], z
        return self.orbit(start, path) or orbit

    def tangent(self, orbit: Orbit, like: Vector) -> Vector | None:
        """Unit tangent (6,) of the branch in scaled units, across the orbit, on the side of `like`."""
        found = np.empty(UNKNOWNS)
        if not _tangent(orbit.jacobian, orbit.along / self.scale[:4], like, found):
            return None
        return found


# What a shot returns: closing error (4), f (4), Jacobian (4, 6), return map (3, 3), Newton's step (6).
_JACOBIAN, _ACROSS, _STEP, _SHOT = 8, 32, 41, 47


@kernel
def _shoot(
    unknowns: Vector,
    guess: Vector,
    q: Vector,
    dq: Vector,
    scale: Vector,
    row: Vector,
    aim: float,
    w: Vector,
    v: Vector,
    tally: Vector,
    path: Vector,
    out: Vector,
) -> bool:
    """Follow one period and solve for Newton's step; False where either cannot be done."""
    z = unknowns[:4].copy()
    v[:] = 0.0
    for i in range(4):
        v[i, i] = 1.0
    tally[flow.X0], tally[flow.Y0], _ = rest_position(q)
    tally[flow.HIGHEST], tally[flow.LOWEST], tally[flow.FASTEST] = -math.inf, math.inf, -math.inf
    longest = flow.RATE_TIMES_STEP / fastest_rate(q)
    if not flow.follow(z, v, q, dq, unknowns[PERIOD], longest, True, True, w, tally, path):
        return False
    out[4], out[5] = z[2], z[3]
    out[6], out[7] = acceleration(z[0], z[1], z[2], z[3], q)
    matrix = np.empty((UNKNOWNS, UNKNOWNS + 1))
    for i in range(4):
        out[i] = (z[i] - unknowns[i]) / scale[i]
        for c in range(4):
            matrix[i, c] = (v[i, c] - (1.0 if i == c else 0.0)) * scale[c] / scale[i]
        matrix[i, PERIOD] = out[4 + i] * scale[PERIOD] / scale[i]
        matrix[i, PARAMETER] = v[i, 4] * scale[PARAMETER] / scale[i]
        matrix[i, UNKNOWNS] = -out[i]
        for c in range(UNKNOWNS):
            out[_JACOBIAN + UNKNOWNS * i + c] = matrix[i, c]
    _across(v, out[4:8], scale, out[_ACROSS:_STEP])
    ax, ay = acceleration(guess[0], guess[1], guess[2], guess[3], q)
    size = 0.0
    for i in range(4):
        f = guess[2 + i] if i < 2 else (ax if i == 2 else ay)
        matrix[4, i] = f / scale[i]
        size += matrix[4, i] ** 2
    matrix[4, PERIOD], matrix[4, PARAMETER], matrix[4, UNKNOWNS] = 0.0, 0.0, 0.0
    matrix[5, UNKNOWNS] = aim
    for c in range(4):
        matrix[4, c] /= math.sqrt(size)
        matrix[4, UNKNOWNS] -= matrix[4, c] * (unknowns[c] - guess[c]) / scale[c]
    for c in range(UNKNOWNS):
        matrix[5, c] = row[c]
        matrix[5, UNKNOWNS] -= row[c] * unknowns[c] / scale[c]
    return _solve(matrix, out[_STEP:])


@kernel
def _across(v: Vector, f: Vector, scale: Vector, out: Vector) -> None:
    """B^T M B into `out` (9,), scaled: B are three columns of the reflection that takes f to an axis."""
    u = np.empty(4)
    size = 0.0
    for i in range(4):
        u[i] = f[i] / scale[i]
        size += u[i] * u[i]
    axis = 0
    for i in range(1, 4):
        if abs(u[i]) > abs(u[axis]):
            axis = i
    u[axis] += math.copysign(math.sqrt(size), u[axis])
    size = 0.0
    for i in range(4):
        size += u[i] * u[i]
    h = np.empty((4, 4))
    for i in range(4):
        for j in range(4):
            h[i, j] = (1.0 if i == j else 0.0) - 2.0 * u[i] * u[j] / size
    n = 0
    for i in range(4):
        for j in range(4):
            if axis in (i, j):
                continue
            value = 0.0
            for a in range(4):
                for b in range(4):
                    value += h[i, a] * v[a, b] * scale[b] / scale[a] * h[b, j]
            out[n] = value
            n += 1


@kernel
def _solve(matrix: Vector, out: Vector) -> bool:
    """Solve a linear system given as (n, n + 1) by elimination with row exchanges; False where it is singular."""
    n = matrix.shape[0]
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if abs(matrix[i, k]) > abs(matrix[pivot, k]):
                pivot = i
        # NaN fails this too.
        if not abs(matrix[pivot, k]) > 0.0:
            return False
        for j in range(k, n + 1):
            matrix[k, j], matrix[pivot, j] = matrix[pivot, j], matrix[k, j]
        for i in range(k + 1, n):
            factor = matrix[i, k] / matrix[k, k]
            for j in range(k, n + 1):
                matrix[i, j] -= factor * matrix[k, j]
    total = 0.0
    for k in range(n - 1, -1, -1):
        value = matrix[k, n]
        for j in range(k + 1, n):
            value -= matrix[k, j] * out[j]
        out[k] = value / matrix[k, k]
        total += out[k]
    return math.isfinite(total)


@kernel
def _tangent(jacobian: Vector, along: Vector, like: Vector, out: Vector) -> bool:
    """Unit vector that the Jacobian (4, 6) takes to zero, across `along` (4,), on the side of `like`."""
    matrix = np.zeros((UNKNOWNS, UNKNOWNS + 1))
    matrix[:4, :UNKNOWNS] = jacobian
    size = math.sqrt(np.sum(along * along))
    for i in range(4):
        matrix[4, i] = along[i] / size
    matrix[5, :UNKNOWNS] = like
    matrix[5, UNKNOWNS] = 1.0
    if not _solve(matrix, out):
        return False
    out /= math.sqrt(np.sum(out * out))
    return True
