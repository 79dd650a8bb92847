"""An independent reading of the model: Eq. (2.3) and Eqs. (3.1), (3.2) in plain Python, integrated by SciPy.

Nothing here calls the package's physics; parameters are read by name from any object that has them.
"""

import math

import numpy as np
from scipy.integrate import solve_ivp

#: Tolerances of the reference solution. The motion is of the size of 1e-5 m: SciPy's own atol of 1e-6 would hide it.
RTOL, ATOL = 1e-12, 1e-18


def friction_law(p, speed, preload):
    return p.mu0 + p.mu_speed * speed + p.mu_preload * preload + p.mu_speed_preload * speed * preload


def friction_ratio(p, vx):
    """F_t / N with both switches."""
    slip = p.belt_speed - vx
    ratio = friction_law(p, abs(slip) if p.friction_speed == "slip" else p.belt_speed, p.preload)
    return ratio * math.tanh(slip / p.regularization_speed) if p.friction_direction == "slip" else ratio


def acceleration(p, state, normal_force):
    """Eq. (2.3) at a given normal contact force."""
    x, y, vx, vy = state
    force_x = -(p.k3 + p.k4) * x - p.damping_x * vx + friction_ratio(p, vx) * normal_force
    force_y = -p.damping_y * vy + normal_force
    for k, length, angle in arms(p):
        along_x, along_y = x - length * math.cos(angle), y - length * math.sin(angle)
        stretched = math.hypot(along_x, along_y)
        force_x -= k * (stretched - length) * along_x / stretched
        force_y -= k * (stretched - length) * along_y / stretched
        force_y -= p.preload * math.sin(angle)
        if p.preload_direction == "arms":
            force_x -= p.preload * math.cos(angle)
    return force_x / p.mass, force_y / p.mass


def arms(p):
    return (p.k1, p.arm_length_1, p.arm_angle_1), (p.k2, p.arm_length_2, p.arm_angle_2)


def state_derivative(p, state):
    normal_force = p.contact_stiffness * max(0.0, p.pretension_length - state[1])
    return np.array([state[2], state[3], *acceleration(p, state, normal_force)])


def energy(p, state):
    """Kinetic energy, springs, closed contact and vertical preload [J]."""
    x, y, vx, vy = state
    total = 0.5 * p.mass * (vx * vx + vy * vy) + 0.5 * (p.k3 + p.k4) * x * x
    total += 0.5 * p.contact_stiffness * (p.pretension_length - y) ** 2
    for k, length, angle in arms(p):
        stretched = math.hypot(x - length * math.cos(angle), y - length * math.sin(angle))
        total += 0.5 * k * (stretched - length) ** 2 + p.preload * math.sin(angle) * y
    return total


def solve(p, start, times, max_events=0):
    """States (4, n) at `times` by DOP853, restarted at each contact event, and the times of the events.

    On each piece the contact is held open or closed, so that the integrator sees a smooth right-hand side.
    With `max_events` the solution ends at that event and the states cover the times before it.
    """
    times = np.asarray(times)
    closed = start[1] < p.pretension_length
    t, state = float(times[0]), np.array(start, dtype=float)
    states, events = [], []
    while True:
        piece = _piece(p, closed, t, state, times)
        states.append(piece.sol(times[(times >= t) & (times <= piece.t[-1])]))
        if piece.status != 1:
            break
        t, state, closed = float(piece.t[-1]), piece.y[:, -1], not closed
        events.append(t)
        if len(events) == max_events:
            break
        times_left = times[times > t]
        if times_left.size == 0:
            break
    return np.concatenate(states, axis=1), np.array(events)


def _piece(p, closed, t, state, times):
    def right_hand_side(_, s):
        normal_force = p.contact_stiffness * (p.pretension_length - s[1]) if closed else 0.0
        return [s[2], s[3], *acceleration(p, s, normal_force)]

    def crossing(_, s):
        return s[1] - p.pretension_length

    crossing.terminal = True
    crossing.direction = 1.0 if closed else -1.0
    return solve_ivp(
        right_hand_side,
        (t, float(times[-1])),
        state,
        method="DOP853",
        rtol=RTOL,
        atol=ATOL,
        dense_output=True,
        events=crossing,
    )


def stiffness(p, k):
    """K of Eqs. (3.1), (3.2), (n, 2, 2), at mean arm stiffnesses k (n,) and the ratio k1/k2 of p."""
    k = np.atleast_1d(np.asarray(k, dtype=float))
    share_1, share_2 = shares(p)
    s1, c1 = math.sin(p.arm_angle_1), math.cos(p.arm_angle_1)
    s2, c2 = math.sin(p.arm_angle_2), math.cos(p.arm_angle_2)
    matrix = np.zeros((len(k), 2, 2))
    k_ab = share_1 * s1 * c1 + share_2 * s2 * c2
    if abs(k_ab) < 1e-12:  # mirrored arms: the rest is rounding
        k_ab = 0.0
    mu = friction_ratio(p, 0.0)
    matrix[:, 0, 0] = (share_1 * c1 * c1 + share_2 * c2 * c2) * k + p.k3 + p.k4
    matrix[:, 0, 1] = k_ab * k + mu * p.contact_stiffness
    matrix[:, 1, 0] = k_ab * k
    matrix[:, 1, 1] = (share_1 * s1 * s1 + share_2 * s2 * s2) * k + p.contact_stiffness
    return matrix


def shares(p):
    total = p.k1 + p.k2
    return (2.0 * p.k1 / total, 2.0 * p.k2 / total) if total > 0.0 else (1.0, 1.0)


def growth(p, k):
    """Largest Re(lambda)/|lambda| of the linear model at mean arm stiffnesses k (n,).

    In the time unit sqrt(m/k_c) all entries are of order one, which keeps the rounding of an undamped system at 1e-15
    away from coinciding eigenvalues.
    """
    stiffnesses = stiffness(p, k)
    rate = math.sqrt(p.contact_stiffness / p.mass)
    matrix = np.zeros((len(stiffnesses), 4, 4))
    matrix[:, 0, 2] = matrix[:, 1, 3] = 1.0
    matrix[:, 2:, :2] = -stiffnesses / p.contact_stiffness
    matrix[:, 2, 2] = -p.damping_x / p.mass / rate
    matrix[:, 3, 3] = -p.damping_y / p.mass / rate
    values = np.linalg.eigvals(matrix)
    return np.max(values.real / np.maximum(np.abs(values), 1e-30), axis=1)
