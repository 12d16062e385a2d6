"""All generated pages: where each lies, and what writes it."""

from __future__ import annotations

from collections.abc import Callable

from docs.generate.commands import commands_page
from docs.generate.flowchart import flowchart
from docs.generate.references import references_page
from docs.generate.settings import settings_page

PAGES: dict[str, Callable[[], str]] = {
    "docs/settings.md": settings_page,
    "docs/commands.md": commands_page,
    "docs/references.md": references_page,
    "docs/pictures/stages.svg": flowchart,
}
"""Path in the repository -> what gives the content."""
