"""All dials."""

from __future__ import annotations

from pipeline.dials.calibration import CALIBRATION_DIALS
from pipeline.dials.dial import Dial
from pipeline.dials.irradiance import IRRADIANCE_DIALS
from pipeline.dials.packing import PACKING_DIALS
from pipeline.dials.papers import PAPERS_DIALS
from pipeline.dials.relighting import RELIGHTING_DIALS
from pipeline.dials.tracking import TRACKING_DIALS
from pipeline.dials.trained import TRAINED_DIALS
from pipeline.dials.training import TRAINING_DIALS

DIALS: list[Dial] = [
    *CALIBRATION_DIALS, *TRACKING_DIALS, *IRRADIANCE_DIALS, *PACKING_DIALS, *TRAINED_DIALS, *TRAINING_DIALS,
    *PAPERS_DIALS, *RELIGHTING_DIALS,
]  # fmt: skip
"""All dials, in data order."""
