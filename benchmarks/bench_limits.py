"""How near the hot loops come to what the machine can do, each beside its limit: a JSON file.

    python -m benchmarks.bench_limits --out results/time/limits.json [--repeats 7]

Kernels (blending, gathering of light, the shadow network, Adam) are counted: their operations against those of a large
matrix product, their bytes against those of a sum in memory, both measured here. Tracing and reading of images stand
beside the library's part of the work alone. All on one thread and in turn, so that what else the machine does hits all
alike; seconds are of the processor, medians, and a first round that compiles does not count.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numba
import torch

from benchmarks.limit_jobs import Kernel, adam, blending, gathering, roofs, shadow_network
from benchmarks.limit_twins import Twin, decoding, tracing
from pipeline.base.files import write_json


def measure(repeats: int) -> dict[str, object]:
    """All jobs, as the page of the documentation reads them."""
    tops = roofs()
    kernels = [*blending(), *gathering(), *shadow_network(), *adam()]
    with decoding() as images:
        twins = [*tracing(), *images]
        runs = [one.run for one in (*tops.values(), *kernels, *twins)] + [twin.bare for twin in twins]
        seconds = in_turn(runs, repeats)
    top_s, kernel_s, twin_s, bare_s = split(seconds, len(tops), len(kernels), len(twins), len(twins))
    rates = {name: one.operations / s for (name, one), s in zip(tops.items(), top_s, strict=True)}
    memory = dict(zip(tops, top_s, strict=True))["memory"]
    return {
        "processor": processor(), "repeats": repeats,
        "operations_per_s": max(rates["numpy"], rates["torch"]), "bytes_per_s": tops["memory"].bytes / memory,
        "roofs": [facts(one, s) for one, s in zip(tops.values(), top_s, strict=True)],
        "kernels": [facts(one, s) for one, s in zip(kernels, kernel_s, strict=True)],
        "twins": [twin_facts(*row) for row in zip(twins, twin_s, bare_s, strict=True)],
    }  # fmt: skip


def in_turn(runs: list[Callable[[], object]], repeats: int) -> list[float]:
    """Median processor seconds of each, run in turn; each is called once before it is timed, to find its data warm."""
    taken: list[list[float]] = [[] for _ in runs]
    for turn in range(repeats + 1):
        for own, run in zip(taken, runs, strict=True):
            run()
            started = time.process_time()
            run()
            if turn:
                own.append(time.process_time() - started)
    return [statistics.median(own) for own in taken]


def split(values: list[float], *lengths: int) -> list[list[float]]:
    """Consecutive parts of these lengths."""
    parts, start = [], 0
    for length in lengths:
        parts.append(values[start : start + length])
        start += length
    return parts


def facts(kernel: Kernel, seconds: float) -> dict[str, object]:
    """A kernel's row."""
    return {"what": kernel.what, "size": kernel.size, "cpu_s": seconds, "operations": kernel.operations,
            "bytes": kernel.bytes}  # fmt: skip


def twin_facts(twin: Twin, seconds: float, bare: float) -> dict[str, object]:
    """A twin's row."""
    return {"what": twin.what, "limit": twin.limit, "size": twin.size, "unit": twin.unit, "count": twin.count,
            "cpu_s": seconds, "bare_cpu_s": bare}  # fmt: skip


def processor() -> str:
    """Name of the processor, where the system tells."""
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "unknown")


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, required=True, help="JSON file to write")
    parser.add_argument("--repeats", type=int, default=7, help="timed runs of each job")
    options = parser.parse_args()
    torch.set_num_threads(1)
    numba.set_num_threads(1)
    cv2.setNumThreads(1)
    write_json(options.out, measure(options.repeats))


if __name__ == "__main__":
    main()
