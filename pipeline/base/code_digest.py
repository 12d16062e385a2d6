"""Digest of a stage's code: its module and all modules of the project that it imports.

The workflow passes it to each job as a parameter, so that an edit reruns exactly the stages that can run the edited
code. Imports are followed statically, also those inside functions and those of the enclosing packages. Comments,
formatting, docstrings (any bare string) and the descriptions of settings are no code; the weights that a package
carries are.
"""

from __future__ import annotations

import ast
import hashlib
import os
import sys
from contextlib import suppress
from functools import cache
from importlib.util import resolve_name
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
"""The folder that holds the package `pipeline`."""

DATA_SUFFIXES = (".safetensors",)
"""Files inside a package that its code reads."""


def code_digest(module: str, root: Path = ROOT) -> str:
    """Hexadecimal BLAKE2b-128 of a module (dotted name) and of all that it imports below `root`.

    Raises:
        FileNotFoundError: if `root` has no such module.
    """
    if not _locate(module, root):
        raise FileNotFoundError(f"{root}: no module {module}")
    digest = hashlib.blake2b(digest_size=16)
    files = _data_files(root / module.partition(".")[0])
    for name in imported_modules(module, root):
        path = _locate(name, root)
        digest.update(f"{name}\n{_read(name, path)[0]}\n".encode())
        if path.name == "__init__.py":
            for data in (file for file in files if file.is_relative_to(path.parent)):
                digest.update(data.relative_to(root).as_posix().encode() + data.read_bytes())
    return digest.hexdigest()


def _data_files(package: Path) -> list[Path]:
    return sorted(
        Path(folder, name) for folder, _, names in os.walk(package) for name in names if name.endswith(DATA_SUFFIXES)
    )


def imported_modules(module: str, root: Path = ROOT) -> list[str]:
    """`module` and the modules under `root` that it imports, directly or not, sorted."""
    found: dict[str, Path | None] = {}
    waiting = [module]
    while waiting:
        name = waiting.pop()
        if name in found:
            continue
        found[name] = path = _locate(name, root)
        if path is not None:
            waiting += [*_parents(name), *(part for used in _read(name, path)[1] for part in (used, *_parents(used)))]
    return sorted(name for name, path in found.items() if path is not None)


def direct_imports(module: str, path: Path) -> frozenset[str]:
    """Dotted names that a file imports. Of `from a import b` both a and a.b, since b may be a module."""
    return _read(module, path)[1]


def _parents(name: str) -> list[str]:
    parts = name.split(".")
    return [".".join(parts[:count]) for count in range(1, len(parts))]


def _locate(name: str, root: Path) -> Path | None:
    stem = os.path.join(root, *name.split("."))
    return next((Path(path) for path in (f"{stem}/__init__.py", f"{stem}.py") if os.path.isfile(path)), None)


def _read(name: str, path: Path) -> tuple[str, frozenset[str]]:
    state = path.stat()
    return _kept(name, str(path), state.st_mtime_ns, state.st_size)


@cache
def _kept(name: str, file: str, mtime_ns: int, size: int) -> tuple[str, frozenset[str]]:
    """The digest of a file's code and its imports: parsed once, then read from beside the file's bytecode.

    Parsing all modules takes two seconds, more than all else of a plan. What is kept holds for a content, not a time;
    `mtime_ns` and `size` only tell versions of the file apart within a process.
    """
    path = Path(file)
    source = path.read_bytes()
    content = hashlib.blake2b(b"\0".join([_parser(), name.encode(), source]), digest_size=16).hexdigest()
    kept = path.parent / "__pycache__" / f"{path.stem}.code_digest"
    try:
        of_content, digest, *imports = kept.read_text().split()
        if of_content == content:
            return digest, frozenset(imports)
    except (OSError, ValueError):
        pass
    digest, found = _parse(name, path, source)
    with suppress(OSError):  # A folder that cannot be written to is parsed again each time.
        kept.parent.mkdir(exist_ok=True)
        temporary = kept.with_name(f"{kept.name}.{os.getpid()}")
        temporary.write_text("\n".join([content, digest, *sorted(found)]))
        temporary.replace(kept)
    return digest, found


@cache
def _parser() -> bytes:
    """What a syntax tree's text depends on beside the source: this file and the version of Python."""
    return Path(__file__).read_bytes() + sys.version.encode()


def _parse(name: str, path: Path, source: bytes) -> tuple[str, frozenset[str]]:
    """The digest of a file's code without the parts that do not run, and its imports."""
    tree = ast.parse(source, filename=str(path))
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    imports = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            imports |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            origin = resolve_name("." * node.level + (node.module or ""), package) if node.level else node.module
            imports |= {origin, *(f"{origin}.{alias.name}" for alias in node.names)}
    code = ast.dump(_WithoutProse().visit(tree))
    return hashlib.blake2b(code.encode(), digest_size=16).hexdigest(), frozenset(imports)


class _WithoutProse(ast.NodeTransformer):
    def visit_Expr(self, node: ast.Expr) -> ast.AST | None:
        is_text = isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
        return None if is_text else self.generic_visit(node)

    def visit_Call(self, node: ast.Call) -> ast.AST:
        if isinstance(node.func, ast.Name) and node.func.id == "Field":
            node.keywords = [keyword for keyword in node.keywords if keyword.arg != "description"]
        return self.generic_visit(node)
