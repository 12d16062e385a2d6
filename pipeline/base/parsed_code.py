"""Code and imports of Python files, parsed once and kept on disk by the content of the file.

Parsing all modules of the project takes two seconds, reading them a hundredth. What a text says depends on the text
alone, so that kept entries are never out of date, whatever the files' times say and whoever shares the folder.
"""

from __future__ import annotations

import ast
import hashlib
import json
import sys
from dataclasses import dataclass
from importlib.util import resolve_name
from pathlib import Path
from typing import Any

from pipeline.base.whole_files import written_whole

FULL = 20_000
"""Entries from which on those that were not asked for are dropped: fifty versions of every module, 10 MB."""


@dataclass(frozen=True)
class ParsedFile:
    """The code of a file and its imports.

    Attributes:
        code: hexadecimal BLAKE2b-128 of the syntax tree without the parts that do not run.
        imports: dotted names. Of `from a import b` both a and a.b, since b may be a module.
    """

    code: str
    imports: frozenset[str]


class ParsedFiles:
    """Parsed texts of Python files, and a file that keeps them for other processes.

    A missing or damaged file is an empty one. Processes that write at the same time lose entries of each other, which
    the next one to need them parses again.
    """

    def __init__(self, path: Path | None = None) -> None:
        self._path = path
        self._kept = _read(path) if path else {}
        self._asked: dict[str, dict[str, Any]] = {}
        self._parser = _digest(sys.version.encode() + Path(__file__).read_bytes())

    def read(self, package: str, text: bytes, path: str | Path) -> ParsedFile:
        """Parse a text, unless it is kept.

        Args:
            package: the package of the module, to which relative imports are relative.
            text: its bytes.
            path: for messages, where it stands.

        Raises:
            SyntaxError: if it is no Python.
        """
        key = _digest(f"{self._parser} {package}\n".encode() + text)
        entry = self._asked.get(key) or self._kept.get(key)
        if entry is None:
            parsed = _parse(package, text, path)
            entry = {"code": parsed.code, "imports": sorted(parsed.imports)}
        self._asked[key] = entry
        return ParsedFile(entry["code"], frozenset(entry["imports"]))

    def save(self) -> None:
        """Write what is new, if the folder is there and can be written to."""
        if self._path is None or self._asked.keys() <= self._kept.keys() or not self._path.parent.is_dir():
            return
        kept = _read(self._path)  # What others have written since.
        self._kept = {**(kept if len(kept) < FULL else {}), **self._asked}
        content = json.dumps(self._kept, sort_keys=True).encode()
        try:
            with written_whole(self._path) as temporary:
                temporary.write_bytes(_digest(content).encode() + b"\n" + content)
        except OSError:
            return


def _parse(package: str, text: bytes, path: str | Path) -> ParsedFile:
    tree = ast.parse(text, filename=str(path))
    imports = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            imports |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            source = resolve_name("." * node.level + (node.module or ""), package) if node.level else node.module
            imports |= {source, *(f"{source}.{alias.name}" for alias in node.names)}
    return ParsedFile(_digest(ast.dump(_WithoutProse().visit(tree)).encode()), frozenset(imports))


def _read(path: Path) -> dict[str, dict[str, Any]]:
    try:
        digest, _, content = path.read_bytes().partition(b"\n")
    except OSError:
        return {}
    return json.loads(content) if digest == _digest(content).encode() else {}


def _digest(content: bytes) -> str:
    return hashlib.blake2b(content, digest_size=16).hexdigest()


class _WithoutProse(ast.NodeTransformer):
    def visit_Expr(self, node: ast.Expr) -> ast.AST | None:
        is_text = isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
        return None if is_text else self.generic_visit(node)

    def visit_Call(self, node: ast.Call) -> ast.AST:
        if isinstance(node.func, ast.Name) and node.func.id == "Field":
            node.keywords = [keyword for keyword in node.keywords if keyword.arg != "description"]
        return self.generic_visit(node)
