"""Digest of a stage's code: its module and all modules of the project that it imports.

The workflow passes it to each job as a parameter, so that an edit reruns exactly the stages that can run the edited
code. Imports are followed statically, also those inside functions and those of the enclosing packages. Comments,
formatting, docstrings (any bare string) and the descriptions of settings are no code; the weights that a package
carries are.
"""

from __future__ import annotations

import ast
import hashlib
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
    for name in imported_modules(module, root):
        path = _locate(name, root)
        digest.update(f"{name}\n{_read(name, path)[0]}\n".encode())
        if path.name == "__init__.py":
            for data in sorted(file for file in path.parent.rglob("*") if file.suffix in DATA_SUFFIXES):
                digest.update(data.relative_to(root).as_posix().encode() + data.read_bytes())
    return digest.hexdigest()


def imported_modules(module: str, root: Path = ROOT) -> list[str]:
    """`module` and the modules under `root` that it imports, directly or not, sorted."""
    seen: set[str] = set()
    waiting = [module]
    while waiting:
        name = waiting.pop()
        path = _locate(name, root)
        if name in seen or path is None:
            continue
        seen.add(name)
        waiting += _parents(name)
        waiting += [found for target in _read(name, path)[1] for found in (target, *_parents(target))]
    return sorted(seen)


def direct_imports(module: str, path: Path) -> frozenset[str]:
    """Dotted names that a file imports. Of `from a import b` both a and a.b, since b may be a module."""
    return _read(module, path)[1]


def _parents(name: str) -> list[str]:
    parts = name.split(".")
    return [".".join(parts[:count]) for count in range(1, len(parts))]


def _locate(name: str, root: Path) -> Path | None:
    stem = root.joinpath(*name.split("."))
    return next((path for path in (stem / "__init__.py", stem.with_suffix(".py")) if path.is_file()), None)


def _read(name: str, path: Path) -> tuple[str, frozenset[str]]:
    state = path.stat()
    return _parse(name, path, state.st_mtime_ns, state.st_size)


@cache
def _parse(name: str, path: Path, mtime_ns: int, size: int) -> tuple[str, frozenset[str]]:
    """A file's code without the parts that do not run, and its imports.

    `mtime_ns` and `size` only tell versions of the file apart, for the cache.
    """
    tree = ast.parse(path.read_bytes(), filename=str(path))
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    imports = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            imports |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            source = resolve_name("." * node.level + (node.module or ""), package) if node.level else node.module
            imports |= {source, *(f"{source}.{alias.name}" for alias in node.names)}
    return ast.dump(_WithoutProse().visit(tree)), frozenset(imports)


class _WithoutProse(ast.NodeTransformer):
    def visit_Expr(self, node: ast.Expr) -> ast.AST | None:
        is_text = isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
        return None if is_text else self.generic_visit(node)

    def visit_Call(self, node: ast.Call) -> ast.AST:
        if isinstance(node.func, ast.Name) and node.func.id == "Field":
            node.keywords = [keyword for keyword in node.keywords if keyword.arg != "description"]
        return self.generic_visit(node)
