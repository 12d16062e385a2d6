"""Settings of the report."""

from __future__ import annotations

import json

from pydantic import BaseModel, Field

from pipeline.config.settings import Settings


class WriteReport(Settings):
    """Extent and size of the report."""

    page_mb: float = Field(
        12.0, ge=1, le=200, description="The page is at most so large: pictures are compressed until it is [MB]"
    )
    most_variants: int = Field(4, ge=1, le=50, description="Avatars whose worst, median and best image are shown")
    most_sheets: int = Field(4, ge=0, le=50, description="Cameras whose tracking is shown, evenly chosen [cameras]")
    most_stills: int = Field(6, ge=0, le=50, description="Pictures in other light that are shown, evenly chosen")


def subject_changes(subject: BaseModel) -> str:
    """JSON of a subject's settings that differ from the defaults.

    It is {stage: {setting: value}} and the keys beside.
    """
    return json.dumps(subject.model_dump(mode="json", exclude_defaults=True), sort_keys=True)
