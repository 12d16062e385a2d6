"""Load the configuration: defaults, then a subject's file, then the command line.

All that is wrong is said at once.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from difflib import get_close_matches
from itertools import product
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from pipeline.base.errors import Complaints
from pipeline.base.yaml_files import read_yaml
from pipeline.config.datasets import DATASETS, WITHOUT_PROTOCOL
from pipeline.config.project import (
    NAME_PATTERN,
    PROJECT_ONLY,
    SECTIONS,
    VARIED,
    ProjectSettings,
    SubjectSettings,
)
from pipeline.config.settings import Settings

DEFAULTS_FILE = "config/config.yaml"
COMMAND_LINE = "command line (--config, --configfile)"

RENAMED = {"unwrap_textures": "bake_textures"}
"""Sections that files from before 2026-11-22 call otherwise -> their present names."""


@dataclass(frozen=True)
class Project:
    """Validated configuration of the project and of every subject that has its own file.

    Attributes:
        settings: the project's.
        subjects: those of subjects with a file.
        written: what these files say.
        command_line: what the command line says.
    """

    settings: ProjectSettings
    subjects: Mapping[str, SubjectSettings]
    written: Mapping[str, Mapping[str, Any]]
    command_line: Mapping[str, Any]

    def said_by_user(self, name: str) -> Mapping[str, Any]:
        """Settings that a subject's file and the command line say, without the defaults."""
        return merge(self.written.get(name, {}), _shared(self.command_line))

    def subject(self, name: str) -> SubjectSettings:
        """The settings of any subject: a subject without a file has the project's."""
        return self.subjects.get(name) or SubjectSettings(**_without(self.settings, PROJECT_ONLY))

    @property
    def synthetic_subjects(self) -> list[str]:
        """Subjects that synthesize_capture makes."""
        return sorted(name for name, settings in self.subjects.items() if settings.source == "synthetic")

    @property
    def imported_subjects(self) -> list[str]:
        """Subjects that import_capture reads from a public set."""
        return sorted(name for name, settings in self.subjects.items() if settings.source in DATASETS)


def load_project(config: Mapping[str, Any], command_line: Mapping[str, Any], subjects: Path) -> Project:
    """Validate everything.

    Args:
        config: the defaults, with the command line's changes already in.
        command_line: the command line's changes alone: they win over a subject's file, too.
        subjects: folder of <name>.yaml files.

    Raises:
        InputError: naming, for every problem, file, key, what was expected and what was found.
    """
    complaints = Complaints("configuration")
    config, command_line = with_present_names(config), with_present_names(command_line)
    origins = [(COMMAND_LINE, command_line), (DEFAULTS_FILE, config)]
    settings = _validate(ProjectSettings, config, origins, complaints)
    shared, changes = _shared(config), _shared(command_line)
    models, written = {}, {}
    for path in sorted(subjects.glob("*.yaml")):
        if not re.fullmatch(NAME_PATTERN, path.stem):
            complaints.add(path, "file name", expected=f"a subject's name, {NAME_PATTERN}", found=repr(path.stem))
        own = _read_mapping(path, complaints)
        if own is None:
            continue
        own = written[path.stem] = with_present_names(own)
        merged = merge(merge(shared, own), changes)
        origins = [(COMMAND_LINE, changes), (str(path), own), (DEFAULTS_FILE, config)]
        models[path.stem] = _validate(SubjectSettings, merged, origins, complaints)
    complaints.messages[:] = dict.fromkeys(complaints.messages)
    complaints.raise_if_any()
    return Project(settings, models, written, command_line)


def with_present_names(content: Mapping[str, Any]) -> dict[str, Any]:
    """Put renamed sections of a file under their present names; see `RENAMED`."""
    present = {key: value for key, value in content.items() if key not in RENAMED}
    for old, new in RENAMED.items():
        if old in content:
            present = merge(present, {new: content[old]})
    return present


def merge(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """`base` with `changes`: mappings merge key by key, anything else is replaced.

    `variants` is replaced, too: a subject that names its avatars wants those and no others.
    """
    merged = dict(base)
    for key, value in changes.items():
        old = merged.get(key)
        both = isinstance(old, Mapping) and isinstance(value, Mapping) and key != "variants"
        merged[key] = merge(old, value) if both else value
    return merged


def section_for(settings: SubjectSettings, stage: str, variant: str | None = None) -> Settings:
    """The settings of a stage, with what `variant` changes in it."""
    section = getattr(settings, stage)
    if variant is None or stage not in VARIED:
        return section
    return SECTIONS[stage](**merge(section.model_dump(), changes_to(stage, settings.variants[variant])))


def changes_to(stage: str, variant: Mapping[str, Any]) -> Any:
    """Changes that a variant makes in a stage.

    Its key `trace_irradiance` holds changes to that stage, all else is train_avatar's.
    """
    if stage == "train_avatar":
        return {key: value for key, value in variant.items() if key not in VARIED}
    return variant.get(stage, {})


def has_own_light(settings: SubjectSettings, variant: str) -> bool:
    """True if a variant asks for other irradiance maps than its subject's."""
    return section_for(settings, "trace_irradiance", variant) != settings.trace_irradiance


def _read_mapping(path: Path, complaints: Complaints) -> dict[str, Any] | None:
    content = None
    with complaints.collecting():
        content = {} if (read := read_yaml(path)) is None else read
    if content is not None and not isinstance(content, dict):
        complaints.add(path, "file", expected="keys with values", found=type(content).__name__)
        return None
    return content


def _validate(model: type[BaseModel], content: Any, origins: list[tuple[str, Any]], complaints: Complaints) -> Any:
    """The validated model, or None after complaining; `origins` say which file a key comes from, last writer first."""
    try:
        settings = model(**content)
    except ValidationError as error:
        _complain(error, model, origins, complaints)
        return None
    _complain_of_path(settings, origins, complaints)
    _complain_of_protocol(settings, origins, complaints)
    for variant, stage in product(settings.variants, VARIED):
        inside = ("variants", variant) if stage == "train_avatar" else ("variants", variant, stage)
        own = [(where, _dig(given, inside)) for where, given in origins]
        if stage == "train_avatar" and stage in settings.variants[variant]:
            where = next(where for where, given in own if isinstance(given, Mapping) and stage in given)
            key, expected = f"variants.{variant}.{stage}", f"settings of {stage} beside each other, without a section"
            complaints.add(where, key, expected=expected, found="a section", hint="move its keys one level up")
        if not isinstance(changes_to(stage, settings.variants[variant]), Mapping):
            where = next(where for where, given in own if given is not _ABSENT)
            complaints.add(where, ".".join(inside), expected=f"keys of {stage}", found=repr(_dig(content, inside)))
            continue
        try:
            section_for(settings, stage, variant)
        except ValidationError as error:
            _complain(error, SECTIONS[stage], own, complaints, prefix=f"{'.'.join(inside)}.")
            continue
        if stage == "train_avatar" and (found := _fault_of_geometry(settings, variant)):
            where, key = _place_of("geometry_from", [inside, ("train_avatar",)], origins)
            complaints.add(where, key, expected="another variant, which does not come back to this one", found=found)
    return settings


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


def _shared(content: Mapping[str, Any]) -> dict[str, Any]:
    """What may differ between subjects."""
    return {key: value for key, value in content.items() if key not in PROJECT_ONLY}


def _without(settings: BaseModel, keys: tuple[str, ...]) -> dict[str, Any]:
    return {name: getattr(settings, name) for name in type(settings).model_fields if name not in keys}
