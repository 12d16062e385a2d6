"""`njit(cache=True)` for kernels that call and inline functions of several modules.

numba drops a cached binary only when the file of the function itself is newer; a changed helper or constant in another
module would go unnoticed, and a wrong image come out. Here the stamp is the content of all kernel sources.
"""

from __future__ import annotations

import hashlib
import inspect
import logging
from collections.abc import Callable
from functools import cache
from pathlib import Path

from numba import njit

log = logging.getLogger(__name__)

FAST_MATH = {"nsz", "arcp", "contract", "afn", "reassoc"}
"""fastmath without nnan and ninf: those would let the compiler drop what keeps unusual values harmless."""

EXACT_FUNCTIONS = FAST_MATH - {"afn"}
"""The same without afn, which lets functions such as roots be approximated."""

SOURCES = (
    "*_kernels.py", "kernel_cache.py", "conventions.py", "float_lanes.py", "splat_conventions.py",
    "vector_intrinsics.py", "volume_conventions.py",
)  # fmt: skip


@cache
def sources_digest(folder: Path = Path(__file__).parents[1]) -> str:
    """Hash of the names and contents of all files that kernels are made of."""
    digest = hashlib.sha256()
    for path in sorted(path for pattern in SOURCES for path in folder.rglob(pattern)):
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()


def kernel(*, parallel: bool = False, fastmath: bool | set[str] = False, **more: object) -> Callable:
    """Compile a kernel on first use and keep the binary until any kernel source changes.

    Where no folder for binaries can be written to, each process compiles anew.

    Args:
        more: options of numba.njit.
    """

    def compiled(function: Callable) -> Callable:
        options = {"parallel": parallel, "fastmath": FAST_MATH if fastmath is True else fastmath, **more}
        try:
            dispatcher = njit(cache=True, **options)(_plain(function))
        except RuntimeError:  # So numba says that no folder can be written to.
            _warn_once()
            return njit(**options)(_plain(function))
        # numba has no public way to say this. Should a version rename it, the next line fails at import, aloud.
        dispatcher._cache._cache_file._source_stamp = sources_digest()
        return dispatcher

    return compiled


unlocked_kernel = kernel(nogil=True, error_model="numpy")
"""Decorates a kernel of one thread that runs without the interpreter's lock, so that frames are computed side by side.

A division by 0 gives infinity, as NumPy's does: a loop that may raise is not vectorised (8 times slower)."""


def kernel_part(*, inline: bool = False, fastmath: bool | set[str] = False) -> Callable:
    """A function that kernels call; with `inline`, compiled as if its text stood in the caller."""

    def compiled(function: Callable) -> Callable:
        options = {"inline": "always" if inline else "never", "fastmath": FAST_MATH if fastmath is True else fastmath}
        return njit(**options)(_plain(function))

    return compiled


@cache
def _warn_once() -> None:
    log.warning("compiled kernels cannot be kept: set NUMBA_CACHE_DIR to a folder that can be written to")


def _plain(function: Callable) -> Callable:
    """What numba can compile: without the shape checks that the tests wrap around every function of the package."""
    return inspect.unwrap(function)
