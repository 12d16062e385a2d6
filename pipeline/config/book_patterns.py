"""Settings of the bookkeeping of light patterns."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from pipeline.config.settings import Settings


class BookPatterns(Settings):
    """Checks of the LED log against the images."""

    on_desync: Literal["error", "fix", "ignore"] = Field(
        "error",
        description="What to do when log and images disagree: stop and say how; book what was really on (patterns move "
        "to their images, dead and stuck lights as they are, frames of unknown pattern dropped); or go on as logged",
    )
    on_leak: Literal["error", "warn"] = Field(
        "error",
        description="What to do when a training frame shows the same light as a held-out pattern or a partially lit "
        "test frame: stop, or only say so (test frames that test motion, not light)",
    )
    max_offset_frames: int = Field(5, ge=1, le=100, description="Largest offset between log and images tried [frames]")
    sync_cameras: int = Field(
        16, ge=1, description="Cameras, evenly spread over the list, whose brightness is checked [cameras]"
    )
    fault_sigma: float = Field(
        5.0,
        ge=2,
        description="Confidence from which an offset, a lost image, a dead light and so on counts as found "
        "[standard deviations]",
    )
