"""Settings of fit_eyes."""

from typing import Literal

from pydantic import Field

from pipeline.config.settings import Settings


class FitEyes(Settings):
    """Fit of eyes to the tracked template."""

    frames: int = Field(64, ge=1, description="at most this many frames with a declared gaze, evenly chosen [frames]")
    cornea: Literal["auto", "usual", "none"] = Field(
        "auto",
        description="auto: as the template has it, else an average eye's; usual: always that; none: plain spheres",
    )
