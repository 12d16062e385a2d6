"""Calibrate intrinsics, distortion and poses of all cameras from images of boards.

They are metric, in the rig's own frame.

Corners are detected in every image, each camera is calibrated alone (Zhang 2000), cameras are joined through the views
they share, and one bundle adjustment over everything refines the result. Each camera is then judged, and one that moved
between views is named. The rig's frame is that of the first board view; calibrate_lights moves it into the stage's.
Given lenses may stay or be refined; images that were not taken at once may have times. With `method: features` the
subject's own points stand in for the boards; with `method: known` the given cameras are validated and copied.

Of many images, those of some cameras are searched by a job of its own each; the cameras that are then calibrated by
the tables of these jobs are the same.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pipeline.base.command import run_as_command
from pipeline.base.errors import Complaints, listed
from pipeline.base.files import read_json, read_table, write_table
from pipeline.base.verdicts import Verdict, log_verdicts, verdict_table
from pipeline.calibration.cameras.board_search import check_search, find_boards, search_images
from pipeline.calibration.cameras.board_tables import places_of_cameras, read_searches, write_search
from pipeline.calibration.cameras.board_views import BoardViews, choose_shots, explain_nothing, gather_views
from pipeline.calibration.cameras.boards import Board
from pipeline.calibration.cameras.declared_boards import (
    boards_from_index,
    complain_of_symmetry,
    known_beforehand,
    lens_for,
    times_from_index,
)
from pipeline.calibration.cameras.rig import Rig
from pipeline.calibration.cameras.rig_calibration import Calibrated, calibrate_rig, inspect_rig
from pipeline.calibration.cameras.rig_misfit import complain_of_misfits
from pipeline.calibration.cameras.rig_quality import (
    COLUMNS,
    describe_focal,
    judge_cameras,
    open_terms,
    quality_table,
    rough_shots,
)
from pipeline.calibration.cameras.rig_spread import with_spread
from pipeline.calibration.cameras.rig_start import connected_groups
from pipeline.capture.cameras.known_cameras import read_known_cameras
from pipeline.capture.schema.camera_schema import KnownCameras
from pipeline.config.calibrate_cameras import CalibrateCameras
from pipeline.geometry.cameras import Camera, write_cameras

log = logging.getLogger("calibrate_cameras")

RESIDUAL_COLUMNS = ["camera", "view", "board", "corner", "x", "y", "residual_x", "residual_y", "weight"]


def run(
    *,
    capture: Path,
    index: Path,
    out: Path,
    threads: int = 1,
    found: tuple[Path, ...] = (),
    share: int | None = None,
    shares: int = 1,
    settings: CalibrateCameras = CalibrateCameras(),
) -> None:
    """Calibrate all cameras of a rig together from images of boards.

    Args:
        capture: folder of the capture.
        index: folder that index_capture wrote.
        out: folder to write rig.json, residuals_cameras.parquet, quality_cameras.parquet and verdicts_cameras.csv to;
            with `share`, SHARE.parquet.
        threads: images searched at a time.
        found: tables that were written with `share`, of all shares: no board is looked for again.
        share: look for boards only in the images of every `shares`-th camera, from this one, and write a table of them.
        shares: number of shares.
        settings: see the flags below.
    """
    calibration = read_json(index / "calibration_cameras.json")
    table = read_table(index / "cameras.parquet").sort_values("camera")
    sizes = {row.camera: (int(row.sensor_width), int(row.sensor_height)) for row in table.itertuples()}
    if calibration["method"] == "known":
        cameras = known_cameras(capture, calibration, sizes)
        verdicts = [Verdict("camera", name, "good", "given, not calibrated here") for name in cameras]
        log_verdicts(log, verdicts)
        none = pd.DataFrame(columns=RESIDUAL_COLUMNS, dtype="float64").astype({"camera": "str"})
        write(out, cameras, none, pd.DataFrame(columns=COLUMNS, dtype="float64").astype({"camera": "str"}), verdicts)
        return
    if calibration["method"] == "features":
        # Imports pycolmap, which loads all of COLMAP.
        from pipeline.calibration.cameras.feature_calibration import calibrate_from_features

        done = calibrate_from_features(capture, calibration, sizes, settings, threads)
        log_verdicts(log, done.verdicts)
        refuse_failed(capture, done.verdicts)
        write(out, done.cameras, done.residuals, done.quality, done.verdicts)
        return
    boards, names = boards_from_index(calibration), list(sizes)
    complain_of_symmetry(capture, boards, len(names))
    lens = lens_for(calibration, settings)
    views = choose_shots(calibration["views"], settings.most_views)
    if share is not None:
        searched = search_images(capture, views, places_of_cameras(views, share, shares), boards, threads)
        write_search(out / f"{share:04d}.parquet", searched, boards)
        log.info("share %d of %d: boards looked for in %d images", share, shares, len(searched.images))
        return
    if found:
        printed = check_search(capture, views, sizes, boards, read_searches(found, boards, len(views)))
    else:
        printed = find_boards(capture, views, sizes, boards, threads)
    detections, boards = printed.detections, printed.boards
    seen = gather_views(detections, views, names, boards)
    complaints = Complaints(capture)

    def explain(camera: str) -> str:
        mine = [k for k, view in enumerate(views) if view["camera"] == camera]
        if not mine or any(len(detection.ids) for k in mine for detection in detections[k]):
            return ""
        return explain_nothing(capture, [views[k] for k in mine], boards, [detections[k] for k in mine])

    failed, group = choose_cameras(seen, names, settings.least_views, explain, complaints)
    if not group:
        log_verdicts(log, failed)
        complaints.raise_if_any()
    chosen, held = seen.for_cameras(group), [names[c] for c in group]
    held_sizes = [sizes[name] for name in held]
    known = known_beforehand(capture, calibration, {name: sizes[name] for name in held}, settings)
    if (times := times_from_index(calibration)) is not None:
        taken = {(c, int(v)): times[name, v] for c, name in enumerate(held) for v in chosen.shots_for(c)}
        chosen = chosen.moving(taken)
    calibrated = calibrate_rig(chosen.observations, chosen.corners_m, held_sizes, settings.distortion, lens, known)
    if times is not None:
        calibrated = with_spread(calibrated, chosen)
        report_times(calibrated.rig, held)
    report_distortion(calibrated, held)
    for name, terms in zip(held, open_terms(calibrated.rig), strict=True):
        if terms:
            log.info("camera %s: not determined by its views, left at what is usual or given: %s", name, listed(terms))
    quality, judged = judge(calibrated, chosen, held, held_sizes, settings, complaints)
    verdicts = sorted([*failed, *judged], key=lambda verdict: names.index(verdict.name))
    log_verdicts(log, verdicts)
    rig, squared = calibrated.rig, (calibrated.rig.residual**2).sum(1)
    log.info("all: %d corners, RMS %.3f px, noise %.3f px", len(squared), np.sqrt(squared.mean()), rig.sigma_px)
    complaints.raise_if_any()
    cameras = dict(zip(held, rig.cameras, strict=True))
    write(out, cameras, residual_table(rig, chosen, held, boards), quality, verdicts)


def refuse_failed(capture: Path, verdicts: Sequence[Verdict]) -> None:
    """Refuse cameras that failed.

    Raises:
        InputError: naming them.
    """
    complaints = Complaints(capture)
    for verdict in verdicts:
        if verdict.grade == "failed":
            expected = "a focal length known to calibrate_cameras.largest_focal_error"
            complaints.add("calibration.cameras", f"camera {verdict.name}", expected=expected, found=verdict.reason)
    complaints.raise_if_any()


def write(
    out: Path, cameras: dict[str, Camera], residuals: pd.DataFrame, quality: pd.DataFrame, verdicts: Sequence[Verdict]
) -> None:
    """Write all that this stage writes."""
    write_cameras(out / "rig.json", cameras)
    write_table(out / "residuals_cameras.parquet", residuals)
    write_table(out / "quality_cameras.parquet", quality)
    write_table(out / "verdicts_cameras.csv", verdict_table(verdicts))


def known_cameras(capture: Path, calibration: dict[str, Any], sizes: dict[str, tuple[int, int]]) -> dict[str, Camera]:
    """Given cameras, those of the index only, in metres.

    Raises:
        InputError: naming cameras that are not there or cannot be right.
    """
    section = KnownCameras.model_validate({key: value for key, value in calibration.items() if key != "digest"})
    complaints = Complaints(capture)
    cameras = read_known_cameras(capture, section, sizes, complaints)
    complaints.raise_if_any()
    return cameras


def report_times(rig: Rig, names: Sequence[str]) -> None:
    """Log how far from simultaneous the images of a view are."""
    lags = rig.parameters[rig.model.lag_columns]
    for name, lag in zip(names, lags - lags.mean(), strict=False):
        log.info("camera %s: its images are %+.0f ms late, by their times and the board's motion", name, 1000 * lag)
    log.info("all: single images are off by %.0f ms from that, standard deviation", 1000 * rig.clock_sigma_s)


def choose_cameras(
    found: BoardViews, names: Sequence[str], least_views: int, explain: Callable[[str], str], complaints: Complaints
) -> tuple[list[Verdict], list[int]]:
    """Largest group of cameras that can be calibrated together.

    Those outside it get a verdict and a complaint.

    Args:
        explain: why a camera sees no board at all.
    """
    counts, failed = [len(found.shots_for(c)) for c in range(len(names))], []
    enough = [c for c, count in enumerate(counts) if count >= least_views]
    for c in set(range(len(names))) - set(enough):
        hint = "; ".join(filter(None, [explain(names[c]), "record more, or remove the camera"]))
        expected = f"the board in at least {least_views} views"
        complaints.add("calibration.cameras", f"camera {names[c]}", expected=expected, found=f"{counts[c]}", hint=hint)
        failed.append(Verdict("camera", names[c], "failed", f"{counts[c]} views of {least_views} needed; {hint}"))
    if not enough:
        return failed, []
    groups = connected_groups(found.for_cameras(enough).observations, len(enough))
    groups = [[enough[c] for c in group] for group in groups]
    if len(groups) > 1:
        told = "; ".join(f"({', '.join(names[c] for c in group)})" for group in groups)
        hint = "record views in which cameras of different groups see the board at once"
        expected = "cameras joined by shared views"
        complaints.add("calibration.cameras", "views", expected=expected, found=told, hint=hint)
        reason = f"shares no view with ({', '.join(names[c] for c in groups[0])}); {hint}"
        failed += [Verdict("camera", names[c], "failed", reason) for group in groups[1:] for c in group]
    return failed, groups[0]


def judge(
    calibrated: Calibrated,
    found: BoardViews,
    names: Sequence[str],
    sizes: Sequence[tuple[int, int]],
    settings: CalibrateCameras,
    complaints: Complaints,
) -> tuple[pd.DataFrame, list[Verdict]]:
    """The table of quality and the verdicts; complaints on what must not be used."""
    rig, where = calibrated.rig, "calibration.cameras"
    if found.observations.motion is not None:
        # Times that are only estimated leave errors which follow the board's motion, and so time: nobody is refused.
        settings = settings.model_copy(update={"largest_shift_px": math.inf})
    quality = quality_table(calibrated, names, found.shot)
    inspection = inspect_rig(calibrated, found.corners_m, sizes, found.shot)
    complain_of_misfits(inspection, names, quality.views.tolist(), settings.largest_shift_px, where, complaints)
    for row in quality.itertuples():
        if row.focal_sigma > settings.largest_focal_error:
            expected = f"a focal length known to {100 * settings.largest_focal_error:g} %"
            told, hint = f"{100 * row.focal_sigma:.1f} %", describe_focal(row.focal_sigma, row.tilt_deg)
            complaints.add(where, f"camera {row.camera}", expected=expected, found=told, hint=hint)
    observations = rig.model.observations
    centers = np.stack([camera.center for camera in rig.cameras])[observations.camera]
    farthest = np.linalg.norm(centers - rig.rig_from_board[observations.view, :3, 3], axis=1).max()
    # A focal length that is open takes the distance along with it.
    if farthest > settings.largest_rig_m and quality.focal_sigma.max() <= settings.largest_focal_error:
        expected = f"cameras within {settings.largest_rig_m:g} m of the boards"
        hint = "are square_m and marker_m in metres?"
        complaints.add(where, "square_m", expected=expected, found=f"{farthest:.0f} m", hint=hint)
    rough = rough_shots(rig, names, found.shot, settings.good_rms_px)
    return quality, judge_cameras(quality, calibrated, rough, inspection, names, settings)


def report_distortion(calibrated: Calibrated, names: Sequence[str]) -> None:
    """Log what was chosen, and by which odds."""
    for name, number, odds in zip(names, calibrated.distortion, calibrated.evidence, strict=True):
        if not odds:  # given lenses have the coefficients that they have
            continue
        told = ", ".join(f"{k}: {value:.1f}" for k, value in odds.items())
        log.info("camera %s: %d distortion coefficients; log odds against all: %s", name, number, told)


def residual_table(rig: Rig, found: BoardViews, names: Sequence[str], boards: Sequence[Board]) -> pd.DataFrame:
    """Table of residuals, one row per corner.

    Columns camera, view, board, corner (of that board), x, y, residual_x, residual_y (projected minus observed),
    weight.
    """
    observations = found.observations
    first = np.cumsum([0, *(len(board.corners_m()) for board in boards)])
    board = found.board[observations.view]
    values = [
        np.array(names)[observations.camera], found.shot[observations.view], board, observations.corner - first[board],
        *observations.pixel.T, *rig.residual.T, rig.weight,
    ]  # fmt: skip
    return pd.DataFrame(dict(zip(RESIDUAL_COLUMNS, values, strict=True)))


def main() -> None:
    """Command line of this stage."""
    run_as_command(run)


if __name__ == "__main__":
    main()
