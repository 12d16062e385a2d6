"""Lights that need no ball today: those of the survey, or of an earlier calibration.

Lights that did not move are where they were in the stage. Today's cameras have a frame of their own; those that did not
move since lay it over the earlier cameras', and a robust fit finds out which moved.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float64

from pipeline.base.errors import InputError, listed
from pipeline.base.files import read_table
from pipeline.base.verdicts import Verdict
from pipeline.calibration.lights.light_tables import TABLE_COLUMNS
from pipeline.geometry.cameras import Camera, read_cameras
from pipeline.geometry.rigid_alignment import align_rigid

log = logging.getLogger("given_lights")

LEAST_UNMOVED = 2
"""Cameras that have to agree on today's frame, and more than half: one says nothing of itself."""


@dataclass(frozen=True)
class Placed:
    """Today's cameras in the stage's frame, and how far each seems to have moved.

    Attributes:
        cameras: all of today's.
        shift_m: of the cameras of both days: the larger of what its centre and its aim, at the rig's size, moved.
    """

    cameras: dict[str, Camera]
    shift_m: pd.Series


def place_cameras(today: Mapping[str, Camera], earlier: Mapping[str, Camera], largest_shift_m: float) -> Placed:
    """Move today's cameras into the frame of the earlier ones, by those that did not move.

    Raises:
        ValueError: if too few cameras of both days agree on how, with their number.
    """
    names = sorted(set(today) & set(earlier))
    if len(names) < LEAST_UNMOVED:
        raise ValueError(f"{len(names)} cameras of both days")
    extent = _extent(np.stack([earlier[name].center for name in names]))
    source, target = (np.stack([_marks(rig[name], extent) for name in names]) for rig in (today, earlier))
    alignment = align_rigid(source.reshape(-1, 3), target.reshape(-1, 3))
    distance = np.linalg.norm(alignment.residual, axis=1).reshape(len(names), -1)
    shift = pd.Series(distance.max(1), index=names)
    unmoved = int((shift <= largest_shift_m).sum())
    if unmoved < LEAST_UNMOVED or 2 * unmoved <= len(names):
        raise ValueError(f"{unmoved} of {len(names)} cameras of both days within {1000 * largest_shift_m:g} mm")
    R, t = alignment.R, alignment.t
    # x_cam = R_c x_rig + t_c and x_rig = R^T (x_stage - t).
    return Placed({name: replace(c, R=c.R @ R.T, t=c.t - c.R @ R.T @ t) for name, c in today.items()}, shift)


def _extent(centers: Float64[np.ndarray, "cameras 3"]) -> float:
    """Size of a rig, metres, at which a camera's aim counts."""
    return float(np.linalg.norm(centers - centers.mean(0), axis=1).mean())


def _marks(camera: Camera, extent: float) -> Float64[np.ndarray, "4 3"]:
    """A camera's centre, and points at `extent` along its axes: its pose as points."""
    return camera.center + extent * np.concatenate([np.zeros((1, 3)), camera.R])


def take_survey(capture: Path, survey: pd.DataFrame, in_stage: bool) -> tuple[pd.DataFrame, list[Verdict]]:
    """The surveyed lights as they are, for cameras that are in their frame."""
    if not in_stage:
        hint = "known lights do not show in images and cannot place cameras that have a frame of their own"
        raise InputError(f"{capture}: calibration.cameras: expected known cameras in the stage's frame; {hint}")
    lights = survey[["light", "x", "y", "z"]].assign(sigma_m=0.0, status="surveyed", highlights=0)
    why = "known: taken from lights.csv as it is; book_patterns compares it with the images"
    return lights.reindex(columns=TABLE_COLUMNS), [Verdict("light", name, "good", why) for name in lights.light]


def take_earlier(
    lights: Path, cameras: Path, today: Mapping[str, Camera], survey: pd.DataFrame, in_stage: bool,
    largest_shift_m: float,
) -> tuple[pd.DataFrame, dict[str, Camera], list[Verdict]]:  # fmt: skip
    """The earlier day's lights, today's cameras in their frame, and a verdict on each.

    Args:
        lights: lights.parquet of the earlier calibration.
        cameras: cameras.json of the earlier calibration.
        today: in a frame of their own, or `in_stage`.
        survey: lights.csv; its lights that the earlier table lacks keep their surveyed places.

    Raises:
        InputError: if no light is known, or most cameras have moved.
    """
    table = read_table(lights)
    if missing := [column for column in ("light", "x", "y", "z", "status") if column not in table.columns]:
        raise InputError(f"{lights}: expected a table that calibrate_lights wrote, found no {listed(missing)}")
    known = set(table.light) & set(survey.light)
    if not known:
        raise InputError(f"{lights}: expected lights of lights.csv, found none of them; are names the same?")
    placed = Placed(dict(today), pd.Series(dtype=np.float64))
    if not in_stage:
        try:
            placed = place_cameras(today, read_cameras(cameras), largest_shift_m)
        except ValueError as error:
            raise InputError(
                f"{cameras}: expected more than half of today's cameras, and {LEAST_UNMOVED}, to stand where they "
                f"stood, found {error}; photograph a mirror ball, or raise calibrate_lights.largest_camera_shift_m"
            ) from error
        log.info("%d cameras of both days; median shift %.1f mm", len(placed.shift_m), 1000 * placed.shift_m.median())
    rest = survey[~survey.light.isin(known)][["light", "x", "y", "z"]].assign(sigma_m=0.0, status="surveyed")
    rows = table[table.light.isin(known)].reindex(columns=TABLE_COLUMNS)
    found = pd.concat([part for part in (rows, rest.reindex(columns=TABLE_COLUMNS)) if len(part)], ignore_index=True)
    found["highlights"] = found.highlights.fillna(0).astype(int)
    found = found.sort_values("light", ignore_index=True)
    return found, placed.cameras, _verdicts(found, known, placed, largest_shift_m)


def _verdicts(lights: pd.DataFrame, known: set[str], placed: Placed, largest_shift_m: float) -> list[Verdict]:
    verdicts = []
    for name in lights.light:
        if name in known:
            verdicts.append(Verdict("light", name, "good", "taken from an earlier calibration; nothing measured today"))
        else:
            why = "the earlier calibration lacks it: keeps its surveyed position"
            verdicts.append(Verdict("light", name, "weak", why))
    for name, shift in placed.shift_m.items():
        if shift > largest_shift_m:
            why = f"{1000 * shift:.0f} mm from where it was: it moved since the lights were calibrated; places nothing"
            verdicts.append(Verdict("camera", str(name), "weak", why))
    return verdicts
