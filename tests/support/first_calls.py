"""Check of types and shapes at the first calls of each function in each file of tests.

jaxtyping wraps every function of the package (`--jaxtyping-packages` in pyproject.toml), and what it wraps with decides
how often it looks. The hundredth call tells little that the first ten did not, and a check takes as long as many a
function: a fifth of the time of all tests, where every call is checked.
"""

from __future__ import annotations

import functools
import operator
import sys
from collections.abc import Callable
from pathlib import Path
from types import FunctionType

from beartype import beartype

CALLS = 10
"""Calls that are checked, of each function in each file of tests with its fixtures."""

_file: Path | None = None
_left_alone: list[FunctionType] = []


def in_file(path: Path) -> None:
    """Begin to count anew if this is another file."""
    global _file
    if path == _file:
        return
    _file = path
    while _left_alone:
        vars(_left_alone.pop()).pop("__no_type_check__", None)


def checked(function: Callable) -> Callable:
    """The function, checked by beartype at its first calls; it is taken to beartype when it is called first."""
    by_beartype, counted_in, calls = None, Path(), 0

    @functools.wraps(function)
    def called(*args: object, **kwargs: object) -> object:
        nonlocal by_beartype, counted_in, calls
        if counted_in is not _file:
            by_beartype, counted_in, calls = by_beartype or beartype(function), _file, 0
        calls += 1
        if calls == CALLS:
            _leave_alone(function)
        return by_beartype(*args, **kwargs) if calls <= CALLS else function(*args, **kwargs)

    return called


def _leave_alone(function: Callable) -> None:
    """Tell jaxtyping, if what it made of the function is found under its name, not to ask any more in this file."""
    try:
        found = operator.attrgetter(function.__qualname__)(sys.modules[function.__module__])
    except (AttributeError, KeyError):
        return
    if isinstance(found, FunctionType):
        found.__no_type_check__ = True
        _left_alone.append(found)
