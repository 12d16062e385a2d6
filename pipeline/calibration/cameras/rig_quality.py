"""Quality of each camera's calibration: numbers, and a verdict with its reason."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from jaxtyping import Float64, Int64

from pipeline.base.errors import listed
from pipeline.base.verdicts import Verdict
from pipeline.calibration.cameras.camera_calibration import QUALITY_COLUMNS
from pipeline.calibration.cameras.image_coverage import covered_share
from pipeline.calibration.cameras.rig import Rig
from pipeline.calibration.cameras.rig_calibration import Calibrated, Inspection, Movement, choose_distortion
from pipeline.calibration.cameras.rig_misfit import describe_movement, too_many_gross_outliers
from pipeline.config.calibrate_cameras import CalibrateCameras
from pipeline.geometry.cameras import PINHOLE_TERMS

PARALLEL_DEG = 20.0
"""Views turned less against each other are called parallel. It only words a reason (what decides is the focal length's
standard deviation), so it allows for what noise turns boards where the focal length is open: foreshortening of 0.5 %, a
corner's noise on a small board, is cos 6 degrees, either way and for two boards."""

DECISIVE = 5.0
"""Log odds from which on a lens is said to need more coefficients: very strong evidence (Kass and Raftery 1995)."""

OPEN_SHARE = 0.5
"""Standard deviation over its prior's, above which a term is said not to be determined."""


def quality_table(calibrated: Calibrated, names: Sequence[str], shot: Int64[np.ndarray, " views"]) -> pd.DataFrame:
    """Quality of every camera, one row each.

    Number of views and corners, reprojection error (root mean square length, px), standard deviations of the focal
    length (relative) and of the centre within the rig (m), share of the image's 8 x 8 cells with corners, largest
    angle between two boards (degrees), number of distortion coefficients.
    """
    rig, observations = calibrated.rig, calibrated.rig.model.observations
    rows = []
    for c, (name, camera) in enumerate(zip(names, rig.cameras, strict=True)):
        mine = observations.camera == c
        views = np.unique(observations.view[mine])
        rows.append((
            name, len(np.unique(shot[views])), int(mine.sum()), _rms(rig.residual[mine]), rig.focal_sigma[c],
            rig.center_sigma_m[c], covered_share(observations.pixel[mine], camera.width, camera.height),
            largest_turn(camera.R @ rig.rig_from_board[views, :3, :3]), calibrated.distortion[c],
        ))  # fmt: skip
    return pd.DataFrame(rows, columns=QUALITY_COLUMNS)


def largest_turn(cam_from_board_R: Float64[np.ndarray, "views 3 3"]) -> float:
    """Largest angle between two boards' normals, degrees: 0 where all views are parallel."""
    normals = cam_from_board_R[:, :, 2]
    return float(np.degrees(np.arccos(np.clip(normals @ normals.T, -1, 1)).max()))


def judge_cameras(
    quality: pd.DataFrame,
    calibrated: Calibrated,
    rough_shots: Mapping[str, Sequence[int]],
    inspection: Inspection,
    names: Sequence[str],
    settings: CalibrateCameras,
) -> list[Verdict]:
    """A verdict per camera; the reasons against it come first, then its numbers.

    Args:
        rough_shots: per camera, shots whose own reprojection error is above `good_rms_px`.
        names: what the numbers of cameras in `inspection` mean.
    """
    gross_outliers, verdicts = too_many_gross_outliers(inspection, quality.views.tolist()), []
    for c, row in enumerate(quality.itertuples()):
        failed, weak = _judge_fit(c, inspection.movements, gross_outliers, names, settings)
        wanted = wanted_distortion(calibrated, c)
        if wanted > row.distortion:
            weak.append(
                f"its views ask for {wanted} distortion coefficients, error bars are too small: distortion auto"
            )
        verdicts.append(_judge(row, rough_shots[row.camera], failed, weak, settings))
    return verdicts


def wanted_distortion(calibrated: Calibrated, camera: int) -> int:
    """Number of coefficients that a lens decisively needs.

    The one it has where it needs no other.
    """
    odds, used = calibrated.evidence[camera], calibrated.distortion[camera]
    if not odds:
        return used
    wanted = choose_distortion([odds])[0]
    return wanted if odds[wanted] - odds[used] > DECISIVE else used


def _judge_fit(
    camera: int,
    movements: Sequence[Movement],
    gross_outliers: Mapping[int, str],
    names: Sequence[str],
    limits: CalibrateCameras,
) -> tuple[list[str], list[str]]:
    failed, weak = [gross_outliers[camera]] if camera in gross_outliers else [], []
    for movement in movements:
        if camera in movement.suspects:
            told = describe_movement(movement, [names[suspect] for suspect in movement.suspects])
            (failed if movement.shift_px > limits.largest_shift_px else weak).append(told)
    return failed, weak


def _judge(row: tuple, rough: Sequence[int], failed: list[str], weak: list[str], limits: CalibrateCameras) -> Verdict:
    if row.focal_sigma > limits.largest_focal_error:
        failed.append(describe_focal(row.focal_sigma, row.tilt_deg))
    elif row.focal_sigma > limits.good_focal_error:
        weak.append(describe_focal(row.focal_sigma, row.tilt_deg))
    if row.views < limits.good_views:
        weak.append(f"few views: {limits.good_views} wanted")
    if row.coverage < limits.good_coverage:
        weak.append(f"corners in few parts of the image: {100 * limits.good_coverage:.0f} % wanted, show it the rest")
    if row.center_sigma_m > limits.good_center_m:
        weak.append(f"its centre is uncertain, {1000 * limits.good_center_m:g} mm wanted: share more views with others")
    if row.rms_px > limits.good_rms_px or rough:
        found = f"corners do not fit, {limits.good_rms_px:g} px wanted"
        weak.append(found + (f": see views {listed(rough)}" if rough else ""))
    numbers = (
        f"{row.views} views, {row.corners} corners in {100 * row.coverage:.0f} % of the image, "
        f"RMS {row.rms_px:.3f} px, "
        f"focal length +-{100 * row.focal_sigma:.3f} %, centre +-{1000 * row.center_sigma_m:.2f} mm, "
        f"distortion coefficients: {row.distortion}"
    )
    grade = "failed" if failed else "weak" if weak else "good"
    return Verdict("camera", row.camera, grade, "; ".join([*failed, *weak, numbers]))


def describe_focal(focal_sigma: float, tilt_deg: float) -> str:
    """That a focal length is uncertain, and why."""
    if tilt_deg < PARALLEL_DEG:
        return f"all its views of the board are parallel (within {tilt_deg:.0f} degrees): tilt it by 30 and more"
    return "its focal length is uncertain: show it the board tilted by 30 degrees and more, and at several distances"


def open_terms(rig: Rig) -> list[list[str]]:
    """Intrinsics of each camera that its views hardly determine.

    Half of what was open before, or more, is still open.
    """
    names = np.array([*PINHOLE_TERMS, *rig.model.lens.terms])
    _, prior = rig.model.priors()
    found = []
    for camera, covariance in enumerate(rig.intrinsics_covariance):
        sigma = prior[rig.model.intrinsics_columns(int(rig.model.lens_index[camera]))]
        found.append(names[np.sqrt(np.diag(covariance)) > OPEN_SHARE * sigma].tolist())
    return found


def rough_shots(
    rig: Rig, names: Sequence[str], shot: Int64[np.ndarray, " views"], good_rms_px: float
) -> dict[str, list[int]]:
    """Per camera, the shots whose own reprojection error is larger."""
    observations = rig.model.observations
    when, rough = shot[observations.view], {}
    for c, name in enumerate(names):
        mine = observations.camera == c
        shots = np.unique(when[mine])
        rough[name] = [int(s) for s in shots if _rms(rig.residual[mine & (when == s)]) > good_rms_px]
    return rough


def _rms(residual: np.ndarray) -> float:
    return float(np.sqrt((residual**2).sum(1).mean()))
