"""Words of rules beside their jobs' files.

They are patterns of wildcards, files of lights, and how a stage is started.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from pathlib import Path

from pipeline.base.errors import InputError
from pipeline.budget.resolved_project import ResolvedProject
from pipeline.config.loading import Project
from pipeline.config.project import NAME_PATTERN, SubjectSettings
from pipeline.workflow.job_files import RESULTS

LIGHTS = "config/lights"

LIGHT_KINDS = {".hdr": "environment", ".exr": "environment", ".csv": "light_list", ".json": "light_list"}
"""Suffix of a file of lights -> what relight_avatar takes it for, as `pipeline.config.stage_commands` names it."""

NO_NAME = "(?!)"
"""A pattern that nothing matches."""


def estimate_json(project: ResolvedProject, subject: str) -> str:
    """JSON of what the budget of a subject is expected to buy.

    Raises:
        InputError: if it has none.
    """
    estimate = project.estimate(subject)
    if estimate is None:
        raise InputError(f"{RESULTS}/{subject}/budget.csv: expected a budget: --config budget_minutes=10")
    return json.dumps(estimate.as_json())


def subject_pattern(project: Project, asked: Callable[[SubjectSettings], bool]) -> str:
    """Pattern of the names of the subjects whose settings a function finds true.

    The settings are those before a budget changes any.

    Subjects without a file have the project's settings.
    """
    chosen = [name for name, settings in project.subjects.items() if asked(settings)]
    if asked(project.settings):
        chosen.append(f"(?!(?:{'|'.join(project.subjects) or NO_NAME})/){NAME_PATTERN}")
    return one_of(chosen)


def one_of(names: Iterable[str]) -> str:
    """Pattern of one of these names, or of nothing."""
    return "|".join(names) or NO_NAME


def light_file(name: str) -> str:
    """The panorama or list of lights of that name in config/lights.

    Raises:
        InputError: if there is none, or more than one.
    """
    found = [path for suffix in LIGHT_KINDS if (path := Path(f"{LIGHTS}/{name}{suffix}")).is_file()]
    if len(found) != 1:
        raise InputError(
            f"{LIGHTS}: expected one file named {name} with the suffix {', '.join(LIGHT_KINDS)}; found {len(found)}"
        )
    return str(found[0])
