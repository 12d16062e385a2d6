"""A single change of one file, and the list of them as it stands in YAML."""

from __future__ import annotations

import ast
import hashlib
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import yaml

KEYS = {"file", "was", "becomes", "meaning", "tests", "survives"}

KERNEL_MARKS = ("import numba", "from numba", "base.kernel_cache import", "base.float_lanes import")
"""Text of files that hold parts of compiled kernels."""


@dataclass(frozen=True)
class Mutant:
    """One planted bug.

    Attributes:
        layer: the list that it stands in.
        file: below the project's folder.
        was, becomes: text that the file has exactly once, and what stands in its place.
        meaning: the bug in words.
        tests: files, folders or single tests, tried in this order until one fails.
        survives: why no test has to see it; empty if one has to.
    """

    layer: str
    file: str
    was: str
    becomes: str
    meaning: str
    tests: tuple[str, ...]
    survives: str = ""

    def planted(self, root: Path) -> str:
        """The file's text with the bug.

        Raises:
            ValueError: if the list is no longer true: no such file, its text not there or there twice, or no change.
        """
        path = root / self.file
        if not path.is_file():
            raise ValueError(f"{self}: no such file")
        text = path.read_text()
        if (count := text.count(self.was)) != 1:
            raise ValueError(f"{self}: expected its text once, found it {count} times; write the list anew there")
        return text.replace(self.was, self.becomes)

    def require_change(self, root: Path) -> None:
        """Refuse a change that is none, or after which the file is no Python, and tests that are not there.

        Raises:
            ValueError: with what is wrong.
        """
        planted, text = self.planted(root), (root / self.file).read_text()
        if self.file.endswith(".py"):
            try:
                same = ast.dump(ast.parse(planted)) == _tree_of(text)
            except SyntaxError as error:
                raise ValueError(f"{self}: no Python after the change: {error}") from error
            if same:
                raise ValueError(f"{self}: a change of nothing but spelling")
        for test in self.tests:
            path, _, name = test.partition("::")
            if not (root / path).exists() or (name and f"def {name}(" not in (root / path).read_text()):
                raise ValueError(f"{self}: no test {test}")

    def is_compiled(self, root: Path) -> bool:
        """Tell whether the file is part of compiled kernels: what is kept of these does not hold for the mutant."""
        return any(mark in (root / self.file).read_text() for mark in KERNEL_MARKS)

    def digest(self, root: Path) -> str:
        """Digest of the change, the file and its tests: a judgement holds for these."""
        digest = hashlib.sha256(self.planted(root).encode())
        for test in self.tests:
            path = root / test.partition("::")[0]
            for file in sorted(path.rglob("test_*.py")) if path.is_dir() else [path]:
                digest.update(test.encode() + file.read_bytes())
        return digest.hexdigest()[:16]

    def __str__(self) -> str:
        return f"{self.layer}: {self.file}: {self.was.strip().splitlines()[0]!r}"


@cache
def _tree_of(text: str) -> str:
    """Syntax tree of some code, where several bugs are planted."""
    return ast.dump(ast.parse(text))


def read_mutants(folder: Path) -> list[Mutant]:
    """All mutants of a folder's lists, one YAML file per layer.

    Raises:
        ValueError: if one has other keys, or stands there twice.
    """
    found: list[Mutant] = []
    for path in sorted(folder.glob("*.yaml")):
        for entry in yaml.safe_load(path.read_text()):
            if not KEYS - {"survives"} <= set(entry) <= KEYS:
                raise ValueError(f"{path}: expected the keys {sorted(KEYS)}, found {sorted(entry)}")
            tests = entry["tests"] if isinstance(entry["tests"], list) else [entry["tests"]]
            found.append(Mutant(path.stem, **(entry | {"tests": tuple(tests)})))
    places = [(mutant.file, mutant.was, mutant.becomes) for mutant in found]
    if twice := [str(mutant) for mutant, place in zip(found, places, strict=True) if places.count(place) > 1]:
        raise ValueError(f"listed twice: {', '.join(twice)}")
    return found
