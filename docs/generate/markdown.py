"""Text from docstrings and descriptions as Markdown."""

from __future__ import annotations


def escaped(text: str) -> str:
    """The text with signs that Markdown or HTML would read as markup made plain, outside code spans."""
    parts = text.replace("``", "`").split("`")
    plain = [part.replace("<", "&lt;").replace("*", "\\*").replace("|", "\\|") for part in parts[::2]]
    parts[::2] = plain
    parts[1::2] = [part.replace("|", "\\|") for part in parts[1::2]]
    return "`".join(parts)
