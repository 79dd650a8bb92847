"""Compiled kernels: one decorator for all of them, with the compiled code cached on disk."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., object])

#: Source files each kernel is compiled from, by the identity of the compiled function.
_sources: dict[int, frozenset[str]] = {}
_FUSED: dict[str, object] = {"fastmath": {"contract"}, "_nrt": False}


def kernel(function: F) -> F:
    """Compile on the first call (never at import), cache on disk, release the GIL.

    `error_model="numpy"` keeps a division by zero an inf for the caller's status code, as in numpy.
    """
    return _compiled(function)


def fused_kernel(function: F) -> F:
    """As `kernel`, for inner loops: faster, never less exact.

    a*b + c may be rounded once instead of twice (fused multiply-add; no other liberty with floating point is taken).
    The last bit may differ between kinds of processor. Arrays cannot be made inside, so none is counted either:
    numba's reference counts are atomic, and cost several times what a short function computes.
    """
    return _compiled(function, **_FUSED)


def inlined_kernel(function: F) -> F:
    """As `fused_kernel`, and made part of its callers' code."""
    return _compiled(function, **_FUSED, forceinline=True)


def _compiled(function: F, **more: object) -> F:
    # numba compiles the kernels called into the caller, yet asks only the caller's own file whether cached
    # code is still valid. The digest files code made from other sources under another name.
    named = (function.__globals__.get(name) for name in function.__code__.co_names)
    own = frozenset({function.__code__.co_filename})
    sources = own.union(*(_sources.get(id(value), own) for value in named))
    if sources != own:
        function.__qualname__ += f"-{_digest(sources)}"
    options: dict[str, object] = {"nogil": True, "error_model": "numpy", **more}
    try:
        compiled = numba.njit(cache=True, **options)(function)
    except RuntimeError:  # neither beside the source nor in the user's cache can be written: compiled at each start
        compiled = numba.njit(**options)(function)
    _sources[id(compiled)] = sources
    return cast(F, compiled)


def _digest(sources: frozenset[str]) -> str:
    contents = sorted(hashlib.sha256(Path(source).read_bytes()).digest() for source in sources)
    return hashlib.sha256(b"".join(contents)).hexdigest()[:12]
