"""Check that board, balls, survey and known cameras are of one stage, unit and frame."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.errors import Complaints, InputError
from pipeline.calibration.lights.length_units import unit_complaint
from pipeline.config.calibrate_lights import CalibrateLights
from pipeline.geometry.rigid_alignment import align_rigid, fit_scale

log = logging.getLogger("calibrate_lights")

UNITS_SURE = 4.0
"""Standard deviations of a scale below which three or four badly measured lights may have made it up."""

CLEAR_SIGMA = 0.05
"""Standard deviation of a light, over the stage's size in whatever unit, up to which it says something about scale."""

MIRROR = np.array([-1.0, 1.0, 1.0])
"""Turns points into their mirror image; which axis makes no difference up to a rotation."""


def check_units(capture: Path, facts: pd.DataFrame, survey: pd.DataFrame, ball_ratio: float, tolerance: float) -> None:
    """Check that board, ball and survey are in one unit.

    A rigid alignment would hide that they are not.

    Raises:
        InputError: saying which is not, and the factor.
    """
    facts = facts[facts.x.notna()]
    points = facts[["x", "y", "z"]].to_numpy(np.float64)
    if not len(points):
        return  # `align` says so
    extent = np.median(np.linalg.norm(points - np.median(points, 0), axis=1))
    clear = (facts.rival == 0) & (facts.sigma_m < CLEAR_SIGMA * extent)
    surveyed = survey.set_index("light").loc[facts.index[clear], ["x", "y", "z"]].to_numpy(np.float64)
    try:
        scale, sigma = fit_scale(points[clear], surveyed)
    except ValueError:
        return  # too few lights to say; `align` says so
    text = "size over the rig's: survey %.4f +- %.4f; the rig says %.4f times the ball's radius"
    log.info(text, scale, sigma, ball_ratio)
    sure = abs(np.log(scale)) > UNITS_SURE * sigma / scale
    if wrong := unit_complaint(ball_ratio, scale if sure else 1.0, tolerance):
        file, key, expected, found, hint = wrong
        complaints = Complaints(capture)
        complaints.add(file, key, expected=expected, found=found, hint=hint)
        complaints.raise_if_any()


def check_frame(capture: Path, lights: pd.DataFrame, settings: CalibrateLights) -> None:
    """Known cameras must be in the frame of the surveyed lights.

    Raises:
        InputError: if most lights are measured somewhere else.
    """
    away_m = float(np.median(lights.away_m[lights.status == "measured"]))
    if away_m > settings.suspicious_distance_m:
        found = f"lights measured {away_m:.2f} m from where the survey has them (median)"
        hint = "write the cameras in the frame of lights.csv"
        raise InputError(f"{capture}: calibration.cameras: expected the stage's frame, found {found}; {hint}")


def check_survey(
    capture: Path, lights: pd.DataFrame, well: pd.DataFrame, survey: pd.DataFrame, settings: CalibrateLights
) -> None:
    """The survey must be of this stage: it places the cameras, too.

    Once half of the lights are elsewhere, no rigid motion is the right one, and no single light can be blamed.

    Raises:
        InputError: if most lights are measured somewhere else, and whether a mirror image of the survey fits.
    """
    measured = lights[lights.status == "measured"]
    away_m = float(np.median(measured.away_m))
    if away_m <= settings.suspicious_distance_m:
        return
    surveyed = survey.set_index("light").loc[well.index, ["x", "y", "z"]].to_numpy(np.float64)
    mirrored = align_rigid(well[["x", "y", "z"]].to_numpy(np.float64) * MIRROR, surveyed)
    mirrored_m = float(np.median(np.linalg.norm(mirrored.residual, axis=1)))
    hint = "are names shifted or mixed up in lights.csv or among the ball images, or is it another stage's?"
    if mirrored_m <= settings.suspicious_distance_m:
        hint = f"its mirror image fits to {mirrored_m:.2f} m: change the sign of one axis, or exchange two"
    found = f"{len(measured)} lights measured {away_m:.2f} m from it (median)"
    expected = f"a survey that fits to {settings.suspicious_distance_m:g} m (calibrate_lights.suspicious_distance_m)"
    complaints = Complaints(capture)
    complaints.add("lights.csv", "x, y, z", expected=expected, found=found, hint=hint)
    complaints.raise_if_any()
