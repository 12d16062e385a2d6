"""Limit on the address space of a process, and whether a stage can work below it."""

from __future__ import annotations

import resource

import psutil

from pipeline.base.errors import InputError

LEAST_BYTES = 1 << 30
"""Address space that a stage has to find free when it starts.

Libraries in native code do not ask whether the system refused them memory: Embree writes to where none is, LLVM and
Arrow abort, and some wait for ever for a thread that was not started. Threads of this process and of their libraries
reserve 8 MiB of stack and 64 MiB of heap each. Tracing the irradiance of the smallest capture crashes with 350 MiB left
and works with 600; a whole GiB is for larger ones."""


def require_address_space() -> None:
    """Refuse to start in too small an address space.

    Raises:
        InputError: there is a limit, and too little is left below it.
    """
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit == resource.RLIM_INFINITY:
        return
    used = psutil.Process().memory_info().vms
    if limit - used < LEAST_BYTES:
        raise InputError(
            f"out of memory: expected at least {LEAST_BYTES >> 20} MiB of address space for the work, found "
            f"{max(limit - used, 0) >> 20} MiB: the limit is {limit >> 20} MiB, and {used >> 20} are taken; raise it "
            "(ulimit -v unlimited)"
        )
