"""Write config/config.yaml and its schema (workflow/schemas) from the settings models.

    python -m pipeline.config.schema

A test keeps both files in step with the models.
"""

from __future__ import annotations

import json
import textwrap
from typing import Any, get_args

import yaml
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from pipeline.base.code_digest import ROOT
from pipeline.config.project import ProjectSettings
from pipeline.config.settings import Settings

WIDTH = 120
HEADER = """\
# yaml-language-server: $schema=../workflow/schemas/config.schema.json
# The defaults. Written by `python -m pipeline.config.schema` from the models in pipeline/config: change them there.
# For one subject, write only what differs to config/subjects/<name>.yaml; for one run, use --configfile or --config.
"""
BOUNDS = {"ge": ">=", "gt": ">", "le": "<=", "lt": "<"}


def config_yaml() -> str:
    """Text of config/config.yaml.

    Every setting has its description, unit and range as a comment, and its default.
    """
    return HEADER + "\n" + "\n".join(_section(ProjectSettings()))


def config_schema() -> str:
    """JSON schema of config/config.yaml, for editors that check while one types."""
    return json.dumps(ProjectSettings.model_json_schema(), indent=2) + "\n"


def _section(settings: BaseModel) -> list[str]:
    lines, sections = [], []
    for name, field in type(settings).model_fields.items():
        value = getattr(settings, name)
        if isinstance(value, Settings):
            sections.append(_comment(field) + f"{name}:\n" + textwrap.indent("".join(_section(value)), "  "))
        else:
            lines.append(_comment(field) + yaml.safe_dump({name: _plain(value)}, default_flow_style=False, width=WIDTH))
    return lines + sections


def _plain(value: Any) -> Any:
    return json.loads(json.dumps(value, default=list))


def _comment(field: FieldInfo) -> str:
    facts = [
        f"{sign} {getattr(item, bound)}"
        for item in field.metadata
        for bound, sign in BOUNDS.items()
        if hasattr(item, bound)
    ]
    choices = [str(choice) for choice in get_args(field.annotation) if isinstance(choice, str)]
    about = field.description or (getattr(field.annotation, "__doc__", None) or "").partition("\n")[0]
    text = ". ".join(filter(None, [about, " | ".join(choices), ", ".join(facts)]))
    return textwrap.indent(textwrap.fill(text, WIDTH - 4), "# ") + "\n" if text else ""


def main() -> None:
    """Write both files."""
    (ROOT / "config/config.yaml").write_text(config_yaml())
    (ROOT / "workflow/schemas/config.schema.json").write_text(config_schema())


if __name__ == "__main__":
    main()
