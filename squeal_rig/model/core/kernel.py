"""Compiled kernels: one decorator for all of them, with the compiled code cached on disk."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TypeVar, cast

import numba

from squeal_rig.model.core.code_cache import why_not_trusted

F = TypeVar("F", bound=Callable[..., object])

# numba 0.58, which Ubuntu 24.04 has, takes longer than anyone waits to put so many kernels into each other. There they
# are only linked, which makes the engine a fifth slower.
_INLINE = "never" if numba.version_info.short < (0, 59) else "always"
_FUSED: dict[str, object] = {"fastmath": {"contract"}, "_nrt": False}


def kernel(function: F) -> F:
    """Compile on the first call (never at import), cache on disk, release the GIL.

    `error_model="numpy"` keeps a division by zero an inf for the caller's status code, as in numpy.
    """
    return _compiled(function)


def fused_kernel(function: F) -> F:
    """As `kernel`, for inner loops: faster, never less exact.

    a*b + c may be rounded once instead of twice (fused multiply-add; no other liberty with floating point is taken).
    The last bit may differ between kinds of processor, and between the process that compiled the code and those that
    take it from disk (docs/decisions/0026-last-bits-are-not-promised.md).
    Arrays cannot be made inside, so none is counted either: numba's reference counts are atomic, and cost several times
    what a short function computes.
    """
    return _compiled(function, **_FUSED)


def reduction_kernel(function: F) -> F:
    """As `fused_kernel`, for sums and extremes over finite numbers: they may be regrouped, so that they run in lanes.

    The grouping is the compiler's, so the last bits may differ as those of `fused_kernel`, but never between the calls
    of a process.
    """
    return _compiled(function, **{**_FUSED, "fastmath": {"contract", "reassoc", "nnan", "nsz"}})


def inlined_kernel(function: F) -> F:
    """As `fused_kernel`, and made part of its callers' code where numba does that in time."""
    return _compiled(function, **_FUSED, inline=_INLINE)


def _digest_of_the_model() -> str:
    """Digest of all sources of the model: any of them may be compiled into any kernel, a constant among them."""
    contents = [path.read_bytes() for path in sorted(Path(__file__).parents[1].rglob("*.py"))]
    return hashlib.sha256(b"\0".join(contents)).hexdigest()[:12]


_DIGEST = _digest_of_the_model()


def _compiled(function: F, **more: object) -> F:
    # Of cached code numba checks the age of the kernel's own file only, yet kernels and constants of other files are
    # compiled into it. With the digest in its name, code made from other sources is never taken.
    function.__qualname__ += f"-{_DIGEST}"
    options: dict[str, object] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True, **more}
    try:
        compiled = numba.njit(cache=True, **options)(function)
    except RuntimeError:  # neither beside the source nor in the user's cache can be written: compiled at each start
        return cast(F, numba.njit(**options)(function))
    folder = Path(compiled.stats.cache_path)
    if (reason := why_not_trusted(folder, Path(function.__code__.co_filename))) is not None:
        _warn_once(reason)
        compiled = numba.njit(**options)(function)
    return cast(F, compiled)


@cache
def _warn_once(reason: str) -> None:
    """Say why every start compiles anew; nothing is loaded or called before that."""
    remedy = "The model is compiled at each start; NUMBA_CACHE_DIR names a folder of your own for it."
    warnings.warn(f"Compiled code on disk is not used: {reason}. {remedy}", stacklevel=1)
