"""Settings of the calibration of colour."""

from __future__ import annotations

from pydantic import Field

from pipeline.config.settings import Settings


class CalibrateColor(Settings):
    """How cameras are brought to one colour response from images of a 24-patch chart."""

    patch_interior: float = Field(0.8, gt=0, le=1, description="Side of what is measured, over the detected square")
    saturation: float = Field(1.0, gt=0, description="Linear value from which a pixel counts as saturated [full scale]")
    least_patches: int = Field(9, ge=3, le=24, description="Patches without which a camera is refused [patches]")
    good_residual: float = Field(
        0.02, gt=0, description="Residual over the brightest patch up to which the log calls a camera good"
    )
    largest_residual: float = Field(
        0.1, gt=0, description="Residual over the brightest patch above which what was found is no chart: refused"
    )
