"""Settings of the calibration of the lights."""

from __future__ import annotations

from pydantic import Field

from pipeline.config.settings import Settings


class CalibrateLights(Settings):
    """How lights are located from their highlights in a mirror ball."""

    least_highlights: int = Field(
        3, ge=2, description="Highlights without which a light keeps its surveyed position [highlights]"
    )
    largest_sigma_m: float = Field(
        0.03, gt=0, description="Standard deviation per axis above which a light keeps its surveyed position [m]"
    )
    suspicious_distance_m: float = Field(
        0.25, gt=0, description="Distance from a light's surveyed position at which the log warns of swapped names [m]"
    )
