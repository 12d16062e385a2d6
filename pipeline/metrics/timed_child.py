"""Run a program and write its exit code, its times and its peak memory.

`measured_run` starts this file as a script.

A process on its own that imports next to nothing: Linux counts what the parent held at the fork as the child's peak, so
that under a program of 300 MB even `true` would peak at 300 MB.
"""

import json
import os
import sys
import time

MIB = 2**20
RSS_UNIT = 1 if sys.platform == "darwin" else 1024
"""Bytes per unit of ru_maxrss: kilobytes, but bytes on macOS."""


def main() -> None:
    """`timed_child.py REPORT PROGRAM ARGUMENT ...`: the program's path is not searched for."""
    report, program = sys.argv[1], sys.argv[2:]
    start = time.perf_counter()
    child = os.posix_spawn(program[0], program, os.environ)
    _, status, usage = os.wait4(child, 0)
    seconds = time.perf_counter() - start
    measured = {
        "code": os.waitstatus_to_exitcode(status),
        "seconds": seconds,
        "cpu_seconds": usage.ru_utime + usage.ru_stime,
        "peak_mb": usage.ru_maxrss * RSS_UNIT / MIB,
    }
    with open(report, "w") as file:
        json.dump(measured, file)


if __name__ == "__main__":
    main()
