"""Calibration of cameras from images of boards: from detected corners to a judged rig."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pipeline.base.errors import Complaints, listed
from pipeline.base.verdicts import Verdict
from pipeline.calibration.cameras.board_search import BoardSearch, check_search, find_boards
from pipeline.calibration.cameras.board_tables import read_searches
from pipeline.calibration.cameras.board_views import BoardViews, explain_nothing, gather_views
from pipeline.calibration.cameras.boards import Board
from pipeline.calibration.cameras.camera_calibration import RESIDUAL_COLUMNS, CameraCalibration
from pipeline.calibration.cameras.declared_boards import (
    boards_from_index,
    complain_of_symmetry,
    known_beforehand,
    lens_for,
    times_from_index,
    views_to_search,
)
from pipeline.calibration.cameras.relative_poses import pair_table
from pipeline.calibration.cameras.rig import Rig
from pipeline.calibration.cameras.rig_calibration import Calibrated, calibrate_rig, inspect_rig
from pipeline.calibration.cameras.rig_misfit import complain_of_misfits
from pipeline.calibration.cameras.rig_quality import (
    describe_focal,
    judge_cameras,
    open_terms,
    quality_table,
    rough_shots,
)
from pipeline.calibration.cameras.rig_spread import with_spread
from pipeline.calibration.cameras.rig_start import connected_groups
from pipeline.config.calibrate_cameras import CalibrateCameras

log = logging.getLogger("calibrate_cameras")

Sizes = Mapping[str, tuple[int, int]]
WHERE = "calibration.cameras"
"""Section of capture.yaml that complaints name."""


def calibrate_from_boards(
    capture: Path, calibration: Mapping[str, Any], sizes: Sizes, settings: CalibrateCameras, threads: int,
    found: Sequence[Path],
) -> CameraCalibration:  # fmt: skip
    """Calibrate the cameras of calibration_cameras.json, of a method that has boards.

    Args:
        sizes: width and height of each sensor, pixels.
        found: tables of `search_share`, of all shares; none: boards are looked for here.

    Raises:
        InputError: if boards cannot be told apart or are in no image, or of images of another size.
    """
    boards, names = boards_from_index(calibration), list(sizes)
    complain_of_symmetry(capture, boards, len(names))
    lens, times = lens_for(calibration, settings), times_from_index(calibration)
    views = views_to_search(calibration, settings)
    if found:
        printed = read_searches(found, boards, len(views))
        check_search(capture, views, sizes, boards, printed)
    else:
        printed = find_boards(capture, views, sizes, boards, threads)
    boards = printed.boards
    seen = gather_views(printed.detections, views, names, boards)
    complaints = Complaints(capture)
    failed, group = choose_cameras(
        seen, names, settings.least_views, lambda name: explain_camera(capture, name, views, printed), complaints
    )
    if not group:
        return CameraCalibration({}, pd.DataFrame(), pd.DataFrame(), pd.DataFrame(), failed, complaints)
    chosen, held = seen.for_cameras(group), [names[c] for c in group]
    held_sizes = [sizes[name] for name in held]
    known = known_beforehand(capture, calibration, dict(zip(held, held_sizes, strict=True)), settings)
    if times is not None:
        taken = {(c, int(v)): times[name, v] for c, name in enumerate(held) for v in chosen.shots_for(c)}
        chosen = chosen.moving(taken).resting(settings.most_views)
    calibrated = calibrate_rig(chosen.observations, chosen.corners_m, held_sizes, settings.distortion, lens, known)
    calibrated = with_spread(calibrated, chosen.shot)
    rig, squared = calibrated.rig, (calibrated.rig.residual**2).sum(1)
    report(calibrated, held)
    quality, judged = judge(calibrated, chosen, held, held_sizes, settings, complaints)
    log.info("all: %d corners, RMS %.3f px, noise %.3f px", len(squared), np.sqrt(squared.mean()), rig.sigma_px)
    verdicts = sorted([*failed, *judged], key=lambda verdict: names.index(verdict.name))
    cameras = dict(zip(held, rig.cameras, strict=True))
    pairs = pair_table(cameras, rig.pose_covariances)
    return CameraCalibration(cameras, residual_table(rig, chosen, held, boards), quality, pairs, verdicts, complaints)


def explain_camera(capture: Path, camera: str, views: Sequence[dict], searched: BoardSearch) -> str:
    """Explain why a camera sees no board at all; empty for one that sees a corner."""
    mine, detections = [k for k, view in enumerate(views) if view["camera"] == camera], searched.detections
    if not mine or any(len(detection.ids) for k in mine for detection in detections[k]):
        return ""
    return explain_nothing(capture, [views[k] for k in mine], searched.boards, [detections[k] for k in mine])


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
        complaints.add(WHERE, f"camera {names[c]}", expected=expected, found=f"{counts[c]}", hint=hint)
        failed.append(Verdict("camera", names[c], "failed", f"{counts[c]} views of {least_views} needed; {hint}"))
    if not enough:
        return failed, []
    groups = connected_groups(found.for_cameras(enough).observations, len(enough))
    groups = [[enough[c] for c in group] for group in groups]
    if len(groups) > 1:
        told = "; ".join(f"({', '.join(names[c] for c in group)})" for group in groups)
        hint = "record views in which cameras of different groups see the board at once"
        complaints.add(WHERE, "views", expected="cameras joined by shared views", found=told, hint=hint)
        reason = f"shares no view with ({', '.join(names[c] for c in groups[0])}); {hint}"
        failed += [Verdict("camera", names[c], "failed", reason) for group in groups[1:] for c in group]
    return failed, groups[0]


def judge(
    calibrated: Calibrated, found: BoardViews, names: Sequence[str], sizes: Sequence[tuple[int, int]],
    settings: CalibrateCameras, complaints: Complaints,
) -> tuple[pd.DataFrame, list[Verdict]]:  # fmt: skip
    """The table of quality and the verdicts; complaints on what must not be used."""
    rig = calibrated.rig
    if found.observations.motion is not None:
        # Times that are only estimated leave errors which follow the board's motion, and so time: nobody is refused.
        settings = settings.model_copy(update={"largest_shift_px": math.inf})
    quality = quality_table(calibrated, names, found.shot)
    inspection = inspect_rig(calibrated, found.corners_m, sizes, found.shot)
    complain_of_misfits(inspection, names, quality.views.tolist(), settings.largest_shift_px, WHERE, complaints)
    for row in quality.itertuples():
        if row.focal_sigma > settings.largest_focal_error:
            expected = f"a focal length known to {100 * settings.largest_focal_error:g} %"
            told, hint = f"{100 * row.focal_sigma:.1f} %", describe_focal(row.focal_sigma, row.tilt_deg)
            complaints.add(WHERE, f"camera {row.camera}", expected=expected, found=told, hint=hint)
    observations = rig.model.observations
    centers = np.stack([camera.center for camera in rig.cameras])[observations.camera]
    farthest = np.linalg.norm(centers - rig.rig_from_board[observations.view, :3, 3], axis=1).max()
    # A focal length that is open takes the distance along with it.
    if farthest > settings.largest_rig_m and quality.focal_sigma.max() <= settings.largest_focal_error:
        expected = f"cameras within {settings.largest_rig_m:g} m of the boards"
        hint = "are square_m and marker_m in metres?"
        complaints.add(WHERE, "square_m", expected=expected, found=f"{farthest:.0f} m", hint=hint)
    rough = rough_shots(rig, names, found.shot, settings.good_rms_px)
    return quality, judge_cameras(quality, calibrated, rough, inspection, names, settings)


def report(calibrated: Calibrated, names: Sequence[str]) -> None:
    """Log how late images are, which lenses were chosen by which odds, and what stays open."""
    rig = calibrated.rig
    lags = rig.parameters[rig.model.lag_columns]
    for name, lag in zip(names, lags - lags.mean() if len(lags) else lags, strict=False):
        log.info("camera %s: its images are %+.0f ms late, by their times and the board's motion", name, 1000 * lag)
    if len(lags):
        log.info("all: single images are off by %.0f ms from that, standard deviation", 1000 * rig.clock_sigma_s)
    for name, number, odds in zip(names, calibrated.distortion, calibrated.evidence, strict=True):
        if odds:  # Given lenses have the coefficients that they have.
            told = ", ".join(f"{k}: {value:.1f}" for k, value in odds.items())
            log.info("camera %s: %d distortion coefficients; log odds against all: %s", name, number, told)
    for name, terms in zip(names, open_terms(rig), strict=True):
        if terms:
            log.info("camera %s: not determined by its views, left at what is usual or given: %s", name, listed(terms))


def residual_table(rig: Rig, found: BoardViews, names: Sequence[str], boards: Sequence[Board]) -> pd.DataFrame:
    """Table of residuals, one row per corner, which is counted on its board."""
    observations = found.observations
    first = np.cumsum([0, *(len(board.corners_m()) for board in boards)])
    board = found.board[observations.view]
    values = [
        np.array(names)[observations.camera], found.shot[observations.view], board, observations.corner - first[board],
        *observations.pixel.T, *rig.residual.T, rig.weight,
    ]  # fmt: skip
    return pd.DataFrame(dict(zip(RESIDUAL_COLUMNS, values, strict=True)))
