"""One change to a capture, and what it makes of it."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path


class Meaning(StrEnum):
    """The oracle of a mutation: what may come of it."""

    SAME = "same"
    """The same capture, written otherwise. If it is accepted, the answers are the sound capture's."""
    BROKEN = "broken"
    """Wrong. It is refused or judged; or it changes no answer by more than the sound one is off."""
    OTHER = "other"
    """Another capture that nobody can tell is wrong: any answer, but no defect."""


@dataclass(frozen=True)
class Mutation:
    """A change to a capture.

    Attributes:
        file: whose content is changed, relative to the capture.
        what: the change, in words.
        meaning: of the change.
        apply: makes it, in the capture's folder.
        renamed: former and present name of a camera or light, if that is the change.
    """

    file: str
    what: str
    meaning: Meaning
    apply: Callable[[Path], object]
    renamed: tuple[str, str] | None = None

    @property
    def name(self) -> str:
        return f"{self.file}: {self.what}"


def replace(path: Path, content: bytes | str) -> None:
    """Give a file another content; links to the former one keep that."""
    remove(path)
    path.write_bytes(content if isinstance(content, bytes) else content.encode())


def remove(path: Path) -> None:
    """Remove whatever is there."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
