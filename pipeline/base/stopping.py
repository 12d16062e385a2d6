"""Stopping on request: what is under way is finished and written before the process ends."""

from __future__ import annotations

import signal
import threading
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
