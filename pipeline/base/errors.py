"""Errors that are a person's to mend: one clear message each, all of them in one go."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager

MOST_SAID = 100
"""Complaints that are said in one go: as many as anybody reads. Some files are wrong in every line."""


class InputError(Exception):
    """Something outside the code is wrong; the message says what, where, and what to do.

    Stages raise it before any long work starts. The command line prints it without a traceback and exits with 1.
    """


class Complaints:
    """Collects everything that is wrong with an input, so that a person mends it in one go.

    >>> complaints = Complaints("captures/demo")
    >>> complaints.add("frames.csv", "frame 3", expected="one row", found="two rows", hint="delete one")
    >>> complaints.raise_if_any()
    Traceback (most recent call last):
    ...
    pipeline.base.errors.InputError: captures/demo: 1 problem
      frames.csv: frame 3: expected one row, found two rows; delete one
    """

    def __init__(self, subject: object) -> None:
        self.subject = subject
        self.messages: list[str] = []

    def add(self, file: object, key: str, *, expected: str, found: str, hint: str = "") -> None:
        """Note one complaint: file, key, expected, found, and what to do about it."""
        self.messages.append(f"{file}: {key}: expected {expected}, found {found}" + (f"; {hint}" if hint else ""))

    @contextmanager
    def collecting(self) -> Iterator[None]:
        """Note an `InputError` that the block raises, instead of letting it end the run."""
        try:
            yield
        except InputError as error:
            self.messages.append(str(error))

    def __bool__(self) -> bool:
        return bool(self.messages)

    def raise_if_any(self) -> None:
        """End with one error that names the complaints, or return if there is none.

        Raises:
            InputError: there is a complaint.
        """
        if self.messages:
            count = len(self.messages)
            lines = [f"{self.subject}: {count} problem{'s' if count > 1 else ''}", *self.messages[:MOST_SAID]]
            lines += [f"... and {count - MOST_SAID} more"] if count > MOST_SAID else []
            raise InputError("\n  ".join(lines))


MOST_LISTED = 5
"""Items that a message names of many."""


def listed(items: Collection[object], limit: int = MOST_LISTED, total: int | None = None) -> str:
    """The items for a message, the first `limit` of them: `3, 4, 5, 6, 7 ... (12 in all)`.

    Args:
        total: number of all, where `items` are only the first.
    """
    text, count = ", ".join(str(item) for item in list(items)[:limit]), len(items) if total is None else total
    return f"{text} ... ({count} in all)" if count > limit else text
