"""Requests of jobs, as the workflow tells them to the report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pipeline.base.errors import InputError


@dataclass(frozen=True)
class Asked:
    """Megabytes and minutes that a job of a stage asks for at its first attempt."""

    mem_mb: int
    minutes: int


def read_requests(words: Sequence[str]) -> dict[str, Asked]:
    """Stage -> what its jobs ask for, from words such as `track_mesh:1300:7`.

    Raises:
        InputError: if a word is no such.
    """
    found = {}
    for word in words:
        stage, *numbers = word.split(":")
        if len(numbers) != 2 or not all(number.isdecimal() for number in numbers):
            raise InputError(f"--requests: expected STAGE:MEGABYTES:MINUTES, found {word}")
        found[stage] = Asked(*map(int, numbers))
    return found
