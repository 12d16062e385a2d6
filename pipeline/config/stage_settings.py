"""Settings of several stages as one word of JSON, for stages that run others."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from pydantic import BaseModel, ValidationError

from pipeline.base.errors import Complaints, InputError
from pipeline.config.project import SECTIONS


def changed_settings(subject: BaseModel, stages: Sequence[str]) -> str:
    """JSON of a subject's settings of some stages, those that differ from the defaults.

    It is {stage: {setting: value}}.
    """
    changed = {stage: getattr(subject, stage).model_dump(mode="json", exclude_defaults=True) for stage in stages}
    return json.dumps(changed, sort_keys=True)


def read_changes(flag: str, text: str) -> dict[str, Any]:
    """Stage -> changed settings, from the JSON that a flag gives, as they stand.

    Raises:
        InputError: if the text is no JSON object.
    """
    try:
        changed = json.loads(text)
    except ValueError as error:
        raise InputError(f"{flag}: expected JSON, found: {error}") from error
    if not isinstance(changed, dict):
        raise InputError(f"{flag}: expected {{stage: {{setting: value}}}}, found {text}")
    return changed


def read_stage_settings(text: str) -> dict[str, dict[str, Any]]:
    """Stage -> settings that differ from its defaults.

    Raises:
        InputError: naming every stage and key that is not as the stage's settings want it.
    """
    complaints, given = Complaints("--stage-settings"), read_changes("--stage-settings", text)
    for stage, values in given.items():
        try:
            SECTIONS[stage].model_validate(values)
        except KeyError:
            complaints.add("--stage-settings", stage, expected=f"one of {', '.join(SECTIONS)}", found="no such stage")
        except ValidationError as error:
            for problem in error.errors(include_url=False):
                key = ".".join(map(str, (stage, *problem["loc"])))
                complaints.add("--stage-settings", key, expected=problem["msg"], found=repr(problem["input"]))
    complaints.raise_if_any()
    return given
