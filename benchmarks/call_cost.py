"""Time and memory of a call in this process."""

from __future__ import annotations

import ctypes
import gc
import time
from collections.abc import Callable
from pathlib import Path

LEAST_MB = 0.05
"""What a peak adds is read in pages of 4 kB, and grows by the allocator's steps: less than this is as good as this."""


def cost_of(run: Callable[[], object], count: int) -> dict[str, float]:
    """CPU and wall seconds of one call, the mean of `count`, and what its peak adds to the memory of before, MiB."""
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)  # What was freed is given back: it would hide what the run asks for.
    before = memory_mb("VmRSS")
    Path("/proc/self/clear_refs").write_text("5")  # The peak is counted anew from here.
    cpu, wall = time.process_time(), time.perf_counter()
    for _ in range(count):
        run()
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    peak = max(memory_mb("VmHWM") - before, LEAST_MB)
    return {"CPU seconds": cpu / count, "wall seconds": wall / count, "peak MB": peak}


def memory_mb(name: str) -> float:
    """VmRSS, resident now, or VmHWM, its peak, of this process in MiB."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(f"{name}:")) / 1024
