"""Check settings against their models, and complain of each with the file that says it."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from difflib import get_close_matches
from itertools import product
from typing import Any

from pydantic import BaseModel, ValidationError

from pipeline.base.errors import Complaints
from pipeline.config.datasets import DATASETS, WITHOUT_PROTOCOL
from pipeline.config.project import SECTIONS, VARIED, SubjectSettings
from pipeline.config.sections import changes_to, section_for


def checked_settings(
    model: type[BaseModel], content: Any, origins: list[tuple[str, Any]], complaints: Complaints
) -> Any:
    """Settings as their model has them, or None after complaining.

    `origins` say which file a key comes from, the last writer first.
    """
    try:
        settings = model(**content)
    except ValidationError as error:
        _complain(error, model, origins, complaints)
        return None
    _complain_of_path(settings, origins, complaints)
    _complain_of_protocol(settings, origins, complaints)
    for variant, stage in product(settings.variants, VARIED):
        _complain_of_variant(settings, variant, stage, origins, complaints)
    return settings


def _complain_of_variant(
    settings: SubjectSettings, variant: str, stage: str, origins: list[tuple[str, Any]], complaints: Complaints
) -> None:
    """What a variant changes in a stage must be keys of that stage, whose values it takes."""
    asked = settings.variants[variant]
    inside = ("variants", variant) if stage == "train_avatar" else ("variants", variant, stage)
    own = [(where, _dig(given, inside)) for where, given in origins]
    if stage == "train_avatar" and stage in asked:
        where = next(where for where, given in own if isinstance(given, Mapping) and stage in given)
        key, expected = f"variants.{variant}.{stage}", f"settings of {stage} beside each other, without a section"
        complaints.add(where, key, expected=expected, found="a section", hint="move its keys one level up")
    if not isinstance(changes := changes_to(stage, asked), Mapping):
        where = next(where for where, given in own if given is not _ABSENT)
        complaints.add(where, ".".join(inside), expected=f"keys of {stage}", found=repr(changes))
        return
    try:
        section_for(settings, stage, variant)
    except ValidationError as error:
        _complain(error, SECTIONS[stage], own, complaints, prefix=f"{'.'.join(inside)}.")
        return
    if stage == "train_avatar" and (found := _fault_of_geometry(settings, variant)):
        where, key = _place_of("geometry_from", [inside, ("train_avatar",)], origins)
        complaints.add(where, key, expected="another variant, which does not come back to this one", found=found)


def _place_of(
    key: str, sections: Sequence[tuple[str, ...]], origins: list[tuple[str, Any]]
) -> tuple[str, str]:  # fmt: skip
    """The file that a setting comes from, and its name there, looked for in one section after the other."""
    for section in sections:
        for where, content in origins:
            if isinstance(given := _dig(content, section), Mapping) and key in given:
                return where, ".".join((*section, key))
    return origins[0][0], ".".join((*sections[0], key))


def _fault_of_geometry(settings: SubjectSettings, variant: str) -> str:
    """Why a variant cannot take the geometry that it asks for, or nothing."""
    way = [variant]
    with suppress(ValidationError):  # of another variant, whose own complaint it is
        while source := section_for(settings, "train_avatar", way[-1]).geometry_from:
            way.append(source)
            if source not in settings.variants:
                return f"{source!r}, of {', '.join(settings.variants)}"
            if source in way[:-1]:
                return " -> ".join(way)
    return ""


def _complain_of_path(settings: SubjectSettings, origins: list[tuple[str, Any]], complaints: Complaints) -> None:
    """A public set needs a path; any other source has none."""
    public = settings.source in DATASETS
    if public == bool(settings.path):
        return
    where = next(name for name, given in origins if ("source" if public else "path") in given)
    if public:
        complaints.add(where, "path", expected=f"the folder of a {settings.source} capture", found="none")
    else:
        found = f"{settings.source!r}, which has no path"
        complaints.add(where, "source", expected=f"one of {', '.join(DATASETS)}", found=found)


def _complain_of_protocol(
    settings: SubjectSettings, origins: list[tuple[str, Any]], complaints: Complaints
) -> None:  # fmt: skip
    """Some public sets state none."""
    asked = settings.evaluate_avatar.protocol
    if asked in WITHOUT_PROTOCOL:
        where, key = _place_of("protocol", [("evaluate_avatar",)], origins)
        hint = (
            f"{asked} has none: {WITHOUT_PROTOCOL[asked]}; take no preset of a set, docs/datasets.md says what ours is"
        )
        complaints.add(where, key, expected="ours, or that of a set that states one", found=asked, hint=hint)


def _complain(
    error: ValidationError, model: type[BaseModel], origins: list, complaints: Complaints, prefix: str = ""
) -> None:
    for problem in error.errors(include_url=False):
        where = next((name for name, given in origins if _dig(given, problem["loc"]) is not _ABSENT), origins[-1][0])
        key = prefix + ".".join(str(part) for part in problem["loc"] if part != "[key]")
        if problem["type"] == "extra_forbidden":
            known = list(_model_at(model, problem["loc"][:-1]).model_fields)
            close = get_close_matches(str(problem["loc"][-1]), known, n=1)
            hint = f"did you mean {close[0]}?" if close else f"known keys: {', '.join(known) or 'none'}"
            complaints.add(where, key, expected="a known key", found="an unknown one", hint=hint)
        else:
            expected = re.sub("^(Input|Value|String) should (be |have |match )?", "", problem["msg"])
            complaints.add(where, key, expected=expected, found=repr(problem["input"]))


_ABSENT = object()


def _dig(given: Any, location: tuple) -> Any:
    for part in location:
        if part == "[key]":
            return given
        if isinstance(given, Mapping) and part in given:
            given = given[part]
        else:
            # A position in a list, or a key below a value that is no mapping: whoever wrote the value wrote this.
            return given if given is not _ABSENT and not isinstance(given, Mapping) else _ABSENT
    return given


def _model_at(model: type[BaseModel], location: tuple) -> type[BaseModel]:
    for part in location:
        model = model.model_fields[part].annotation
    return model
