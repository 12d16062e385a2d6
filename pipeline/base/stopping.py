"""Stopping on request: what is under way is finished and written before the process ends."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


class Stopped(Exception):
    """A stage was asked to stop and did.

    It leaves a state from which it goes on when it is run again. The command line prints this without a traceback and
    exits with 128 + the signal's number, as shells count.
    """

    def __init__(self, message: str, number: int) -> None:
        super().__init__(message)
        self.number = number


class StopRequests:
    """Context in which SIGTERM and SIGINT are noted, to be obeyed later.

    Outside, they end the process as ever. Later signals change nothing: launchers and terminals often send several, one
    to the group and one to the process. Python delivers signals to the main thread alone; entered in another, this
    notes nothing.

    Attributes:
        received: the first signal's number; 0 if there was none.
    """

    SIGNALS = (signal.SIGTERM, signal.SIGINT)

    def __init__(self) -> None:
        self.received = 0

    def __enter__(self) -> StopRequests:
        self._before = {}
        if threading.current_thread() is threading.main_thread():
            self._before = {number: signal.signal(number, self._note) for number in self.SIGNALS}
        return self

    def __exit__(self, *error: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _note(self, number: int, frame: FrameType | None) -> None:
        self.received = self.received or number


@contextmanager
def interrupted_once() -> Iterator[None]:
    """Have the first SIGINT end the block by `KeyboardInterrupt`, and later ones change nothing.

    A terminal sends it to Snakemake and to the stage, and Snakemake hands its own on: the second would interrupt what
    the first has begun to tidy up. Where it is ignored, as in a script's background, it stays so. Python delivers
    signals to the main thread alone; entered in another, this does nothing.
    """
    before = signal.getsignal(signal.SIGINT)
    main = threading.current_thread() is threading.main_thread()
    if not main or before not in (signal.default_int_handler, signal.SIG_DFL):
        yield
        return

    def interrupt(number: int, frame: FrameType | None) -> None:
        signal.signal(number, signal.SIG_IGN)
        raise KeyboardInterrupt

    signal.signal(signal.SIGINT, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
