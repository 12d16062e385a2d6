"""Verdict on the survey of lights as a whole, against the lights that mirror balls show."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from pipeline.base.verdicts import Verdict
from pipeline.config.calibrate_lights import CalibrateLights
from pipeline.geometry.rigid_alignment import Alignment, align_rigid, fit_scale

SURE = 4.0
"""Standard deviations from which a scale, turn or shift is one, and no accident: of five numbers of a sound survey one
is so far off with a probability of 3e-4."""

WITHIN = 4.03
"""Radius, in standard deviations per axis, that 99.9 % of points are within: the root of chi-square's quantile with
three degrees of freedom."""


def survey_verdict(
    measured: Float64[np.ndarray, "lights 3"], surveyed: Float64[np.ndarray, "lights 3"], alignment: Alignment,
    in_stage: bool, settings: CalibrateLights,
) -> Verdict:  # fmt: skip
    """Judge a survey that fits at all; one that does not is refused.

    Weak if it is larger or smaller than the stage, or, for cameras that are known in its frame, turned or shifted
    against them, surely and by more than lights may be uncertain (`weak_sigma_m`); or so rough that single lights that
    are elsewhere could not be told.

    Args:
        measured: lights that were measured well, in the cameras' frame.
        surveyed: the same in lights.csv.
        alignment: of the two.
        in_stage: whether the cameras are known in the survey's frame.
    """
    count = len(measured)
    centered = surveyed - np.median(surveyed, axis=0)
    radius = float(np.median(np.linalg.norm(centered, axis=1)))
    moved = {}
    if count > 3:
        scale, scale_sigma = fit_scale(measured, surveyed)
        moved[f"{scale:.4f} times as large as the stage"] = (radius * abs(scale - 1), radius * scale_sigma)
    if in_stage:
        own = align_rigid(measured - np.median(surveyed, axis=0), centered) if count > 3 else alignment
        angle = float(np.arccos(np.clip((np.trace(own.R) - 1) / 2, -1, 1)))
        shift = float(np.linalg.norm(own.t))
        sigma = own.sigma / np.sqrt(count)
        moved[f"turned by {np.degrees(angle):.2f} degrees against the cameras"] = (radius * angle, np.sqrt(3) * sigma)
        moved[f"{1000 * shift:.0f} mm beside the cameras' frame"] = (shift, np.sqrt(3) * sigma)
    said = f"{count} lights fit to {1000 * alignment.sigma:.1f} mm per axis"
    flaws = [name for name, (by, sigma) in moved.items() if by > max(SURE * sigma, settings.weak_sigma_m)]
    if WITHIN * alignment.sigma > settings.suspicious_distance_m:
        flaws.append("so rough that lights which are elsewhere cannot be told")
    if flaws:
        return Verdict("survey", "lights.csv", "weak", f"{said}; {', '.join(flaws)}: measure it again, or its unit")
    return Verdict("survey", "lights.csv", "good", said)
