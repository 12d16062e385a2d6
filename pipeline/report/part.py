"""A report: parts, each shown or named as missing, in one HTML file that loads nothing."""

from __future__ import annotations

import hashlib
from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from pipeline.figures.page import write_document
from pipeline.report.slider import SLIDER_SCRIPT, SLIDER_STYLE

STYLE = """
body { max-width: 76rem; } h1 { font-size: 1.7rem; margin: .5rem 0 .2rem; }
h3 { font-size: 1rem; margin: 1.2rem 0 .4rem; }
header p { font-size: 1rem; } code { font: .88em ui-monospace, monospace; overflow-wrap: anywhere; }
nav { display: flex; flex-wrap: wrap; gap: .4rem; margin: 1rem 0; }
nav a { padding: .3rem .7rem; border: 1px solid var(--line); border-radius: 1rem; background: var(--card);
  color: var(--ink); text-decoration: none; font-size: .9rem; } nav a:hover { border-color: var(--accent); }
nav a.absent { border-style: dashed; color: var(--muted); }
section { border-top: 1px solid var(--line); margin-top: 2rem; scroll-margin-top: 2px; }
section > h2 { margin-top: 1.2rem; font-size: 1.25rem; }
section:target > h2 { color: var(--accent); }
.missing { border: 1px dashed var(--muted); border-radius: .5rem; padding: .6rem .9rem; }
.tile b.value { font-size: 1.5rem; font-variant-numeric: tabular-nums; } .tile.score span { color: var(--muted); }
.tile:not(.score) span { display: inline-block; }
small { color: var(--muted); font-size: .92em; }
td.number, th.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
table { font-size: .88rem; } th { white-space: nowrap; } tr.group th { padding-top: .7rem; }
td.wide { min-width: 13rem; } td.name { white-space: nowrap; }
td.bar { width: 40%; min-width: 7rem; vertical-align: middle; } td.bar span { display: block; height: .8rem;
  border-radius: .2rem; background: var(--accent); min-width: 2px; }
.pictures { display: grid; gap: 1rem; grid-template-columns: minmax(0, 1fr); }
.stills { display: grid; gap: 1rem; grid-template-columns: repeat(auto-fill, minmax(min(100%, 14rem), 1fr)); }
.stills .plot img { min-width: 0; }
figcaption { color: var(--muted); font-size: .88rem; margin: .3rem 0; }
@media (max-width: 30rem) { body { padding: .7rem; } .tile { flex: 1 1 40%; } .tile.score span { white-space: normal; }
  .tile b.value { font-size: 1.25rem; } th, td { padding-right: .5rem; } .plot img { min-width: 42rem; } }
"""


@dataclass(frozen=True)
class Part:
    """A part of the report.

    Attributes:
        html: its content; whoever made it has escaped all text.
        missing: what is not there, and so not shown; empty if everything is.
        command: what to run to get it.
    """

    title: str
    html: str = ""
    missing: str = ""
    command: str = ""

    @property
    def anchor(self) -> str:
        """The part's id on the page."""
        return "".join(letter if letter.isalnum() else "-" for letter in self.title.lower())


def write_parts(path: Path, title: str, subtitle: str, parts: Sequence[Part]) -> None:
    """Write the page: a list of the parts, and the parts in their order.

    The page may not load anything, not even from its own folder: its browser is told so.
    """
    digest = b64encode(hashlib.sha256(SLIDER_SCRIPT.encode()).digest()).decode()
    policy = f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'sha256-{digest}'"
    links = "".join(
        f'<a href="#{part.anchor}"{"" if part.html else absent_class(part)}>{escape(part.title)}</a>' for part in parts
    )
    body = [
        f"<header><h1>{escape(title)}</h1><p>{escape(subtitle)}</p></header>",
        f'<nav aria-label="parts of this report">{links}</nav>\n<main>',
        *(_section(part) for part in parts),
        f"</main>\n<script>{SLIDER_SCRIPT}</script>",
    ]
    write_document(path, title, body, STYLE + SLIDER_STYLE, policy)


def absent_class(part: Part) -> str:
    """Attributes of a link to a part that is missing."""
    return f' class="absent" title="missing: {escape(part.missing, quote=True)}"'


def _section(part: Part) -> str:
    note = ""
    if part.missing:
        make = f" To make it: <code>{escape(part.command)}</code>" if part.command else ""
        note = f'<p class="missing"><b>Missing:</b> {escape(part.missing)}.{make}</p>'
    heading = f'<h2 id="{part.anchor}-title">{escape(part.title)}</h2>'
    return f'<section id="{part.anchor}" aria-labelledby="{part.anchor}-title">{heading}\n{part.html}{note}</section>'
