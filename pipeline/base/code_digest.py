"""Digest of a stage's code: its module and all modules of the project that it imports.

The workflow passes it to each job as a parameter, so that an edit reruns exactly the stages that can run the edited
code. Imports are followed statically, also those inside functions and those of the enclosing packages. Comments,
formatting, docstrings (any bare string) and the descriptions of settings are no code; the weights that a package
carries are.

Every process of Snakemake asks for the stages of its plan, and each job of a cluster plans twice. What files say is
therefore kept by their content (`pipeline.base.parsed_code`), and within a process for as long as nothing changes.
"""

from __future__ import annotations

import hashlib
import os
import time
from dataclasses import dataclass
from pathlib import Path
from threading import Lock

from pipeline.base.parsed_code import ParsedFile, ParsedFiles

ROOT = Path(__file__).resolve().parents[2]
"""The folder that holds the package `pipeline`."""

KEPT = ".snakemake/parsed_code.json"
"""Parsed files, below the root. Whoever deletes it makes the next plan wait for two seconds."""

DATA_SUFFIXES = (".safetensors", ".csv")
"""Files inside a package that its code reads."""

SETTLED_NS = 2_000_000_000
"""Age from which a time stamp tells a file's versions apart: the coarsest clock of a file system, FAT's, ticks so."""

LOOK_AGAIN_S = 0.1
"""Seconds for which nobody looks whether anything has changed: a plan of twenty subjects asks five hundred times.

An edit within that time counts as one that comes right after the plan, which anyway records the code of before and lets
the next run notice.
"""

Stamp = tuple[int, int, int, int]
"""Times of change (of the content, of the inode), size and inode."""


def code_digest(module: str, root: Path = ROOT) -> str:
    """Hexadecimal BLAKE2b-128 of a module (dotted name) and of all that it imports below `root`.

    Raises:
        FileNotFoundError: if `root` has no such module.
    """
    with _one_at_a_time:
        code = _code_below(root)
        if not code.locate(module):
            raise FileNotFoundError(f"{root}: no module {module}")
        return code.digest(module)


def imported_modules(module: str, root: Path = ROOT) -> list[str]:
    """`module` and the modules under `root` that it imports, directly or not, sorted."""
    with _one_at_a_time:
        return sorted(_code_below(root).imported(module))


def direct_imports(module: str, path: Path) -> frozenset[str]:
    """Dotted names that a file imports. Of `from a import b` both a and a.b, since b may be a module."""
    return _asked_directly.read(_enclosing(module, path), path.read_bytes(), path).imports


def _code_below(root: Path) -> _Code:
    """The code below a folder as it is now: what is known of it, or anew if anything has changed."""
    if root not in _known or not _known[root].is_current():
        _known[root] = _Code(root)
    return _known[root]


class _Code:
    """Code below a folder, looked at once."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self._parsed = ParsedFiles(root / KEPT)
        self._stamps: dict[str, Stamp | None] = {}
        self._settled = True
        self._looked_s = time.monotonic()
        self._packages: dict[str, _Package] = {}
        self._modules: dict[str, tuple[ParsedFile, set[str]]] = {}
        self._digests: dict[str, str] = {}
        self._note(str(root))

    def is_current(self) -> bool:
        """Tell whether nothing that was looked at has changed since, as far as its stamps can tell."""
        if time.monotonic() < self._looked_s + LOOK_AGAIN_S:
            return True
        self._looked_s = time.monotonic()
        return self._settled and all(_stamp(path) == stamp for path, stamp in self._stamps.items())

    def digest(self, module: str) -> str:
        """Digest of a module and of all that it imports."""
        if module not in self._digests:
            digest = hashlib.blake2b(digest_size=16)
            for name, file in sorted(self.imported(module).items()):
                digest.update(f"{name}\n{file.code}\n".encode())
                for path in self._data(name):
                    digest.update(os.path.relpath(path, self._root).encode() + self._read(path))
            self._digests[module] = digest.hexdigest()
            self._parsed.save()
        return self._digests[module]

    def imported(self, module: str) -> dict[str, ParsedFile]:
        """The module and those that it imports, directly or not, by name."""
        seen: dict[str, ParsedFile] = {}
        waiting = [module]
        while waiting:
            name = waiting.pop()
            if name not in seen and self.locate(name):
                seen[name], targets = self._module(name)
                waiting += targets
        return seen

    def locate(self, name: str) -> str | None:
        """File of a module or package; None if there is none of that name."""
        return self._package(name).files.get(name)

    def _module(self, name: str) -> tuple[ParsedFile, set[str]]:
        """A module's file, parsed, and the modules that are imported with it."""
        if name not in self._modules:
            path = self.locate(name)
            file = self._parsed.read(_enclosing(name, path), self._read(path), path)
            named = {part for target in (name, *file.imports) for part in (target, *_parents(target))}
            self._modules[name] = file, {target for target in named if self.locate(target)}
        return self._modules[name]

    def _data(self, name: str) -> list[str]:
        """Data files inside a package; of a module, none."""
        path, package = self.locate(name), self._package(name)
        if os.path.basename(path) != "__init__.py":
            return []
        return sorted(data for data in package.data if data.startswith(os.path.dirname(path) + os.sep))

    def _package(self, name: str) -> _Package:
        """The outermost package of a name."""
        top = name.partition(".")[0]
        if top not in self._packages:
            self._packages[top] = found = _Package({}, [])
            if os.path.isfile(path := os.path.join(self._root, f"{top}.py")):
                found.files[top] = path
            for folder, inside, names in os.walk(os.path.join(self._root, top), followlinks=True):
                inside[:] = [name for name in inside if name != "__pycache__"]
                self._note(folder)
                package = os.path.relpath(folder, self._root).replace(os.sep, ".")
                for file in names:
                    stem, suffix = os.path.splitext(file)
                    if suffix == ".py":
                        found.files.setdefault(f"{package}.{stem}", os.path.join(folder, file))
                    found.data.extend([os.path.join(folder, file)] if suffix in DATA_SUFFIXES else [])
                if "__init__.py" in names:
                    found.files[package] = os.path.join(folder, "__init__.py")
        return self._packages[top]

    def _read(self, path: str) -> bytes:
        self._note(path)
        with open(path, "rb") as file:
            return file.read()

    def _note(self, path: str) -> None:
        """Keep the stamp of what is about to be looked at."""
        self._stamps[path] = stamp = _stamp(path)
        self._settled &= stamp is not None and max(stamp[:2]) < time.time_ns() - SETTLED_NS


@dataclass(frozen=True)
class _Package:
    """Content of a package: files of modules by dotted name, and data files."""

    files: dict[str, str]
    data: list[str]


_one_at_a_time = Lock()
"""Held by the thread that asks: a package that another is still listing looks as if it lacked modules."""

_known: dict[Path, _Code] = {}
_asked_directly = ParsedFiles()


def _stamp(path: str) -> Stamp | None:
    try:
        state = os.stat(path)
    except OSError:
        return None
    return state.st_mtime_ns, state.st_ctime_ns, state.st_size, state.st_ino


def _enclosing(name: str, path: str | Path) -> str:
    """The package of a module, to which its relative imports are relative; a package is its own."""
    return name if os.path.basename(path) == "__init__.py" else name.rpartition(".")[0]


def _parents(name: str) -> list[str]:
    parts = name.split(".")
    return [".".join(parts[:count]) for count in range(1, len(parts))]
