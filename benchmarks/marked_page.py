"""Pages that a benchmark writes: paragraphs, and parts between two marks."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path


def paragraphs(text: str) -> str:
    """Paragraphs, which empty lines part, in lines of 120 letters."""
    return "\n\n".join(textwrap.fill(part, 120) for part in text.split("\n\n")) + "\n"


def read_between(page: Path, name: str) -> str:
    """What stands between the marks NAME: begin and NAME: end of a page; nothing if it has none."""
    text = page.read_text() if page.exists() else ""
    return text.partition(f"<!-- {name}: begin -->\n")[2].partition(f"<!-- {name}: end -->")[0]


def write_between(page: Path, name: str, lines: Sequence[str]) -> None:
    """Put lines between the marks NAME: begin and NAME: end of a page.

    Raises:
        ValueError: if the page does not have both marks.
    """
    begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
    text = page.read_text()
    if text.count(begin) != 1 or text.count(end) != 1:
        raise ValueError(f"{page}: expected the marks {begin} and {end}, once each")
    before, rest = text.split(begin)
    page.write_text(before + begin + "\n" + "\n".join(lines) + "\n" + end + rest.split(end)[1])
