"""The page of all settings, from the models in pipeline/config."""

from __future__ import annotations

import json
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from docs.generate.markdown import escaped
from pipeline.config.project import PROJECT_ONLY, SECTIONS, ProjectSettings
from pipeline.config.schema import BOUNDS

HEAD = """\
# Settings

<!-- Written by `make schema` from the models in pipeline/config: change them there. -->

Every setting has a default, so a subject's file holds only what differs. The last one wins: `config/config.yaml`,
then `config/subjects/<name>.yaml`, then the command line (`--configfile`, `--config`). An unknown key or a value out
of range is an error; all errors of all files are reported at once, before anything runs. Units stand in brackets.
[Running and reruns](running.md) shows how to set them, [config/README.md](../config/README.md) what the folder holds.

As a flag of a stage, a setting is spelled with hyphens: `track_mesh.inlier_px` is `--inlier-px` of
`python -m pipeline.stages.track_mesh`. Settings that are true or false are `--name` and `--no-name`.
"""


def settings_page() -> str:
    """The page as Markdown: the project's own keys, then a section per stage in data order."""
    own = {name: field for name, field in ProjectSettings.model_fields.items() if name not in SECTIONS}
    only = ", ".join(f"`{name}`" for name in ProjectSettings.model_fields if name in PROJECT_ONLY)
    text = (
        f"\n## Of the project and of subjects\n\n{only} belong to the project and cannot differ between subjects.\n\n"
    )
    text += _table(own, ProjectSettings())
    for stage, model in SECTIONS.items():
        about = " ".join((model.__doc__ or "").split())
        text += f"\n## `{stage}`\n\n{about}\n\n" + _table(model.model_fields, model())
    return HEAD + text


def _table(fields: dict[str, FieldInfo], defaults: BaseModel) -> str:
    if not fields:
        return "No settings.\n"
    rows = []
    for name, field in fields.items():
        about = escaped(field.description or "")
        values = ", ".join(filter(None, [_kind(field.annotation), *_bounds(field)]))
        rows.append(f"| `{name}` | {_value(getattr(defaults, name))} | {values} | {about} |\n")
    return "| setting | default | values | meaning |\n|---|---|---|---|\n" + "".join(rows)


def _value(value: Any) -> str:
    plain = json.dumps(value, default=lambda item: item.model_dump() if isinstance(item, BaseModel) else list(item))
    return f"`{plain}`".replace("|", "\\|")


def _bounds(field: FieldInfo) -> list[str]:
    signs = BOUNDS | {"ge": "≥", "le": "≤"}
    return [f"{sign} {getattr(item, name):g}" for item in field.metadata for name, sign in signs.items()
            if hasattr(item, name)]  # fmt: skip


def _kind(annotation: Any) -> str:
    """The type in a word or two."""
    origin, inner = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _kind(inner[0])
    if origin is Literal:
        return " or ".join(f"`{choice}`" for choice in inner)
    if origin in (Union, UnionType):
        return " or ".join("null" if part is type(None) else _kind(part) for part in inner)
    if origin in (tuple, list):
        return f"list of {_kind(inner[0])}s" if inner else "list"
    if origin is dict:
        return "keys with values"
    names = {str: "text", int: "whole number", float: "number", bool: "true or false"}
    return names.get(annotation, "section")
