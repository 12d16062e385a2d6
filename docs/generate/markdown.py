"""Pieces of Markdown: text from docstrings and descriptions, tables, numbers."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path


def escaped(text: str) -> str:
    """The text with signs that Markdown or HTML would read as markup made plain, outside code spans."""
    parts = text.replace("``", "`").split("`")
    plain = [part.replace("<", "&lt;").replace("*", "\\*").replace("|", "\\|") for part in parts[::2]]
    parts[::2] = plain
    parts[1::2] = [part.replace("|", "\\|") for part in parts[1::2]]
    return "`".join(parts)


def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table of Markdown."""
    lines = [f"| {' | '.join(heads)} |", f"|{'---|' * len(heads)}", *(f"| {' | '.join(row)} |" for row in rows)]
    return "\n".join(lines) + "\n"


def significant(value: float) -> str:
    """Three digits, or three decimals below 1; no power of ten."""
    digits = max(0, 2 - math.floor(math.log10(abs(value)))) if abs(value) >= 1 else 3
    return f"{value:,.{digits}f}"


def milliseconds(seconds: float) -> str:
    """Of seconds, three digits."""
    return significant(1e3 * seconds)


def percent(share: float) -> str:
    """Of a share, without decimals from 10 % on."""
    return f"{100 * share:.0f} %" if share >= 0.1 else f"{100 * share:.1f} %"


def parted(page: Path, name: str) -> tuple[str, str, str]:
    """Text of a page up to the mark `<!-- NAME: begin -->`, from there to that of the end, and the rest."""
    head, rest = page.read_text().split(begin := f"<!-- {name}: begin -->\n")
    inside, tail = rest.split(end := f"<!-- {name}: end -->")
    return head + begin, inside, end + tail


def put_between(page: Path, name: str, inside: str) -> None:
    """Replace what stands between the marks of that name."""
    head, _, tail = parted(page, name)
    page.write_text(head + inside + tail)
