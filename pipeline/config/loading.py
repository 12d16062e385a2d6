"""Load the configuration: defaults, then a subject's file, then the command line.

All that is wrong is said at once.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from pipeline.base.errors import Complaints
from pipeline.base.yaml_files import read_yaml
from pipeline.config.datasets import DATASETS
from pipeline.config.project import NAME_PATTERN, PROJECT_ONLY, ProjectSettings, SubjectSettings
from pipeline.config.sections import merge
from pipeline.config.settings_check import checked_settings

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
    settings = checked_settings(ProjectSettings, config, origins, complaints)
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
        models[path.stem] = checked_settings(SubjectSettings, merged, origins, complaints)
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


def _read_mapping(path: Path, complaints: Complaints) -> dict[str, Any] | None:
    content = None
    with complaints.collecting():
        content = {} if (read := read_yaml(path)) is None else read
    if content is not None and not isinstance(content, dict):
        complaints.add(path, "file", expected="keys with values", found=type(content).__name__)
        return None
    return content


def _shared(content: Mapping[str, Any]) -> dict[str, Any]:
    """What may differ between subjects."""
    return {key: value for key, value in content.items() if key not in PROJECT_ONLY}


def _without(settings: BaseModel, keys: tuple[str, ...]) -> dict[str, Any]:
    return {name: getattr(settings, name) for name in type(settings).model_fields if name not in keys}
