"""Progress bars when a terminal watches, plain log lines otherwise."""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Iterable, Iterator, Sized
from typing import TypeVar

from tqdm import tqdm

Item = TypeVar("Item")

LOG_EVERY_S = 15.0
"""Pause between two plain log lines. Rare enough for a log file, frequent enough to see that work goes on."""


def progress(items: Iterable[Item], what: str, total: int | None = None) -> Iterator[Item]:
    """Yield `items`, showing how many are done and the time left."""
    total = total if total is not None else (len(items) if isinstance(items, Sized) else None)
    if sys.stderr.isatty():
        yield from tqdm(items, desc=what, total=total)
        return
    log, start, last = logging.getLogger(what), time.monotonic(), time.monotonic()
    for done, item in enumerate(items):
        yield item
        if time.monotonic() - last > LOG_EVERY_S:
            last = time.monotonic()
            remaining = (last - start) / (done + 1) * (total - done - 1) if total else 0.0
            left = f", {tqdm.format_interval(remaining)} left" if total else ""
            log.info("%d of %s%s", done + 1, total if total is not None else "?", left)
