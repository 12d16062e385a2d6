"""Reading XML documents that other programs wrote."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

from pipeline.base.errors import InputError


def read_xml(file: Path) -> ElementTree.Element:
    """The root of a document without declarations of its own.

    Entities could be made to grow without end.

    Raises:
        InputError: if it is none.
    """
    try:
        content = file.read_bytes()
        if b"<!DOCTYPE" in content or b"<!ENTITY" in content:
            raise InputError(f"{file}: expected an XML file without DOCTYPE and ENTITY, found one with them")
        return ElementTree.fromstring(content)
    except (OSError, ElementTree.ParseError, LookupError, ValueError) as error:  # LookupError: an unknown encoding.
        raise InputError(f"{file}: expected an XML file, found: {error}") from error


def has_root(file: Path, tag: str, attribute: str | None = None) -> bool:
    """Tell whether this is an XML file with this root, which has this attribute."""
    if not file.is_file():
        return False
    try:
        root = read_xml(file)
    except InputError:
        return False
    return root.tag == tag and (attribute is None or attribute in root.attrib)
