"""Help of a stage before the stage imports what it works with.

Flags, help and defaults come from the signature and the docstring of `run`, which stand in the stage's text. The names
of the signature are settings and paths; the libraries of the work take seconds to import.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable
from pathlib import Path

HELP_FLAGS = {"-h", "--help"}


def answer_help(folder: Path) -> None:
    """Print the help and exit, if Python was started to print the help of a stage.

    To be called by the package of the stages: `python -m` imports that first. Python says so by an `argv[0]` of -m
    until the module itself is found (https://docs.python.org/3/using/cmdline.html#cmdoption-m).

    Args:
        folder: of the stages' modules.
    """
    if sys.argv[0] != "-m" or not HELP_FLAGS & set(sys.argv):
        return
    path = folder / f"{sys.orig_argv[-len(sys.argv)].rpartition('.')[2]}.py"
    if path.is_file():
        from pipeline.base.command import run_as_command  # Every stage passes here on its way to its work.

        run_as_command(signature_alone(path), program=path.name)


def signature_alone(path: Path) -> Callable[..., None]:
    """The function `run` of a file with its docstring and without its work.

    Of the file's imports only those run that bind names of the signature.
    """
    tree = ast.parse(path.read_bytes(), filename=str(path))
    run = next(node for node in tree.body if isinstance(node, ast.FunctionDef) and node.name == "run")
    run.body = run.body[:1]
    named = {node.id for node in ast.walk(run.args) if isinstance(node, ast.Name)} | {"annotations"}
    for node in tree.body:
        if isinstance(node, ast.Import | ast.ImportFrom):
            node.names = [alias for alias in node.names if (alias.asname or alias.name) in named]
    imports = [node for node in tree.body if isinstance(node, ast.Import | ast.ImportFrom) and node.names]
    namespace = {"__name__": "__main__"}
    exec(compile(ast.Module([*imports, run], []), str(path), "exec"), namespace)
    return namespace["run"]
