"""The peers, right-hand sides compiled: SciPy, numbalsoda, diffrax, heyoka, our own RK4. A missing one is noted."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numba
import numpy as np
from scipy.integrate import solve_ivp

from benchmarks.case import CASE, DURATION, PACKED, RATE, SCALE, START, TIMES, Point, measured
from benchmarks.taylor import heyoka
from squeal_rig.model import Motion
from squeal_rig.model.core.forces import acceleration
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
    Vector,
    sample_room,
)

RTOLS = (1e-4, 1e-6, 1e-8, 1e-9, 1e-10, 1e-12)


@numba.njit
def scaled_derivative(z: Vector) -> Vector:
    """Right-hand side in units of `SCALE`."""
    vx, vy = z[2] * SCALE[2], z[3] * SCALE[3]
    ax, ay = acceleration(z[0] * SCALE[0], z[1] * SCALE[1], vx, vy, PACKED)
    return np.array([vx / SCALE[0], vy / SCALE[1], ax / SCALE[2], ay / SCALE[3]])


def exact(expected: Vector) -> Iterator[Point]:
    """Our exact engine as a node uses it: the propagators are made before, as the peers' code is compiled before."""
    out, motion = sample_room(len(TIMES)), Motion(CASE, RATE, START)

    def run() -> Vector:
        motion.set_state(START)
        motion.advance(out)
        return out[:, :4]

    yield measured("exact", "51.2 kHz", run, expected)


def rk4(expected: Vector) -> Iterator[Point]:
    """Our Runge-Kutta engine."""
    out = np.empty((len(TIMES), 6))
    for steps in (5, 20, 100, 500):

        def run(steps: int = steps) -> Vector:
            Motion(CASE, RATE, START, "rk4", 1.0 / RATE / steps).advance(out)
            return out[:, :4]

        yield measured("RK4 (own)", f"{steps} steps a sample", run, expected)


def scipy(expected: Vector) -> Iterator[Point]:
    """SciPy's solvers straight through the events, the right-hand side compiled by numba."""

    def derivative(_: float, z: Vector) -> Vector:
        return scaled_derivative(z)

    for method in ("DOP853", "RK45", "LSODA"):
        for rtol in RTOLS:

            def run(method: str = method, rtol: float = rtol) -> Vector:
                solution = solve_ivp(
                    derivative,
                    (0.0, TIMES[-1]),
                    START / SCALE,
                    method=method,
                    t_eval=TIMES,
                    rtol=rtol,
                    atol=rtol * 1e-2,
                )
                return solution.y.T * SCALE

            yield measured(f"SciPy {method}", f"rtol {rtol:g}", run, expected)


def numbalsoda(expected: Vector) -> Iterator[Point]:
    """numbalsoda's LSODA, the right-hand side a compiled C function."""
    from numbalsoda import lsoda, lsoda_sig

    @numba.cfunc(lsoda_sig)
    def derivative(t, z, dz, p):  # noqa: ANN001, ANN202 (numba gives the types)
        vx, vy = z[2] * SCALE[2], z[3] * SCALE[3]
        ax, ay = acceleration(z[0] * SCALE[0], z[1] * SCALE[1], vx, vy, PACKED)
        dz[0], dz[1], dz[2], dz[3] = vx / SCALE[0], vy / SCALE[1], ax / SCALE[2], ay / SCALE[3]

    address, start = derivative.address, START / SCALE
    for rtol in RTOLS:

        def run(rtol: float = rtol) -> Vector:
            states, success = lsoda(address, start, TIMES, rtol=rtol, atol=rtol * 1e-2)
            if not success:
                raise RuntimeError(f"numbalsoda gave up at rtol = {rtol}")
            return states * SCALE

        yield measured("numbalsoda LSODA", f"rtol {rtol:g}", run, expected)


def diffrax(expected: Vector) -> Iterator[Point]:
    """diffrax on the CPU, compiled by XLA."""
    import diffrax as dfx
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    q = PACKED

    def derivative(t, z, args):  # noqa: ANN001, ANN202 (jax arrays)
        x, y, vx, vy = z[0] * SCALE[0], z[1] * SCALE[1], z[2] * SCALE[2], z[3] * SCALE[3]
        normal = q[K_C] * jnp.maximum(0.0, q[L_PRE] - y)
        fx = q[LOAD_X] - q[K34] * x - q[C_X] * vx + q[MU] * normal
        fy = q[LOAD_Y] - q[C_Y] * vy + normal
        for k, length, ax, ay in ((q[K1], q[L1], q[A1X], q[A1Y]), (q[K2], q[L2], q[A2X], q[A2Y])):
            square = x * x + y * y - 2.0 * (ax * x + ay * y)
            stretched = jnp.sqrt(length * length + square)
            pull = k * square / (stretched + length) / stretched
            fx, fy = fx - pull * (x - ax), fy - pull * (y - ay)
        return jnp.array([vx / SCALE[0], vy / SCALE[1], fx / q[MASS] / SCALE[2], fy / q[MASS] / SCALE[3]])

    term, save = dfx.ODETerm(derivative), dfx.SaveAt(ts=jnp.asarray(TIMES))
    for name, solver in (("Tsit5", dfx.Tsit5()), ("Dopri8", dfx.Dopri8())):
        for rtol in RTOLS[1:-1]:
            controller = dfx.PIDController(rtol=rtol, atol=rtol * 1e-2)

            @jax.jit
            def solve(z, solver=solver, controller=controller):  # noqa: ANN001, ANN202 (jax arrays)
                return dfx.diffeqsolve(
                    term,
                    solver,
                    t0=0.0,
                    t1=TIMES[-1],
                    dt0=1e-6,
                    y0=z,
                    saveat=save,
                    stepsize_controller=controller,
                    max_steps=10_000_000,
                ).ys

            def run(solve: Callable[[Vector], Vector] = solve) -> Vector:
                return np.asarray(solve(START / SCALE)) * SCALE

            yield measured(f"diffrax {name}", f"rtol {rtol:g}", run, expected)


PEERS = (exact, rk4, scipy, numbalsoda, diffrax, heyoka)


def all_points(expected: Vector) -> tuple[list[Point], list[str]]:
    """Points of every solver that is installed, and a note for each that is not."""
    points: list[Point] = []
    notes: list[str] = []
    for peer in PEERS:
        try:
            points.extend(peer(expected))
        except (ImportError, OSError) as error:
            notes.append(f"{peer.__name__}: not measured ({error})")
    return points, notes


def real_time(point: Point) -> float:
    """Simulated seconds per wall second."""
    return DURATION / point.seconds
