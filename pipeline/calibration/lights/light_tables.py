"""Lights as tables: measurements from spots in mirror balls, and rows of lights.parquet."""

from __future__ import annotations

import logging

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float64

from pipeline.calibration.lights.ball_photos import CHANNELS
from pipeline.calibration.lights.highlight_matching import constant_spots, match_highlights
from pipeline.calibration.lights.light_intensity import Brightness, compare_lights, relative_colors
from pipeline.calibration.lights.light_verdicts import AGREES_WEIGHT, resemblances
from pipeline.calibration.lights.mirror_ball import Ball
from pipeline.calibration.lights.mirror_lights import Highlights, locate_lights
from pipeline.config.calibrate_lights import CalibrateLights
from pipeline.geometry.cameras import Camera
from pipeline.geometry.rigid_alignment import Alignment

log = logging.getLogger("light_tables")

RESIDUAL_COLUMNS = ["light", "position", "camera", "x", "y", "residual_x", "residual_y", "weight"]
"""Of residuals_lights.parquet: highlights in pixels, predicted minus measured, and their weight in the robust fit."""

COVARIANCE = ["cov_xx", "cov_xy", "cov_xz", "cov_yy", "cov_yz", "cov_zz"]

BRIGHTNESS = [
    "intensity", "intensity_sigma", *(f"color_{c}" for c in CHANNELS), *(f"color_{c}_sigma" for c in CHANNELS),
]  # fmt: skip

MEASURED_COLUMNS = ["x", "y", "z", *COVARIANCE, "sigma_m", "highlights", "agreeing", "rival"]
"""Per light in the cameras' frame: metres, metres^2 and metres; images with a highlight, those that agree on the place,
and those that agree on another."""

TABLE_COLUMNS = ["light", "x", "y", "z", "sigma_m", "status", *COVARIANCE, "highlights", *BRIGHTNESS]
"""Of lights.parquet. sigma_m and the covariance (metres^2; NaN for surveyed lights) are against the cameras: where the
survey puts rig and lights together is not in them. intensity is over the geometric mean of all measured lights, color
over their mean colour, both NaN where the images do not tell."""


def measure_lights(
    spots: pd.DataFrame, balls: dict[str, Ball], cameras: dict[str, Camera], radius_m: float, lights: list[str],
    settings: CalibrateLights,
) -> tuple[pd.DataFrame, pd.DataFrame]:  # fmt: skip
    """Measurements of lights in the cameras' frame.

    `MEASURED_COLUMNS` and brightness per light, and a row per highlight.

    Args:
        spots: what `ball_photos.find_spots` found.
        lights: all there are; those with too few highlights have NaN.
    """
    names = sorted(set(spots.camera))
    eyes = [cameras[name] for name in names]
    constant = constant_spots(_as_highlights(spots, sorted(set(spots.light)), list(balls), names))
    if constant.any():
        log.warning("%d spots are at one place whichever light is on (lamp, window?): ignored", constant.sum())
    spots = spots[~constant]
    images = spots.drop_duplicates(["light", "position", "camera"]).light.value_counts()
    facts = pd.DataFrame(index=pd.Index(lights, name="light"), columns=MEASURED_COLUMNS, dtype=np.float64)
    facts[["highlights", "agreeing", "rival"]] = 0
    facts["highlights"] = facts.index.map(images).fillna(0).astype(int)
    enough = sorted(images.index[images >= settings.least_highlights])
    table = spots[spots.light.isin(enough)].reset_index(drop=True)
    if not enough:
        return facts, table.reindex(columns=RESIDUAL_COLUMNS)
    candidates = _as_highlights(table, enough, list(balls), names)
    centers = np.stack([ball.center for ball in balls.values()])
    matches = match_highlights(candidates, centers, eyes, radius_m, len(enough))
    table, highlights = table.loc[matches.rows].reset_index(drop=True), candidates.select(matches.rows)
    located = locate_lights(highlights, list(balls.values()), eyes, radius_m, matches.start)
    table[["residual_x", "residual_y"]], table["weight"] = located.residual, located.weight
    agrees = located.weight >= AGREES_WEIGHT
    facts.loc[enough, ["x", "y", "z"]] = located.position
    upper = np.triu_indices(3)
    facts.loc[enough, MEASURED_COLUMNS[3:9]] = located.own_covariance[:, *upper]
    facts.loc[enough, "sigma_m"] = np.sqrt(np.trace(located.own_covariance, axis1=1, axis2=2) / 3)
    facts.loc[enough, "agreeing"] = np.bincount(highlights.light[agrees], minlength=len(enough))
    facts.loc[enough, "rival"] = matches.rival
    counts = ["highlights", "agreeing", "rival"]
    facts[counts] = facts[counts].astype(int)
    bright = _brightness_columns(table, highlights, located.spread, agrees, enough, settings.farthest_for_flux)
    return facts.join(bright), table


def _as_highlights(table: pd.DataFrame, lights: list[str], positions: list[str], cameras: list[str]) -> Highlights:
    """Names to indices into the lists."""
    indices = [
        column.map({name: k for k, name in enumerate(names)}).to_numpy(np.int64)
        for column, names in ((table.light, lights), (table.position, positions), (table.camera, cameras))
    ]
    return Highlights(*indices, table[["x", "y"]].to_numpy(np.float64))


def _brightness_columns(
    table: pd.DataFrame, highlights: Highlights, spread: Float64[np.ndarray, " highlights"],
    agrees: Bool[np.ndarray, " highlights"], lights: list[str], farthest: float,
) -> pd.DataFrame:  # fmt: skip
    """`BRIGHTNESS`, no_intensity and no_color (why, or "") by light, from highlights that agree on where it is."""
    clipped, inside = table.saturated.to_numpy(bool), table.distance.to_numpy() < farthest
    usable = agrees & ~clipped & inside
    index = pd.Index(lights)

    def compare(columns: list[str]) -> Brightness:
        flux = table[columns].to_numpy(np.float64)
        return compare_lights(
            highlights.light[usable], highlights.camera[usable], flux[usable], spread[usable], len(lights)
        )

    gray, colored = compare(["flux"]), relative_colors(compare([f"flux_{c}" for c in CHANNELS]))
    numbers = np.concatenate([gray.value, gray.sigma, colored.value, colored.sigma], 1)
    found = pd.DataFrame(numbers, index=index, columns=BRIGHTNESS)
    good, all_clipped = (
        np.bincount(highlights.light[rows], minlength=len(lights)) for rows in (usable, agrees & clipped)
    )
    found["no_intensity"] = [
        "" if some else "its highlights are clipped: expose shorter" if over else "no highlight away from the rim"
        for some, over in zip(good, all_clipped, strict=True)
    ]
    found["no_color"] = "" if table.flux_r.notna().any() else "the images are grey"
    return found


def place_in_stage(
    facts: pd.DataFrame, survey: pd.DataFrame, alignment: Alignment, in_stage: bool, settings: CalibrateLights
) -> pd.DataFrame:
    """All lights in the stage's frame: `TABLE_COLUMNS` and what `light_verdicts` reads.

    Args:
        facts: what was measured in the cameras' frame, by light, and `why` it counts for nothing (or "").
        in_stage: whether that is the stage's frame already.
    """
    lights = survey[["light", "x", "y", "z"]].set_index("light").join(facts.drop(columns=["x", "y", "z"]))
    well = facts.index[facts.why == ""]
    lights["status"] = np.where(lights.index.isin(well), "measured", "surveyed")
    lights.loc[lights.status == "surveyed", [*COVARIANCE, *BRIGHTNESS]] = np.nan
    points = facts.loc[well, ["x", "y", "z"]].to_numpy(np.float64)
    stage = points if in_stage else alignment.apply(points)
    surveyed = lights.loc[well, ["x", "y", "z"]].to_numpy(np.float64)
    lights.loc[well, ["x", "y", "z"]] = stage
    if not in_stage:
        lights.loc[well, COVARIANCE] = _turned(facts.loc[well, COVARIANCE].to_numpy(np.float64), alignment.R)
    lights["away_m"], lights["looks_like"] = 0.0, ""
    lights.loc[well, "away_m"] = np.linalg.norm(stage - surveyed, axis=1)
    lights.loc[well, "looks_like"] = resemblances(list(well), stage, surveyed, settings.suspicious_distance_m)
    lights[["no_intensity", "no_color"]] = lights[["no_intensity", "no_color"]].fillna("")
    return lights.reset_index()


def _turned(upper: np.ndarray, R: np.ndarray) -> np.ndarray:
    """Covariances, as their six numbers, in the axes that R turns them to."""
    full = np.zeros((len(upper), 3, 3))
    rows, columns = np.triu_indices(3)
    full[:, rows, columns] = full[:, columns, rows] = upper
    return (R @ full @ R.T)[:, rows, columns]
