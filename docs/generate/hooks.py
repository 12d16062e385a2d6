"""MkDocs hooks: pages that lie outside of docs/ join the site, and links to them follow.

In the repository such a link reads `../CONTRIBUTING.md`, as it has to on a page of a code host; on the site it reads
`contributing.md`. This module is run by MkDocs and imports nothing of the project.
"""

from __future__ import annotations

from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[2]

OUTSIDE = {
    "config/capture_format.md": "capture_format.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
}
"""Path in the repository -> page of the site."""

ELSEWHERE = {"../config/README.md": "running.md#settings"}
"""Links of pages to what is no page -> where the site has the same."""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages from outside; their links to docs/ lose the folder."""
    for path, page in OUTSIDE.items():
        text = (ROOT / path).read_text().replace("](docs/", "](")
        for other, name in OUTSIDE.items():
            text = text.replace(f"]({other}", f"]({name}")
        files.append(File.generated(config, page, content=text))
    return files


def on_page_markdown(markdown: str, **_: object) -> str:
    """The page with its links to files outside of docs/ turned to pages of the site."""
    for link, page in {f"../{path}": page for path, page in OUTSIDE.items()}.items():
        markdown = markdown.replace(f"]({link}", f"]({page}")
    for link, page in ELSEWHERE.items():
        markdown = markdown.replace(f"]({link})", f"]({page})")
    return markdown
