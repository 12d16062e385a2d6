"""The settings of a stage: how levels of settings are merged, and what a variant changes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pipeline.config.project import SECTIONS, VARIED, SubjectSettings
from pipeline.config.settings import Settings


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
