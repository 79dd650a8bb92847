"""Eigenvalues of the linear two-degree-of-freedom model in compiled code, without a matrix.

With equal damping c per mass in x and y, lambda^2 + c lambda + kappa = 0 for each eigenvalue kappa of K/m: closed
form. Else the roots of the characteristic quartic from those at the mean damping: two complex pairs by Newton's
method, accepted where sum and product agree with the quartic; all else, four roots at once by Aberth's method
(Math. Comp. 27, 1973, 339-344). All lose digits near a double eigenvalue, as any method does.
"""

from __future__ import annotations

import cmath
import math

import numpy as np
from numpy.typing import NDArray

from squeal_rig.model.core.kernel import kernel

Roots = NDArray[np.complex128]

_ITERATIONS = 60
_ROUNDING = 4e-16
#: Re(lambda) counts as growth above this share of |lambda|: rounding alone gives an undamped stable rig positive
#: real parts.
GROWTH_TOLERANCE = 1e-6


@kernel
def fill_roots(
    k11: float, k12: float, k21: float, k22: float, damping_x: float, damping_y: float, roots: Roots
) -> None:
    """Fill `roots` (4,) with the eigenvalues [rad/s] for stiffness [1/s^2] and damping [1/s] per mass, in no
    order.
    """
    kappa_1, kappa_2 = _stiffness_eigenvalues(k11, k12, k21, k22)
    mean = 0.5 * (damping_x + damping_y)
    roots[0], roots[1] = _pair(mean, kappa_1)
    roots[2], roots[3] = _pair(mean, kappa_2)
    if damping_x != damping_y:
        a2 = k11 + k22 + damping_x * damping_y
        a3 = damping_x * k22 + damping_y * k11
        a1, a4 = damping_x + damping_y, k11 * k22 - k12 * k21
        if not _newton(a1, a2, a3, a4, roots):
            _aberth(a1, a2, a3, a4, roots)


@kernel
def _stiffness_eigenvalues(k11: float, k12: float, k21: float, k22: float) -> tuple[complex, complex]:
    """Eigenvalues of K/m [1/s^2]; the smaller real one from the determinant, where the difference would cancel."""
    half = 0.5 * (k11 + k22)
    discriminant = (0.5 * (k11 - k22)) ** 2 + k12 * k21
    if discriminant < 0.0:
        root = math.sqrt(-discriminant)
        return complex(half, root), complex(half, -root)
    larger = half + math.copysign(math.sqrt(discriminant), half)
    smaller = (k11 * k22 - k12 * k21) / larger if larger != 0.0 else 0.0
    return complex(larger, 0.0), complex(smaller, 0.0)


@kernel
def _pair(damping: float, kappa: complex) -> tuple[complex, complex]:
    """Both roots of lambda^2 + damping lambda + kappa, without cancellation."""
    root = cmath.sqrt(0.25 * damping * damping - kappa)
    if root.real < 0.0:
        root = -root
    far = -0.5 * damping - root
    if damping == 0.0:
        return far, root
    return far, kappa / far if far != 0.0 else complex(0.0, 0.0)


@kernel
def _newton(a1: float, a2: float, a3: float, a4: float, roots: Roots) -> bool:
    """Improve two complex pairs by Newton's method; False, `roots` untouched, where these are not all the roots."""
    found = 0
    first, second = 0.0j, 0.0j
    for i in range(4):
        z = roots[i]
        if z.imag <= 0.0:
            continue
        step = z
        for _ in range(12):
            value = (((z + a1) * z + a2) * z + a3) * z + a4
            slope = ((4.0 * z + 3.0 * a1) * z + 2.0 * a2) * z + a3
            step = value / slope
            z -= step
            # The next step is about the square of this one in units of the root.
            if abs(step.real) + abs(step.imag) <= 1e-9 * abs(z.imag):
                break
        first, second = second, z
        found += 1
    size = abs(first.imag) + abs(second.imag)
    sum_agrees = abs(2.0 * (first.real + second.real) + a1) <= 1e-12 * size
    product = (first.real**2 + first.imag**2) * (second.real**2 + second.imag**2)
    # NaN fails these too.
    if found != 2 or not sum_agrees or not abs(product - a4) <= 1e-12 * abs(a4):
        return False
    roots[0], roots[1] = first, first.conjugate()
    roots[2], roots[3] = second, second.conjugate()
    return True


@kernel
def _aberth(a1: float, a2: float, a3: float, a4: float, roots: Roots) -> None:
    """Improve four approximate roots of z^4 + a1 z^3 + a2 z^2 + a3 z + a4 until they are so to rounding."""
    size = 0.0
    for i in range(4):
        size = max(size, abs(roots[i]))
    if size == 0.0:
        return
    # Guesses that coincide would never part.
    for i in range(4):
        roots[i] += size * 1e-7 * complex(i - 1.5, 0.5 * i - 0.9)
    for _ in range(_ITERATIONS):
        largest = 0.0
        for i in range(4):
            z = roots[i]
            value = (((z + a1) * z + a2) * z + a3) * z + a4
            slope = ((4.0 * z + 3.0 * a1) * z + 2.0 * a2) * z + a3
            if value == 0.0 or slope == 0.0:
                continue
            newton = value / slope
            others = 0.0j
            for j in range(4):
                if j != i and roots[j] != z:
                    others += 1.0 / (z - roots[j])
            step = newton / (1.0 - newton * others)
            roots[i] = z - step
            largest = max(largest, abs(step))
        if largest <= _ROUNDING * size:
            return


@kernel
def leading_root(roots: Roots) -> tuple[float, float, bool]:
    """Largest real part [1/s], |Im| of that eigenvalue [rad/s], and whether any grows: Re > 1e-6 |lambda|."""
    real, imaginary, grows = -math.inf, 0.0, False
    for i in range(4):
        z = roots[i]
        if z.real > real or (z.real == real and abs(z.imag) > imaginary):
            real, imaginary = z.real, abs(z.imag)
        grows = grows or z.real > GROWTH_TOLERANCE * abs(z)
    return real, imaginary, grows
