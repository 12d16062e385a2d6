"""Images of mirror balls -> positions of all lights, and the cameras moved into the stage's frame.

Each ball is located by its outlines in all cameras that see it, each light by its highlights in all balls (see
pipeline.geometry.mirror_lights). The measured lights, in the rig's frame, are then laid over the surveyed ones
without scaling: the survey is good to centimetres only, but it says where the stage is. Lights that are measured too
poorly keep their surveyed position. With `method: known` the surveyed positions are taken as they are; the cameras,
which are then known too, stay where they are.
"""

from __future__ import annotations

import logging
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.command import run_as_command
from pipeline.base.errors import InputError
from pipeline.base.files import read_json, read_table, write_table
from pipeline.base.progress import progress
from pipeline.capture.gray import read_gray
from pipeline.config.calibrate_lights import CalibrateLights
from pipeline.geometry.alignment import Alignment, align_rigid
from pipeline.geometry.ball_images import measure_highlight, measure_outline
from pipeline.geometry.cameras import Camera, read_cameras, write_cameras
from pipeline.geometry.least_squares import Solution
from pipeline.geometry.mirror_ball import locate_ball
from pipeline.geometry.mirror_lights import Highlights, locate_lights

log = logging.getLogger("calibrate_lights")

RESIDUAL_COLUMNS = ["light", "position", "camera", "x", "y", "residual_x", "residual_y", "weight"]


def run(
    *, capture: Path, index: Path, rig: Path, out: Path, threads: int = 1, settings: CalibrateLights = CalibrateLights()
) -> None:
    """Locate all lights from mirror balls and move the cameras into the stage's frame.

    Args:
        capture: folder of the capture.
        index: folder that index_capture wrote.
        rig: rig.json that calibrate_cameras wrote.
        out: folder to write lights.parquet, cameras.json and residuals_lights.parquet to.
        threads: images measured at a time.
    """
    cameras = read_cameras(rig)
    calibration = read_json(index / "calibration_lights.json")
    survey = read_table(index / "lights.parquet").sort_values("light", ignore_index=True)
    cameras_known = read_json(index / "calibration_cameras.json")["method"] == "known"
    if calibration["method"] == "known":
        if not cameras_known:
            mend = "known lights do not show in images and cannot place cameras that a board calibrated"
            raise InputError(f"{capture}: calibration.cameras: expected method known, found charuco; {mend}")
        write_table(out / "lights.parquet", survey[["light", "x", "y", "z"]].assign(sigma_m=0.0, status="surveyed"))
        write_cameras(out / "cameras.json", cameras)
        write_table(out / "residuals_lights.parquet", pd.DataFrame(columns=RESIDUAL_COLUMNS))
        return
    balls, outlines = find_balls(capture, calibration, cameras)
    table = find_highlights(capture, calibration, outlines, set(survey.light), threads)
    counts = table.light.value_counts()
    enough = sorted(counts.index[counts >= settings.least_highlights])
    log.info("%d of %d lights have %d highlights or more", len(enough), len(survey), settings.least_highlights)
    if not enough:
        raise InputError(f"{capture}: calibration.lights: expected highlights in the balls, found none for any light")
    table = table[table.light.isin(enough)].reset_index(drop=True)
    solution = locate(table, enough, balls, cameras, calibration["radius_m"])
    table[["residual_x", "residual_y"]], table["weight"] = solution.residual, solution.weight
    positions = pd.DataFrame(solution.parameters.reshape(-1, 3), index=enough, columns=["x", "y", "z"])
    positions["sigma_m"] = np.sqrt(np.diag(solution.covariance).reshape(-1, 3).mean(1))
    good = positions[positions.sigma_m <= settings.largest_sigma_m]
    alignment = align(good, survey, capture)
    lights = merge(good, survey, alignment, in_stage=cameras_known)
    report(lights, survey, counts, solution, alignment, settings)
    if not cameras_known:
        R, t = alignment.R, alignment.t
        # x_cam = R_c x_rig + t_c and x_rig = R^T (x_stage - t).
        cameras = {name: replace(c, R=c.R @ R.T, t=c.t - c.R @ R.T @ t) for name, c in cameras.items()}
    write_table(out / "lights.parquet", lights)
    write_table(out / "residuals_lights.parquet", table[RESIDUAL_COLUMNS])
    write_cameras(out / "cameras.json", cameras)


def find_balls(
    capture: Path, calibration: dict, cameras: dict[str, Camera]
) -> tuple[dict[str, np.ndarray], dict[tuple[str, str], np.ndarray]]:
    """Centre of the ball at each position, and its outline per (position, camera)."""
    outlines = {}
    for entry in calibration["silhouettes"]:
        outline = measure_outline(read_gray(capture / entry["path"]))
        if outline is None:
            log.warning("%s: no whole ball, dark before a bright backdrop: left out", entry["path"])
        else:
            outlines[entry["position"], entry["camera"]] = outline
    balls = {}
    for position in sorted({position for position, _ in outlines}):
        seen = {camera: outline for (p, camera), outline in outlines.items() if p == position}
        ball = locate_ball([cameras[name] for name in seen], list(seen.values()), calibration["radius_m"])
        sigma_mm = 1000 * np.sqrt(np.trace(ball.covariance) / 3)
        text = "ball %s: outlines in %d cameras, RMS %.3f px, centre +-%.2f mm"
        log.info(text, position, len(seen), ball.rms_px, sigma_mm)
        balls[position] = ball.center
    if not balls:
        raise InputError(f"{capture}: calibration.lights.silhouette: expected a dark ball in some image, found none")
    return balls, outlines


def find_highlights(
    capture: Path, calibration: dict, outlines: dict[tuple[str, str], np.ndarray], lights: set[str], threads: int
) -> pd.DataFrame:
    """Columns light, position, camera, x, y: one row per image in which something shines."""
    entries = [e for e in calibration["images"] if (e["position"], e["camera"]) in outlines and e["light"] in lights]

    def measure(entry: dict) -> np.ndarray | None:
        return measure_highlight(read_gray(capture / entry["path"]), outlines[entry["position"], entry["camera"]])

    with ThreadPoolExecutor(threads) as pool:
        found = list(progress(pool.map(measure, entries), "mirror ball images", len(entries)))
    rows = [
        (entry["light"], entry["position"], entry["camera"], *pixel)
        for entry, pixel in zip(entries, found, strict=True)
        if pixel is not None
    ]
    return pd.DataFrame(rows, columns=RESIDUAL_COLUMNS[:5])


def locate(
    table: pd.DataFrame, lights: list[str], balls: dict[str, np.ndarray], cameras: dict[str, Camera], radius_m: float
) -> Solution:
    """Positions of `lights` in the cameras' frame, three parameters each."""
    positions, names = sorted(balls), sorted(set(table.camera))
    highlights = Highlights(
        table.light.map(lights.index).to_numpy(np.int64),
        table.position.map(positions.index).to_numpy(np.int64),
        table.camera.map(names.index).to_numpy(np.int64),
        table[["x", "y"]].to_numpy(np.float64),
    )
    centers = np.stack([balls[position] for position in positions])
    return locate_lights(highlights, centers, [cameras[name] for name in names], radius_m, len(lights))


def align(measured: pd.DataFrame, survey: pd.DataFrame, capture: Path) -> Alignment:
    """Stage from rig, by the lights that are measured well."""
    surveyed = survey.set_index("light").loc[measured.index, ["x", "y", "z"]].to_numpy(np.float64)
    try:
        return align_rigid(measured[["x", "y", "z"]].to_numpy(np.float64), surveyed)
    except ValueError as error:
        raise InputError(f"{capture}: calibration.lights: {len(measured)} lights are measured well: {error}") from error


def merge(measured: pd.DataFrame, survey: pd.DataFrame, alignment: Alignment, in_stage: bool) -> pd.DataFrame:
    """All lights in the stage's frame: light, x, y, z, sigma_m (per axis), status."""
    lights = survey[["light", "x", "y", "z"]].assign(sigma_m=alignment.sigma, status="surveyed").set_index("light")
    points = measured[["x", "y", "z"]].to_numpy(np.float64)
    lights.loc[measured.index, ["x", "y", "z"]] = points if in_stage else alignment.apply(points)
    lights.loc[measured.index, "sigma_m"] = measured.sigma_m
    lights.loc[measured.index, "status"] = "measured"
    return lights.reset_index()


def report(
    lights: pd.DataFrame, survey: pd.DataFrame, counts: pd.Series, solution: Solution, alignment: Alignment,
    settings: CalibrateLights,
) -> None:  # fmt: skip
    """Log how well it went, and every light that is not as it should be."""
    away = np.linalg.norm(lights[["x", "y", "z"]].to_numpy() - survey[["x", "y", "z"]].to_numpy(), axis=1)
    rms = np.sqrt((solution.residual**2).sum(1).mean())
    log.info("highlights: %d, RMS %.3f px, noise %.3f px", len(solution.residual), rms, solution.sigma)
    for light, distance in zip(lights.itertuples(), away, strict=True):
        if light.status == "surveyed":
            log.warning("%s: %d highlights: keeps its surveyed position", light.light, counts.get(light.light, 0))
        elif distance > settings.suspicious_distance_m:
            log.warning("%s: measured %.2f m from its surveyed position: are names swapped?", light.light, distance)
    measured = lights.status == "measured"
    sigma = 1000 * lights.sigma_m[measured]
    log.info("%d lights measured, +-%.1f mm per axis (worst %.1f)", measured.sum(), sigma.median(), sigma.max())
    text = "survey: +-%.1f mm per axis, %.1f mm from the measured lights (median)"
    log.info(text, 1000 * alignment.sigma, 1000 * np.median(away[measured]))


def main() -> None:
    """Command line of this stage."""
    run_as_command(run)


if __name__ == "__main__":
    main()
