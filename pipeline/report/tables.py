"""Tables of HTML, and numbers as a person reads them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from html import escape


class Html(str):
    """Text that is HTML already: any other is escaped."""

    __slots__ = ()


def number(value: float, digits: int = 2, sign: str = "") -> str:
    """Write a number with `digits` decimals; a dash if there is none.

    `sign` "+" writes it always.
    """
    if value is None or not math.isfinite(value):
        return "–"
    return f"{value:{sign}.{digits}f}".replace("-", "−")


def significant(value: float, digits: int = 3) -> str:
    """Write a number with `digits` significant digits; a dash if there is none.

    It is in powers of ten where it is tiny or huge.
    """
    if value is None or not math.isfinite(value):
        return "–"
    return f"{value:.{digits}g}".replace("-", "−")


def p_text(value: float) -> str:
    """A p-value."""
    if not math.isfinite(value):
        return "–"
    return "< 0.001" if value < 0.001 else f"{value:.3g}"


def html_table(name: str, head: Sequence[str], rows: Iterable[Sequence[object]], kinds: str = "") -> Html:
    """A table that scrolls by itself where it is wider than the page.

    Args:
        name: what a screen reader calls it.
        rows: values, one per column; a single one is the heading of the rows that follow.
        kinds: a letter per column: n number, t text, w text that wants room, s short text kept on one line, b bar
            (a share of 1).
    """
    classes = {"n": "number", "w": "wide", "s": "name", "b": "bar"}
    own = [classes.get(kind, "") for kind in (kinds or "t" * len(head)).ljust(len(head), "t")]
    heads = "".join(_cell("th", title, css) for title, css in zip(head, own, strict=True))
    lines = []
    for row in rows:
        if len(row) == 1 < len(head):
            lines.append(f'<tr class="group"><th colspan="{len(head)}">{escape(str(row[0]))}</th></tr>\n')
            continue
        cells = zip(row, own, strict=True)
        lines.append(f"<tr>{''.join(_cell('td', value, css) for value, css in cells)}</tr>\n")
    return Html(
        f'<div class="scroll" tabindex="0" role="region" aria-label="{escape(name, quote=True)}">'
        f"<table>\n<thead><tr>{heads}</tr></thead>\n<tbody>{''.join(lines)}</tbody></table></div>"
    )


def folded(summary: str, content: str) -> Html:
    """Content that is shown on demand."""
    return Html(f"<details><summary>{escape(summary)}</summary>{content}</details>")


def paragraph(text: str) -> Html:
    """A paragraph of plain text."""
    return Html(f"<p>{escape(text)}</p>")


def _cell(tag: str, value: object, css: str) -> str:
    given = f' class="{css}"' if css else ""
    if tag == "td" and css == "bar":
        return f'<td{given}><span style="width:{100 * float(value):.1f}%"></span></td>'
    return f"<{tag}{given}>{value if isinstance(value, Html) else escape(str(value))}</{tag}>"
