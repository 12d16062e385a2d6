"""A copy of the project in which bugs are planted, one at a time."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from tests.support.mutants.mutant import Mutant

LEFT_OUT = ("results", "captures", "build", "viewer", ".*")
"""What no test that judges mutants reads, or what each run makes anew, in the project's own folder."""


@dataclass(frozen=True)
class Tree:
    """The copy: the project as it was when it was made, whatever is edited since."""

    copy: Path

    @classmethod
    def made(cls, root: Path, copy: Path) -> Tree:
        """Copy a project as it is now, to a place outside of it or below its results.

        Compiled kernels come along, as times are kept.
        """
        # Of an earlier copy, kernels that its trials have compiled are kept: a file whose time is the same is the same.
        for path in list(copy.rglob("*")) if copy.exists() else ():
            if path.is_symlink() or (path.suffix == ".py" and not (root / path.relative_to(copy)).exists()):
                path.unlink()
        left_out = shutil.ignore_patterns(*LEFT_OUT)

        def ignored(folder: str, names: list[str]) -> set[str]:
            return left_out(folder, names) if Path(folder) == root else set()

        shutil.copytree(root, copy, ignore=ignored, dirs_exist_ok=True, symlinks=True)
        return cls(copy)

    @contextmanager
    def planted(self, mutant: Mutant, number: int) -> Iterator[None]:
        """Have the bug in the copy during the block.

        Args:
            mutant: the bug.
            number: of the mutant, from 1 on: the file's time differs by so many seconds from that of the original and
                of every other mutant, so that nobody takes one's compiled code for the other's.
        """
        target = self.copy / mutant.file
        text, state = target.read_bytes(), target.stat()
        target.write_text(mutant.planted(self.copy))
        os.utime(target, (state.st_atime, state.st_mtime + number))
        try:
            yield
        finally:
            target.write_bytes(text)
            os.utime(target, ns=(state.st_atime_ns, state.st_mtime_ns))
