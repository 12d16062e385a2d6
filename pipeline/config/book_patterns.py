"""Settings of the bookkeeping of light patterns."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from pipeline.config.settings import Settings


class BookPatterns(Settings):
    """How the LED log is checked against the images."""

    on_desync: Literal["error", "fix", "ignore"] = Field(
        "error",
        description="What to do when log and images are clearly a constant number of frames apart: stop, renumber the "
        "patterns (frames without a log are dropped), or go on as logged",
    )
    max_offset_frames: int = Field(5, ge=1, le=100, description="Largest offset between log and images tried [frames]")
    sync_cameras: int = Field(
        16,
        ge=1,
        description="Cameras, evenly spread over the list, whose brightness is averaged for the check [cameras]",
    )
    suspicious_sigma: float = Field(
        6.0, gt=0, description="Robust deviations of log(observed / predicted) brightness that make a frame suspicious"
    )
