"""Polynomials of degree 3 in the state (x, y, vx, vy): product, composition, and a fast way to evaluate many at once.

A polynomial is its 35 coefficients by degree, monomials in the order 1; x, y, vx, vy; xx, xy, x vx, ..., vy vy; xxx,
xxy, ..., vy vy vy. Terms of degree 4 and up are dropped.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from squeal_rig.model.core.kernel import fused_kernel, inlined_kernel
from squeal_rig.model.core.layout import Vector

TERMS = 35
#: Polynomials that `evaluate_all` takes at once.
N = 16

_MONOMIALS: list[tuple[int, ...]] = [
    (),
    *((i,) for i in range(4)),
    *((i, j) for i in range(4) for j in range(i, 4)),
    *((i, j, k) for i in range(4) for j in range(i, 4) for k in range(j, 4)),
]


def _product_table() -> NDArray[np.int64]:
    """Each pair of terms whose product is kept, and the term it belongs to: (pairs, 3)."""
    rows = [
        (left, right, _MONOMIALS.index(tuple(sorted(a + b))))
        for left, a in enumerate(_MONOMIALS)
        for right, b in enumerate(_MONOMIALS)
        if len(a) + len(b) <= 3
    ]
    return np.array(rows, dtype=np.int64)


_PRODUCTS = _product_table()
# The part of it with a linear first factor.
_LINEAR_PRODUCTS = _PRODUCTS[_PRODUCTS[:, 0] < 5].copy()


@fused_kernel
def multiply(a: Vector, b: Vector, out: Vector) -> None:
    """Put the product of two polynomials into `out`, another vector."""
    out[:TERMS] = 0.0
    for n in range(_PRODUCTS.shape[0]):
        out[_PRODUCTS[n, 2]] += a[_PRODUCTS[n, 0]] * b[_PRODUCTS[n, 1]]


@fused_kernel
def multiply_linear(a: Vector, b: Vector, out: Vector) -> None:
    """As `multiply`, of a's constant and linear part only."""
    for t in range(TERMS):
        out[t] = 0.0
    add_product_linear(a, b, out)


@fused_kernel
def add_product_linear(a: Vector, b: Vector, out: Vector) -> None:
    """As `multiply_linear`, onto what is there."""
    for n in range(_LINEAR_PRODUCTS.shape[0]):
        out[_LINEAR_PRODUCTS[n, 2]] += a[_LINEAR_PRODUCTS[n, 0]] * b[_LINEAR_PRODUCTS[n, 1]]


@fused_kernel
def monomials(inner: Vector, out: Vector) -> None:
    """Put what each monomial becomes with inner(z), (4, 35), for its variables into `out` (35, 35).

    In monomials of degree 3 only the linear part of `inner` is taken: where both it and the polynomials that they are
    put into are near a linear map, what is left out is as small as the terms of degree 4.
    """
    for t in range(TERMS):
        out[0, t] = 1.0 if t == 0 else 0.0
        for j in range(4):
            out[1 + j, t] = inner[j, t]
    square, cube = 5, 15
    for j in range(4):
        for k in range(j, 4):
            multiply(inner[j], inner[k], out[square])
            for n in range(k, 4):
                multiply_linear(inner[n], out[square], out[cube])
                cube += 1
            square += 1


@fused_kernel
def substitute(outer: Vector, inner: Vector, out: Vector) -> None:
    """Put four polynomials `outer` (4, 35), with the `monomials` of others for the variables, into `out` (4, 35)."""
    for i in range(4):
        for t in range(TERMS):
            out[i, t] = 0.0
        for n in range(TERMS):
            factor = outer[i, n]
            for t in range(TERMS):
                out[i, t] += factor * inner[n, t]


@inlined_kernel
def evaluate_all(m: Vector, x: float, y: float, u: float, v: float, out: Vector) -> None:
    """Put the values of 16 polynomials at the state (x, y, u, v) into `out` (16,).

    `m` (35 * 16,) holds the first coefficient of all, then the second of all, and so on. Horner's rule in four
    variables: 34 products and nothing else. Sixteen, so that the compiler makes vector instructions of the loop.
    """
    for k in range(N):
        xx = m[5 * N + k] + x * m[15 * N + k] + y * m[16 * N + k] + (u * m[17 * N + k] + v * m[18 * N + k])
        xy = m[6 * N + k] + y * m[19 * N + k] + (u * m[20 * N + k] + v * m[21 * N + k])
        xu = m[7 * N + k] + u * m[22 * N + k] + v * m[23 * N + k]
        xv = m[8 * N + k] + v * m[24 * N + k]
        yy = m[9 * N + k] + y * m[25 * N + k] + (u * m[26 * N + k] + v * m[27 * N + k])
        yu = m[10 * N + k] + u * m[28 * N + k] + v * m[29 * N + k]
        yv = m[11 * N + k] + v * m[30 * N + k]
        uu = m[12 * N + k] + u * m[31 * N + k] + v * m[32 * N + k]
        uv = m[13 * N + k] + v * m[33 * N + k]
        vv = m[14 * N + k] + v * m[34 * N + k]
        along_x = m[1 * N + k] + x * xx + y * xy + (u * xu + v * xv)
        along_y = m[2 * N + k] + y * yy + (u * yu + v * yv)
        along_u = m[3 * N + k] + u * uu + v * uv
        along_v = m[4 * N + k] + v * vv
        out[k] = (m[k] + x * along_x + y * along_y) + (u * along_u + v * along_v)
