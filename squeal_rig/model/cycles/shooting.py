"""Shooting: closed orbits as roots of the exact flow, and steps along a branch of them.

Unknowns are (x, y, vy, T, lambda): the state where x has its maximum (vx = 0), the period and a parameter. Closure is
z(T) - z(0) = 0, four equations; its derivative is exact, from one pass of the flow:
M - I by the state, f(z) by T, dz/dlambda by the parameter. A fifth equation fixes lambda, or the distance along the
branch (pseudo-arclength: Kuznetsov, Elements of Applied Bifurcation Theory, 3rd ed., section 10.2). All in units of
the rig: u = N*/k_c, the frequency of the start, and a scale of the parameter.

Multipliers are 1 and those of the return map to vx = 0, a 3 x 3 matrix: P = (I - f e^T/(e.f)) M on the section. At a
fold the eigenvalue 1 of M is double, of P it is simple.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from squeal_rig.model.core.forces import acceleration
from squeal_rig.model.core.layout import C_X, C_Y, MASS, Vector
from squeal_rig.model.core.statics import rest_position
from squeal_rig.model.cycles import flow
from squeal_rig.model.cycles.path import Path
from squeal_rig.model.motion.propagator import fastest_rate

#: Places of the unknowns.
X_AT, Y_AT, VY_AT, PERIOD, PARAMETER = range(5)
# Rows of the state that are unknown on the section, and the one that is zero there.
_SECTION, _TURN = (0, 1, 3), 2
_ITERATIONS = 10
# Newton ends with a step below this share of the motion: the next is its square.
_LAST_STEP = 1e-6
_CLOSED = 1e-10
# A step that changes the motion by more than this is another orbit's business.
_WILD = 30.0


@dataclass
class Orbit:
    """An orbit of one period: unknowns (5,), state (4,) on the section, closing error (4,) and its derivative (4, 5)
    in scaled units, M (4, 4) and f (4,) at its end, what `flow.follow` added up.
    """

    unknowns: Vector
    state: Vector
    closing: Vector
    jacobian: Vector
    monodromy: Vector
    along: Vector
    tally: Vector
    tangent: Vector | None = None
    _returns: dict[str, NDArray[np.complex128]] = field(default_factory=dict)

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
        """Derivative (3, 3) of the return map to vx = 0 by x, y, vy."""
        m, f = self.monodromy, self.along
        whole = m - np.outer(f, m[_TURN]) / f[_TURN]
        return np.ascontiguousarray(whole[np.ix_(_SECTION, _SECTION)])

    @property
    def multipliers(self) -> NDArray[np.complex128]:
        """1, and those of the return map, the largest first: complex (4,)."""
        if "all" not in self._returns:
            found = np.linalg.eigvals(self.return_map).astype(np.complex128)
            order = np.lexsort((-found.imag, -np.abs(found)))
            self._returns["all"] = np.concatenate([[1.0 + 0.0j], found[order]])
        return self._returns["all"]

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
        self.scale = np.array([size, size, size * rate, 2.0 * math.pi / rate, span])
        self._closing = np.array([size, size, size * rate, size * rate])
        self._w = np.zeros((flow.ROWS, flow.ORDER + 1))
        self._no_path = np.empty((0, 4))

    def orbit(self, unknowns: Vector, measure: bool = False, path: Vector | None = None) -> Orbit | None:
        """The orbit from given unknowns, closed or not; None where it cannot be followed.

        Args:
            measure: fill the peaks of its tally.
            path: room (n, 4) for its states at times i T/n.
        """
        x, y, vy, period, value = unknowns.tolist()
        if not 0.0 < period < math.inf:
            return None
        q = self.path.packed(value)
        state = np.array([x, y, 0.0, vy])
        z, v, tally = state.copy(), np.zeros((4, flow.COLUMNS)), np.zeros(flow.TALLY_SIZE)
        v[0, 0] = v[1, 1] = v[2, 2] = v[3, 3] = 1.0
        if measure:
            tally[flow.X0], tally[flow.Y0], _ = rest_position(q)
            tally[flow.HIGHEST], tally[flow.LOWEST], tally[flow.FASTEST] = -math.inf, math.inf, -math.inf
        longest = flow.RATE_TIMES_STEP / fastest_rate(q)
        points = self._no_path if path is None else path
        dq = self.path.derivative(value)
        if not flow.follow(z, v, q, dq, period, longest, True, measure, self._w, tally, points):
            return None
        along = np.array([z[2], z[3], *acceleration(z[0], z[1], z[2], z[3], q)])
        matrix = np.ascontiguousarray(v[:, :4])
        jacobian = np.empty((4, 5))
        for column, row in enumerate(_SECTION):
            jacobian[:, column] = matrix[:, row]
            jacobian[row, column] -= 1.0
        jacobian[:, PERIOD], jacobian[:, PARAMETER] = along, v[:, 4]
        jacobian *= self.scale
        jacobian /= self._closing[:, None]
        if not math.isfinite(float(jacobian.sum())):
            return None
        return Orbit(np.array(unknowns), state, (z - state) / self._closing, jacobian, matrix, along, tally)

    def close(self, guess: Vector, row: Vector, target: float | None = None) -> tuple[Orbit | None, int]:
        """The closed orbit near a guess of the unknowns (5,) on the plane row . unknowns/scale = target, and the
        number of Newton steps; None where Newton's method does not converge.

        `target` None keeps the guess on its own plane; with row (0, 0, 0, 0, 1) that fixes the parameter.
        """
        unknowns = np.array(guess)
        aim = float(row @ (unknowns / self.scale)) if target is None else target
        matrix, right = np.empty((5, 5)), np.empty(5)
        matrix[4] = row
        for iteration in range(1, _ITERATIONS + 1):
            orbit = self.orbit(unknowns)
            if orbit is None:
                return None, iteration
            matrix[:4] = orbit.jacobian
            right[:4] = -orbit.closing
            right[4] = aim - float(row @ (unknowns / self.scale))
            try:
                step = np.linalg.solve(matrix, right)
            except np.linalg.LinAlgError:
                return None, iteration
            size = float(np.abs(step).max())
            if not size < _WILD:
                return None, iteration
            unknowns = unknowns + step * self.scale
            if size <= _LAST_STEP:
                orbit = self.orbit(unknowns, measure=True)
                # Large motions close to their own rounding, not to that of u.
                reach = max(1.0, float(np.abs(unknowns[:3] / self.scale[:3]).max()))
                if orbit is None or not float(np.abs(orbit.closing).max()) <= _CLOSED * reach:
                    return None, iteration
                return orbit, iteration
        return None, _ITERATIONS

    def close_at(self, guess: Vector, value: float) -> Orbit | None:
        """The closed orbit near a guess at a given value of the parameter."""
        start = np.array(guess)
        start[PARAMETER] = value
        return self.close(start, np.array([0.0, 0.0, 0.0, 0.0, 1.0]))[0]

    def tangent(self, orbit: Orbit, like: Vector) -> Vector | None:
        """Unit tangent (5,) of the branch in scaled units, on the side of `like`."""
        matrix = np.vstack([orbit.jacobian, like])
        try:
            found = np.linalg.solve(matrix, np.array([0.0, 0.0, 0.0, 0.0, 1.0]))
        except np.linalg.LinAlgError:
            return None
        return np.asarray(found / np.linalg.norm(found))
