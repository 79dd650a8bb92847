"""Reference: DOP853 at rtol 1e-12, restarted at every contact event, events refined on the solution itself."""

from __future__ import annotations

import numba
import numpy as np
from scipy.integrate import solve_ivp

from squeal_rig.model import RigParameters
from squeal_rig.model.core.forces import friction_ratio, spring_force
from squeal_rig.model.core.layout import C_X, C_Y, K_C, L_PRE, LOAD_X, LOAD_Y, MASS, pack

RTOL, ATOL = 1e-12, 1e-18


@numba.njit  # not cached: the tests and the benchmarks know this module by two names
def derivative(z, q, contact, scale, out):
    """Right-hand side in units of `scale`, the contact spring kept on or off whatever y is (smooth past the event)."""
    x, y, vx, vy = z[0] * scale[0], z[1] * scale[1], z[2] * scale[2], z[3] * scale[3]
    fx, fy = spring_force(x, y, q)
    normal = q[K_C] * (q[L_PRE] - y) if contact else 0.0
    fx += q[LOAD_X] - q[C_X] * vx + friction_ratio(vx, q) * normal
    fy += q[LOAD_Y] - q[C_Y] * vy + normal
    out[0], out[1] = vx / scale[0], vy / scale[1]
    out[2], out[3] = fx / q[MASS] / scale[2], fy / q[MASS] / scale[3]


def reference(p: RigParameters, start, times):
    """States (n, 4) at `times` (n,), and the contact events [s], from `start` at time 0."""
    q = pack(p)
    length = 1e-5
    scale = np.array([length, length, length * 1e4, length * 1e4])
    edge = p.pretension_length

    def solve(z, t0, t1, contact, event=None, t_eval=None):
        def f(t, z):
            out = np.empty(4)
            derivative(z, q, contact, scale, out)
            return out

        return solve_ivp(f, (t0, t1), z, method="DOP853", rtol=RTOL, atol=ATOL / length, events=event, t_eval=t_eval)

    states = np.empty((len(times), 4))
    t, z, end, found = 0.0, np.asarray(start) / scale, float(times[-1]), []
    states[0] = z * scale
    done = 1
    contact = start[1] < edge
    while t < end:
        sign = 1.0 if contact else -1.0

        def crossing(t, z, sign=sign):
            return sign * (z[1] - edge / scale[1])

        crossing.terminal, crossing.direction = True, 1.0
        part = solve(z, t, end, contact, crossing)
        hit = part.status == 1
        until = float(part.t[-1])
        asked = [time for time in times[done:] if time <= until]
        z_at, t_at = z, t
        for time in asked:  # no dense output: it is of lower order than the solution
            z_at = solve(z_at, t_at, time, contact).y[:, -1] if time > t_at else z_at
            t_at = time
            states[done] = z_at * scale
            done += 1
        if until > t_at:
            z_at, t_at = solve(z_at, t_at, until, contact).y[:, -1], until
        if hit:
            for _ in range(3):  # Newton on the solution itself
                dt = -(z_at[1] * scale[1] - edge) / (z_at[3] * scale[3])
                if abs(dt) <= 1e-18 + 2.3e-16 * t_at:
                    break
                z_at, t_at = solve(z_at, t_at, t_at + dt, contact).y[:, -1], t_at + dt
            z_at[1] = edge / scale[1]
            found.append(t_at)
            contact = not contact
        z, t = z_at, t_at
    return states, np.array(found)
