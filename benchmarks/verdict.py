"""A verdict that is measured: which function judges, and captures whose truth is known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Judged:
    """A verdict, and what it is asked about.

    Attributes:
        by: the function that judges.
        faults: of broken captures, in turn.
        alarm: from a fault, or None, and a seed to whether something is called weak or failed; of a broken capture,
            what is broken.
    """

    by: str
    faults: tuple[str, ...]
    alarm: Callable[[str | None, int], bool]
