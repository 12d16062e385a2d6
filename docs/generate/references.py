"""The page of references, from docs/references.bib."""

from __future__ import annotations

import re

from pipeline.base.code_digest import ROOT

BIBLIOGRAPHY = ROOT / "docs/references.bib"

HEAD = """\
# References

<!-- Written by `make schema` from docs/references.bib: change that file. -->

All papers and books that the code cites, by first author. The file `docs/references.bib` has them for LaTeX. The code
cites an equation of the two papers that this project implements as `RGCA n` or `RFGCA n`; the
[glossary](glossary.md#equations) says what each equation is.

"""

ENTRY = re.compile(r"@\w+\{(?P<key>[^,]+),\n(?P<fields>.*?)\n\}", re.DOTALL)
FIELD = re.compile(r"^\s*(?P<name>\w+) = \{(?P<value>.*)\},?$", re.MULTILINE)
PLACES = ("journal", "booktitle", "publisher", "howpublished")


def entries() -> dict[str, dict[str, str]]:
    """Key -> fields of every entry of the file."""
    text = BIBLIOGRAPHY.read_text()
    return {found["key"]: {field["name"]: field["value"] for field in FIELD.finditer(found["fields"])}
            for found in ENTRY.finditer(text)}  # fmt: skip


def references_page() -> str:
    """The page as Markdown, a line per entry."""
    lines = []
    for fields in sorted(entries().values(), key=lambda one: (one["author"].lower(), one["year"])):
        place = next((fields[name] for name in PLACES if name in fields), "")
        title = fields["title"].replace("{", "").replace("}", "")
        link = f" <{fields['url']}>" if "url" in fields else ""
        authors = fields["author"].replace(" and others", " et al.").replace(" and ", "; ")
        lines.append(f"- {authors} ({fields['year']}). *{title}*. {place}.{link}\n")
    return HEAD + "".join(lines)
