"""The page of the stages' command lines, from the signatures and docstrings of their modules, which it only parses."""

from __future__ import annotations

import ast
import re
from pathlib import Path

from docs.generate.markdown import escaped
from pipeline.base.code_digest import ROOT
from pipeline.config.project import SECTIONS

STAGES = ROOT / "pipeline/stages"

HEAD = """\
# Command lines of the stages

<!-- Written by `make schema` from the modules in pipeline/stages: change them there. -->

Every stage is a module that reads files and writes files. The workflow calls it as shown here; by hand,
`python -m pipeline.stages.<stage> --help` lists the same flags and those of its [settings](settings.md). To see the
exact command of a job, run `make results/<name>/metrics.csv FLAGS='--printshellcmds --dry-run --forcerun <stage>'`.
A stage that cannot do its work prints one line, `error: ...`, and exits with 1; see
[troubleshooting](troubleshooting.md).
"""

ENTRY = re.compile(r"^(\w+(?:, \w+)*): (.*)$")
"""An argument in the section Args of a docstring, or several that share a line."""


def commands_page() -> str:
    """The page as Markdown: a section per stage in data order."""
    return HEAD + "".join(_section(stage, STAGES / f"{stage}.py") for stage in SECTIONS)


def _section(stage: str, path: Path) -> str:
    module = ast.parse(path.read_text())
    run = next(node for node in module.body if isinstance(node, ast.FunctionDef) and node.name == "run")
    says = _arguments(ast.get_docstring(run) or "")
    rows = []
    for argument, default in zip(run.args.kwonlyargs, run.args.kw_defaults, strict=True):
        if argument.arg != "settings":
            needed = "required" if default is None else _shown(ast.unparse(default))
            name, kind = argument.arg.replace("_", "-"), ast.unparse(argument.annotation)
            kind = {"Path": "path", "tuple[Path, ...]": "paths", "Path | None": "path", "int": "whole number",
                    "str": "text", "bool": "true or false"}.get(kind, kind)  # fmt: skip
            rows.append(f"| `--{name}` | {kind} | {needed} | {says.get(argument.arg, '')} |\n")
    about = "\n\n".join(" ".join(part.split()) for part in (ast.get_docstring(module) or "").split("\n\n"))
    about = escaped(about)
    more = f"Settings: [`{stage}`](settings.md#{stage}).\n" if SECTIONS[stage].model_fields else ""
    table = "| flag | takes | default | meaning |\n|---|---|---|---|\n" + "".join(rows)
    return f"\n## `{stage}`\n\n`python -m pipeline.stages.{stage}`\n\n{about}\n\n{table}\n{more}"


def _shown(default: str) -> str:
    return {"None": "none", "()": "none", "''": "empty"}.get(default, f"`{default}`")


def _arguments(docstring: str) -> dict[str, str]:
    """Argument -> what the section Args says of it."""
    _, _, rest = docstring.partition("Args:\n")
    section, _, _ = rest.partition("\nRaises:")
    entries: dict[str, str] = {}
    names: list[str] = []
    for line in section.splitlines():
        found = ENTRY.match(line.strip()) if line.startswith("    ") and not line.startswith("     ") else None
        if found:
            names, text = found[1].split(", "), found[2]
            entries |= dict.fromkeys(names, text)
        elif line.strip():
            entries |= {name: f"{entries[name]} {line.strip()}" for name in names}
    return {name: escaped(text) for name, text in entries.items()}
