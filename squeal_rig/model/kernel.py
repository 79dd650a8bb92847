"""Compiled kernels: one decorator for all of them, with the compiled code cached on disk."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., object])


def kernel(function: F) -> F:
    """Compile on the first call (never at import), cache on disk, release the GIL.

    `error_model="numpy"` keeps a division by zero an inf for the caller's status code, as in numpy.
    """
    return cast(F, numba.njit(cache=True, nogil=True, error_model="numpy")(function))
