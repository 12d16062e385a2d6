"""Attacks, and the classes of what came of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path


class Outcome(StrEnum):
    """Classes of outcomes; all from `TRACEBACK` on are defects."""

    CLEAR = "clear"
    """Refused by the first program that reads what is wrong, with a message and without a traceback."""
    LATE = "refused late"
    """Refused so by a later one."""
    JUDGED = "judged"
    """Accepted, with a verdict that the sound run does not have."""
    RIGHT = "right"
    """Accepted, or done again after a kill, with the right result."""
    UNTOLD = "untold"
    """Accepted with another result, where nobody can tell from the files that they are wrong."""
    TRACEBACK = "traceback"
    """Ended by an exception or a signal that nobody explains."""
    HANG = "hang"
    """Not ended in the time that it may take."""
    NONSENSE = "silent nonsense"
    """Accepted without a word, with another result than the right one."""
    LOST = "lost bytes"
    """A file of a user or of an earlier run is gone, or the work cannot go on."""
    DIFFERING = "differing bytes"
    """Files that should be equal are not, or something is left over."""


DEFECTS = tuple(Outcome)[tuple(Outcome).index(Outcome.TRACEBACK) :]


@dataclass(frozen=True)
class Result:
    """What came of an attack.

    Attributes:
        outcome: its class.
        stage: the program that ended it, or the last that ran.
        said: what was printed or found, shortened.
    """

    outcome: Outcome
    stage: str = ""
    said: str = ""


@dataclass(frozen=True)
class Attack:
    """An attack that can be run in any order.

    Attributes:
        name: unique within its part, and the same in each run of the same seed.
        run: carries it out in a folder that is new and is deleted afterwards.
    """

    name: str
    run: Callable[[Path], Result]
