"""Settings of the review of the calibration."""

from __future__ import annotations

from pydantic import Field

from pipeline.config.settings import Settings


class ReviewCalibration(Settings):
    """Extent of the pictures of the calibration."""

    most_panels: int = Field(
        24, ge=1, le=200, description="Cameras, or balls in cameras, in one picture; of more, the worst [panels]"
    )
    lit_images: int = Field(
        64, ge=0, description="Lit images of a ball laid over each other in its panel, the worst first [images]"
    )
