"""Speed of the machine while something runs: how long a fixed piece of work takes, again and again.

A machine that others use changes its speed by the minute, seconds of a processor included. Of two runs, one may be
divided by what the same piece of work took meanwhile, in the other. It fits into caches: that others crowd the memory,
which trainings wait for, it does not see.
"""

from __future__ import annotations

import statistics
import threading
from time import thread_time
from types import TracebackType

import numpy as np

EVERY_S = 5.0
"""Between two samples: one takes some 25 ms, half a percent of a core."""

LOOPS, SIDE = 300_000, 256
"""Of a sample: turns of a Python loop, and the side of square matrices, whose product is formed eight times: stages
spend their time in both."""


class SpeedMeter:
    """Samples the machine's speed in a thread, from `with` to its end.

    Attributes:
        samples: seconds of a processor that the piece of work took, one of each time.
    """

    def __init__(self) -> None:
        self.samples: list[float] = []
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._sample, daemon=True)

    def __enter__(self) -> SpeedMeter:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._done.set()
        self._thread.join()

    @property
    def seconds(self) -> float:
        """Mean of the samples: what a processor's seconds are proportional to."""
        return statistics.fmean(self.samples)

    def _sample(self) -> None:
        matrix = np.ones((SIDE, SIDE), dtype=np.float32)
        while True:
            begun = thread_time()
            piece_of_work(matrix)
            self.samples.append(thread_time() - begun)
            if self._done.wait(EVERY_S):
                return


def piece_of_work(matrix: np.ndarray) -> float:
    """Form products of a matrix with itself, and count in a loop."""
    total = 0.0
    for _ in range(8):
        total += float((matrix @ matrix)[0, 0])
    for number in range(LOOPS):
        total += number
    return total
