"""Locate all lights in mirror balls, and move the cameras into the stage's frame.

It reads images of mirror balls and writes positions and brightness of the lights.

Each ball is located by its outlines in all cameras that see it; which bright spots are a light's, balls and cameras
decide together; then all lights and balls are fitted to highlights and outlines at once (see
pipeline.calibration.lights.mirror_lights). The measured lights, in the rig's frame, are laid over the surveyed ones
without scaling: the survey is good to centimetres only, but it says where the stage is. Lights that are measured too
poorly keep their surveyed position. With `method: earlier` lights of an earlier calibration are taken, and
cameras are placed by those that have not moved since. With `method: known` the surveyed positions are taken as they
are; the cameras, which are then known in the stage's frame, stay where they are.

Of many photographs, those of some cameras are measured by a job of its own each; the lights that are then fitted to
the tables of these jobs are the same.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float64

from pipeline.base.command import run_as_command
from pipeline.base.errors import InputError
from pipeline.base.files import read_json, read_table, write_table
from pipeline.base.verdicts import Verdict, log_verdicts, verdict_table
from pipeline.calibration.lights.ball_measurements import (
    measure_balls,
    of_cameras,
    read_measurements,
    write_measurements,
)
from pipeline.calibration.lights.ball_photos import use_most_balls
from pipeline.calibration.lights.given_lights import take_earlier, take_survey
from pipeline.calibration.lights.length_units import radius_in_rig, size_by_lights
from pipeline.calibration.lights.light_tables import RESIDUAL_COLUMNS, TABLE_COLUMNS, measure_lights, place_in_stage
from pipeline.calibration.lights.light_verdicts import ball_verdicts, light_verdicts, refusals, why_not_measured
from pipeline.calibration.lights.mirror_ball import locate_ball
from pipeline.calibration.lights.stage_checks import check_frame, check_survey, check_units
from pipeline.calibration.lights.survey_verdict import survey_verdict
from pipeline.config.calibrate_lights import CalibrateLights
from pipeline.geometry.cameras import Camera, read_cameras, write_cameras
from pipeline.geometry.rigid_alignment import Alignment, align_rigid

log = logging.getLogger("calibrate_lights")

Outlines = Mapping[tuple[str, str], Float64[np.ndarray, "_ 2"]]
"""Pixels of balls' outlines, by position and camera."""


def run(
    *,
    capture: Path,
    index: Path,
    rig: Path,
    out: Path,
    threads: int = 1,
    measured: tuple[Path, ...] = (),
    share: int | None = None,
    shares: int = 1,
    settings: CalibrateLights = CalibrateLights(),
) -> None:
    """Locate all lights from mirror balls and move the cameras into the stage's frame.

    Args:
        capture: folder of the capture.
        index: folder that index_capture wrote.
        rig: rig.json that calibrate_cameras wrote.
        out: folder to write lights.parquet, cameras.json, residuals_lights.parquet and verdicts_lights.csv to; with
            `share`, SHARE.parquet.
        threads: images measured at a time.
        measured: tables that were written with `share`, of all shares: no photograph is read again.
        share: measure only the photographs of every `shares`-th camera, from this one, and write a table of them.
        shares: number of shares.
        settings: see the flags below.
    """
    calibration = read_json(index / "calibration_lights.json")
    survey = read_table(index / "lights.parquet").sort_values("light", ignore_index=True)
    if share is not None:
        own = of_cameras(use_most_balls(calibration, settings.most_balls), share, shares)
        found = measure_balls(capture, own, survey.light, threads)
        write_measurements(out / f"{share:04d}.parquet", found)
        log.info("share %d of %d: %d outlines, %d spots", share, shares, len(found.outlines), len(found.spots))
        return
    cameras = read_cameras(rig)
    given = read_json(index / "calibration_cameras.json")
    in_stage = given["method"] == "known" and given.get("frame", "stage") == "stage"
    if calibration["method"] == "known":
        lights, verdicts = take_survey(capture, survey, in_stage)
        write(out, lights, cameras, pd.DataFrame(columns=RESIDUAL_COLUMNS), verdicts)
        return
    if calibration["method"] == "earlier":
        files = [capture / calibration[name] for name in ("lights", "cameras")]
        lights, cameras, verdicts = take_earlier(*files, cameras, survey, in_stage, settings.largest_camera_shift_m)
        write(out, lights, cameras, pd.DataFrame(columns=RESIDUAL_COLUMNS), verdicts)
        return
    calibration = use_most_balls(calibration, settings.most_balls)
    if measured:
        photographs = read_measurements(measured, calibration)
    else:
        photographs = measure_balls(capture, calibration, survey.light, threads)
    outlines, refused, spots = photographs.outlines, photographs.refused, photographs.spots
    if not outlines:
        found = f"none: {refusals(refused)}"
        raise InputError(f"{capture}: calibration.lights.silhouette: expected a dark ball in some image, found {found}")
    radius_m, ball_ratio = ball_radius(cameras, outlines, calibration["radius_m"], settings.largest_scale_error)
    seen = {p: sorted(camera for q, camera in outlines if q == p) for p in sorted({p for p, _ in outlines})}
    balls = {
        p: locate_ball([cameras[c] for c in names], [outlines[p, c] for c in names], radius_m)
        for p, names in seen.items()
    }
    photographed = pd.Series([e["light"] for e in calibration["images"] if (e["position"], e["camera"]) in outlines])
    facts, table = measure_lights(spots, balls, cameras, radius_m, list(survey.light), settings)
    facts.insert(0, "images", facts.index.map(photographed.value_counts()).fillna(0).astype(int))
    check_units(capture, facts, survey, ball_ratio, settings.largest_scale_error)
    facts["why"] = [why_not_measured(row, settings) for _, row in facts.iterrows()]
    if given["method"] == "features" and not given.get("distance"):
        facts, cameras = size_by_lights(facts, cameras, survey)
    well = facts[facts.why == ""]
    alignment = align(well, survey, capture)
    lights = place_in_stage(facts, survey, alignment, in_stage, settings)
    if in_stage:
        check_frame(capture, lights, settings)
    else:
        check_survey(capture, lights, well, survey, settings)
        cameras = {name: in_stage_frame(camera, alignment) for name, camera in cameras.items()}
    summarize(lights, table, alignment)
    verdicts = ball_verdicts(balls, seen, refused, settings) + light_verdicts(lights, settings)
    surveyed = survey.set_index("light").loc[well.index, ["x", "y", "z"]].to_numpy(np.float64)
    places = well[["x", "y", "z"]].to_numpy(np.float64)
    verdicts.append(survey_verdict(places, surveyed, alignment, in_stage, settings))
    write(out, lights, cameras, table, verdicts)


def ball_radius(
    cameras: Mapping[str, Camera], outlines: Outlines, declared_m: float, tolerance: float
) -> tuple[float, float]:
    """Radius of the balls in the rig's unit, and its ratio to the declared radius.

    The declared one counts where the two agree.
    """
    radius_m = radius_in_rig(cameras, outlines) or declared_m
    ratio = radius_m / declared_m
    return (declared_m if abs(np.log(ratio)) <= tolerance else radius_m), ratio


def in_stage_frame(camera: Camera, stage_from_rig: Alignment) -> Camera:
    """Move a camera of the rig into the stage's frame."""
    # x_cam = R_c x_rig + t_c and x_rig = R^T (x_stage - t).
    R = camera.R @ stage_from_rig.R.T
    return replace(camera, R=R, t=camera.t - R @ stage_from_rig.t)


def align(well: pd.DataFrame, survey: pd.DataFrame, capture: Path) -> Alignment:
    """Stage from rig, by the lights that are measured well."""
    surveyed = survey.set_index("light").loc[well.index, ["x", "y", "z"]].to_numpy(np.float64)
    try:
        return align_rigid(well[["x", "y", "z"]].to_numpy(np.float64), surveyed)
    except ValueError as error:
        raise InputError(f"{capture}: calibration.lights: {len(well)} lights are measured well: {error}") from error


def summarize(lights: pd.DataFrame, table: pd.DataFrame, alignment: Alignment) -> None:
    """Log how well it went in all."""
    rms = np.sqrt((table[["residual_x", "residual_y"]].to_numpy(np.float64) ** 2).sum(1).mean())
    measured = lights[lights.status == "measured"]
    sigma, away = 1000 * measured.sigma_m, 1000 * measured.away_m.median()
    log.info("%d highlights, RMS %.3f px", len(table), rms)
    log.info("%d lights measured, +-%.1f mm per axis (worst %.1f)", len(measured), sigma.median(), sigma.max())
    log.info("survey: +-%.1f mm per axis, %.1f mm from measured lights (median)", 1000 * alignment.sigma, away)


def write(
    out: Path, lights: pd.DataFrame, cameras: dict[str, Camera], residuals: pd.DataFrame, verdicts: list[Verdict]
) -> None:
    """All outputs of the stage."""
    log_verdicts(log, verdicts)
    write_table(out / "lights.parquet", lights[TABLE_COLUMNS])
    write_table(out / "residuals_lights.parquet", residuals[RESIDUAL_COLUMNS])
    write_table(out / "verdicts_lights.csv", verdict_table(verdicts))
    write_cameras(out / "cameras.json", cameras)


def main() -> None:
    """Command line of this stage."""
    run_as_command(run)


if __name__ == "__main__":
    main()
