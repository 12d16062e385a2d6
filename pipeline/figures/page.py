"""Style, frame and verdicts of all HTML pages, and the page of a review.

A review's pictures lie beside its page.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from pipeline.base.files import written_whole
from pipeline.base.verdicts import Grade, Verdict

MARKS: dict[Grade, str] = {"good": "✓", "weak": "!", "failed": "✗"}
KINDS = {
    "images": "images", "camera": "cameras", "ball": "mirror balls", "light": "lights", "survey": "survey of lights",
    "color": "colour of the cameras", "log": "log of patterns", "exposure": "exposures",
    "transfer": "transfer function", "keypoints": "keypoints", "masks": "masks", "frame": "frames", "eye": "eyes",
    "gaze": "gaze",
}  # fmt: skip

STYLE = """
:root { color-scheme: light dark; --back: #f6f7f8; --card: #fff; --ink: #1c2026; --muted: #5c6470; --line: #d5d9df;
  --good: #00734f; --weak: #8f5f00; --failed: #b04600; --accent: #0a5fa8; }
@media (prefers-color-scheme: dark) { :root { --back: #15181c; --card: #1f2329; --ink: #e6e9ed; --muted: #a2abb6;
  --line: #3a4049; --good: #4fc9a4; --weak: #f0b544; --failed: #ff8a4c;
  --accent: #7db8ef; } img { filter: brightness(.88); } }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 1rem; max-width: 90rem; background: var(--back); color: var(--ink);
  font: 16px/1.45 system-ui, sans-serif; }
h1 { font-size: 1.4rem; margin: 0 0 1rem; } h2 { font-size: 1.1rem; margin: 2rem 0 .5rem; }
.tiles { display: flex; flex-wrap: wrap; gap: .6rem; }
.tile { background: var(--card); border: 1px solid var(--line); border-radius: .5rem; padding: .5rem .8rem; }
.tile b { display: block; } .tile span { margin-right: .8rem; white-space: nowrap; }
.good { color: var(--good); } .weak { color: var(--weak); } .failed { color: var(--failed); }
.zero { color: var(--muted); }
.scroll { overflow-x: auto; } table { border-collapse: collapse; width: 100%; font-size: .92rem; }
th, td { text-align: left; vertical-align: top; padding: .25rem .8rem .25rem 0; border-bottom: 1px solid var(--line); }
td.grade { white-space: nowrap; font-weight: 600; } summary { cursor: pointer; margin: .8rem 0; }
p { color: var(--muted); margin: .3rem 0; } figure { margin: 0; } a { color: var(--accent); }
:focus-visible { outline: 3px solid var(--accent); outline-offset: 2px; }
img { width: 100%; height: auto; border-radius: .5rem; border: 1px solid var(--line);
  background: #fff; }
"""


@dataclass(frozen=True)
class Section:
    """A part of the page.

    Attributes:
        file: name of the picture beside the page; empty if there is none.
        text: what to look for, or why there is no picture.
    """

    title: str
    file: str
    text: str


def write_page(path: Path, title: str, verdicts: Sequence[Verdict], sections: Sequence[Section]) -> None:
    """Write the page. All text is escaped."""
    parts = [
        f"<h1>{escape(title)}</h1>",
        verdict_tiles(verdicts),
        f"<h2>What needs a look</h2>\n{verdict_list(verdicts)}",
        *(_section(section) for section in sections),
    ]
    write_document(path, title, parts)


def write_document(path: Path, title: str, parts: Sequence[str], style: str = "", policy: str = "") -> None:
    """Write an HTML file.

    Args:
        parts: HTML of the body; whoever made it has escaped all text.
        style: CSS after that of all pages.
        policy: what the browser may load (Content-Security-Policy); empty: no limits.
    """
    guard = f'<meta http-equiv="Content-Security-Policy" content="{escape(policy, quote=True)}">\n' if policy else ""
    head = (
        f'<!doctype html>\n<html lang="en">\n<meta charset="utf-8">\n{guard}'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{STYLE}{style}</style>"
    )
    with written_whole(path) as temporary:
        temporary.write_text("\n".join([head, *parts]) + "\n</html>\n", encoding="utf-8")


def verdict_tiles(verdicts: Sequence[Verdict]) -> str:
    """Tiles with the counts of good, weak and failed, per kind."""
    return f'<div class="tiles">{"".join(_tile(kind, verdicts) for kind in KINDS)}</div>'


def verdict_list(verdicts: Sequence[Verdict]) -> str:
    """List of failed and weak verdicts, failed first; all can be unfolded."""
    if not verdicts:
        return "<p>Nothing was judged.</p>"
    amiss = [verdict for verdict in verdicts if verdict.grade != "good"]
    amiss.sort(key=lambda verdict: verdict.grade != "failed")
    listed = _table(amiss) if amiss else "<p>Everything is good.</p>"
    return f"{listed}\n<details><summary>All {len(verdicts)} verdicts</summary>{_table(verdicts)}</details>"


def _tile(kind: str, verdicts: Sequence[Verdict]) -> str:
    grades = [verdict.grade for verdict in verdicts if verdict.kind == kind]
    if not grades:
        return ""
    counts = "".join(
        f'<span class="{grade if grade in grades else "zero"}">{mark} {grades.count(grade)} {grade}</span>'
        for grade, mark in MARKS.items()
    )
    return f'<div class="tile"><b>{KINDS[kind]}</b>{counts}</div>'


def _table(verdicts: Sequence[Verdict]) -> str:
    rows = "".join(
        f'<tr><td class="grade {v.grade}">{MARKS[v.grade]} {v.grade}</td><td>{escape(v.kind)}</td>'
        f"<td>{escape(v.name)}</td><td>{escape(v.reason)}</td></tr>\n"
        for v in verdicts
    )
    head = "<tr><th>grade</th><th>what</th><th>name</th><th>why</th></tr>"
    return f'<div class="scroll" tabindex="0" role="region" aria-label="verdicts"><table>\n{head}\n{rows}</table></div>'


def _section(section: Section) -> str:
    picture = ""
    if section.file:
        name, title = escape(section.file, quote=True), escape(section.title, quote=True)
        picture = f'\n<figure><a href="{name}"><img src="{name}" alt="{title}" loading="lazy"></a></figure>'
    return f"<h2>{escape(section.title)}</h2>\n<p>{escape(section.text)}</p>{picture}"
