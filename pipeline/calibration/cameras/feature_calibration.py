"""Calibration of cameras from the subject's own features.

From images to poses, the rig's size, and a verdict on each camera.
"""

from __future__ import annotations

import logging
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pycolmap

from pipeline.base.errors import Complaints, InputError
from pipeline.base.spread import evenly
from pipeline.base.verdicts import Verdict
from pipeline.calibration.cameras.camera_calibration import (
    QUALITY_COLUMNS,
    RESIDUAL_COLUMNS,
    CameraCalibration,
)
from pipeline.calibration.cameras.declared_boards import known_beforehand
from pipeline.calibration.cameras.feature_matches import Key, count_matches, join_moments, write_features
from pipeline.calibration.cameras.feature_rig import FeatureRig, map_rig
from pipeline.calibration.cameras.image_coverage import covered_share
from pipeline.calibration.cameras.relative_poses import pair_table
from pipeline.calibration.cameras.rig_inputs import RigPriors
from pipeline.calibration.cameras.unplaced_cameras import complain_of_unplaced
from pipeline.calibration.lights.ball_photos import find_outlines
from pipeline.calibration.lights.length_units import radius_in_rig
from pipeline.capture.cameras.colmap_cameras import colmap_lens
from pipeline.capture.images import ImageSource
from pipeline.config.calibrate_cameras import CalibrateCameras
from pipeline.geometry.cameras import Camera

log = logging.getLogger("calibrate_cameras")

USUAL_FOCAL = 1.2
"""Focal length that a lens starts with, over its image's longer side: COLMAP's own, a field of view of 45 degrees."""

Sizes = Mapping[str, tuple[int, int]]


def calibrate_from_features(
    capture: Path, calibration: dict[str, Any], sizes: Sizes, settings: CalibrateCameras, threads: int
) -> CameraCalibration:
    """Calibrate the cameras of calibration_cameras.json, method features.

    Args:
        sizes: width and height of each sensor, pixels.

    Raises:
        InputError: naming cameras that share too little with the others, or if nothing gives the rig its size.
    """
    factor = float(calibration["images"]["downsample_from_sensor"])
    outlines = _outlines(capture, calibration)
    known = known_beforehand(capture, calibration, dict(sizes), settings)
    frames = evenly(sorted({view["view"] for view in calibration["views"]}), settings.feature_moments)
    views = [view for view in calibration["views"] if view["view"] in frames]
    log.info("features of %d images of %d moments", len(views), len(frames))
    source = ImageSource.from_index(capture, calibration["images"])
    with tempfile.TemporaryDirectory() as folder:
        features = write_features(source, views, Path(folder), threads)
        keys = join_moments(features, starting_lenses(sizes, factor, known), Path(folder))
        matches = count_matches(list(sizes), Path(folder))
        rig = map_rig(Path(folder), not known.fixed, known.lenses is None)
    for pair in matches:
        log.info("%s and %s: %d features alike, %d fit one pose", pair.first, pair.second, pair.found, pair.verified)
    found = sum(map(len, features.values()))
    complain_of_unplaced(capture, list(sizes), list(rig.cameras) if rig else [], matches)
    in_units = {name: _at_sensor(camera, factor) for name, camera in rig.cameras.items()}
    scale = _metres_per_unit(capture, calibration, in_units, outlines)
    log.info("%d features, %d of them of %d points", found, len(rig.residuals), rig.residuals.point.nunique())
    cameras = {name: _at_sensor(replace(c, t=scale * c.t), factor, sizes[name]) for name, c in rig.cameras.items()}
    residuals = _residual_table(rig, keys, features, factor)
    quality = _quality(rig, residuals, cameras, scale, known)
    verdicts = [_judge(row, settings) for row in quality.itertuples()]
    units = np.tile(np.repeat([1.0, scale], 3), len(cameras))
    pairs = pair_table(cameras, [rig.pose_covariance() * np.outer(units, units)])
    return CameraCalibration(cameras, residuals, quality, pairs, verdicts, _failures(capture, verdicts))


def _failures(capture: Path, verdicts: Sequence[Verdict]) -> Complaints:
    complaints = Complaints(capture)
    for verdict in verdicts:
        if verdict.grade == "failed":
            expected = "a focal length known to calibrate_cameras.largest_focal_error"
            complaints.add("calibration.cameras", f"camera {verdict.name}", expected=expected, found=verdict.reason)
    return complaints


def starting_lenses(sizes: Sizes, factor: float, known: RigPriors) -> dict[str, pycolmap.Camera]:
    """COLMAP's lens of each camera: the given one, or one of one coefficient."""
    found = {}
    for number, (name, size) in enumerate(sizes.items(), 1):
        if known.lenses is not None:
            found[name] = colmap_lens(number, known.lenses[number - 1].downsampled(factor))
        else:
            width, height = (round(side / factor) for side in size)
            found[name] = pycolmap.Camera.create_from_model_name(
                number, "SIMPLE_RADIAL", USUAL_FOCAL * max(width, height), width, height
            )
        # A lens that was given counts as a good start, which mapping need not doubt.
        found[name].has_prior_focal_length = known.lenses is not None
    return found


def _outlines(capture: Path, calibration: Mapping[str, Any]) -> dict[tuple[str, str], np.ndarray]:
    """Outlines of the mirror ball that gives the rig its size; none where a distance does.

    Raises:
        InputError: if there is neither.
    """
    if calibration.get("distance"):
        return {}
    outlines = find_outlines(capture, dict(calibration))[0] if calibration.get("silhouettes") else {}
    if len({camera for _, camera in outlines}) < 2:
        raise InputError(_no_size(capture))
    return outlines


def _no_size(capture: Path) -> str:
    return (
        f"{capture}: calibration.cameras.distance: expected a size of the rig, by a distance or a mirror ball that two "
        "cameras see at one place, found neither; measure how far two cameras are apart: first, second, metres"
    )


def _metres_per_unit(
    capture: Path, calibration: Mapping[str, Any], cameras: Mapping[str, Camera], outlines: Mapping
) -> float:
    """Factor from the rig's unit to metres, by the given distance or the ball's radius."""
    if given := calibration.get("distance"):
        apart = np.linalg.norm(cameras[given["first"]].center - cameras[given["second"]].center)
        return float(given["metres"] / apart)
    if (radius := radius_in_rig(cameras, outlines)) is None:
        raise InputError(_no_size(capture))
    log.info("size of the rig by the mirror ball; calibrate_lights corrects it by the surveyed lights")
    return float(calibration["radius_m"] / radius)


def _at_sensor(camera: Camera, factor: float, size: tuple[int, int] | None = None) -> Camera:
    larger = camera.downsampled(1 / factor)
    return larger if size is None else replace(larger, width=size[0], height=size[1])


def _residual_table(rig: FeatureRig, keys: Mapping[str, list[Key]], features: Mapping, factor: float) -> pd.DataFrame:
    """Columns as of boards; `corner` numbers the points of the subject."""
    parts = []
    for name, rows in rig.residuals.groupby("camera", sort=False):
        ends = np.cumsum([len(features[key]) for key in keys[name]])
        frames = np.array([key[1] for key in keys[name]])
        parts.append(rows.assign(view=frames[np.searchsorted(ends, rows.feature, side="right")]))
    table = pd.concat(parts, ignore_index=True).assign(board=0, weight=1.0).rename(columns={"point": "corner"})
    table[["x", "y", "residual_x", "residual_y"]] *= factor
    return table[RESIDUAL_COLUMNS].sort_values(["camera", "view", "corner"], ignore_index=True)


def _quality(
    rig: FeatureRig, residuals: pd.DataFrame, cameras: Mapping[str, Camera], scale: float, known: RigPriors
) -> pd.DataFrame:
    rows = []
    focal, center = rig.focal_sigma(), scale * rig.center_sigma()
    for c, (name, camera) in enumerate(cameras.items()):
        mine = residuals[residuals.camera == name]
        rms = float(np.sqrt((mine[["residual_x", "residual_y"]].to_numpy() ** 2).sum(1).mean()))
        covered = covered_share(mine[["x", "y"]].to_numpy(np.float64), camera.width, camera.height)
        terms = int(np.count_nonzero(camera.dist)) if known.lenses is not None else 1
        rows.append((name, mine.view.nunique(), len(mine), rms, focal[c], center[c], covered, np.nan, terms))
    return pd.DataFrame(rows, columns=QUALITY_COLUMNS)


def _judge(row: Any, limits: CalibrateCameras) -> Verdict:
    failed, weak = [], []
    if row.focal_sigma > limits.largest_focal_error:
        failed.append("its focal length is uncertain: give it (intrinsics: known or refine), or calibrate with boards")
    elif row.focal_sigma > limits.good_focal_error:
        weak.append("its focal length is uncertain: give it (intrinsics: known or refine)")
    if row.center_sigma_m > limits.good_center_m:
        weak.append(f"its centre is uncertain, {1000 * limits.good_center_m:g} mm wanted: more moments, or boards")
    numbers = (
        f"{row.corners} features of {row.views} moments in {100 * row.coverage:.0f} % of the image, RMS "
        f"{row.rms_px:.3f} px, focal length +-{100 * row.focal_sigma:.3f} %, centre +-{1000 * row.center_sigma_m:.2f} "
        "mm but for the size of the rig"
    )
    grade = "failed" if failed else "weak" if weak else "good"
    return Verdict("camera", row.camera, grade, "; ".join([*failed, *weak, numbers]))
