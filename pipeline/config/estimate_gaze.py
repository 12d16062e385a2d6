"""Settings of estimate_gaze."""

from typing import Literal

from pydantic import Field

from pipeline.config.settings import Settings


class EstimateGaze(Settings):
    """Estimate of the gaze from images, for captures that have eyes and declare no gaze."""

    mode: Literal["auto", "off"] = Field(
        "auto",
        description="auto: where a capture declares template.eyes and no gaze; off: never, and eyes look as tracked",
    )
    views: int = Field(0, ge=0, description="training cameras at most, evenly chosen; 0: all [cameras]")
