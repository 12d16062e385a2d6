"""Settings of the calibration of colour."""

from __future__ import annotations

from pydantic import Field

from pipeline.config.settings import Settings


class CalibrateColor(Settings):
    """Calibration of colour: one response for all cameras, from a 24-patch chart."""

    patch_interior: float = Field(0.8, gt=0, le=1, description="Side of what is measured, over the detected square")
    saturation: float = Field(
        0.99, gt=0, description="Stored value from which a pixel counts as saturated [largest count; 1 for .exr]"
    )
    largest_nonlinearity: float = Field(
        0.02, gt=0, lt=1, description="Departure from a line up to which a sensor's counts are linear, relative"
    )
    least_patches: int = Field(9, ge=3, le=24, description="Patches without which a camera is refused [patches]")
    good_residual: float = Field(
        0.02, gt=0, description="Residual over the brightest patch up to which a patch, and a camera, are called good"
    )
    largest_residual: float = Field(
        0.05, gt=0, description="Median residual over the brightest patch above which it is another chart: refused"
    )
    good_sigma: float = Field(
        0.005, gt=0, description="Standard deviation of the response, over its gain, up to which a camera is good"
    )
    largest_sigma: float = Field(
        0.05, gt=0, description="Standard deviation of the response, over its gain, above which a camera is refused"
    )
    good_tint: float = Field(
        1.4, gt=1, description="Factor of red or blue to green, against the median camera's, that cameras may differ by"
    )
    largest_tint: float = Field(
        2.0, gt=1, description="Factor of red or blue to green above which the light was another one: refused"
    )
    good_brightness: float = Field(
        1.5, gt=1, description="Factor of brightness, against the median camera's, that cameras may differ by"
    )
