"""Inputs of tracking: undistorted keypoints and silhouettes."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence

import numpy as np
import pandas as pd
from jaxtyping import Float64, Int64

from pipeline.base.errors import InputError
from pipeline.base.progress import progress
from pipeline.base.spread import evenly
from pipeline.capture.images import ImageSource
from pipeline.capture.reduced_images import block_means, reduction
from pipeline.geometry.cameras import Camera
from pipeline.geometry.signed_distance import View, view_from_masks
from pipeline.tracking.keypoint_targets import KeypointTargets
from pipeline.tracking.mesh_tracker import Observations

LOG = logging.getLogger("track_mesh")


def keypoint_observations(
    table: pd.DataFrame, cameras: dict[str, Camera], frames: np.ndarray, targets: KeypointTargets
) -> Observations:
    """A table of keypoints_2d in normalised coordinates, for some cameras and frames.

    Raises:
        InputError: if there are no keypoints, none that the template has, or several rows for one.
    """
    if table.empty:
        raise InputError(
            f"keypoints_2d: expected keypoints, found none in frames {frames.min()} to {frames.max()}; run a 2D "
            "detector and name its table in capture.yaml"
        )
    known = table.keypoint.isin(targets.names)
    if not known.any():
        found = ", ".join(sorted(table.keypoint.unique())[:5])
        raise InputError(f"keypoints_2d: keypoint: expected names of template.keypoints, found {found} ...")
    if not known.all():
        LOG.warning("%d keypoint rows name keypoints that template.keypoints does not map: left out", (~known).sum())
    if table.duplicated(["frame", "camera", "keypoint"]).any():
        raise InputError("keypoints_2d: expected one row per frame, camera and keypoint, found several; keep the best")
    names = list(cameras)
    table = table[known & table.camera.isin(names) & table.frame.isin(frames)]
    rows = (
        pd.Index(names).get_indexer(table.camera),
        pd.Index(frames).get_indexer(table.frame),
        pd.Index(targets.names).get_indexer(table.keypoint),
    )
    shape = (len(names), len(frames), len(targets.names))
    normalised, confidence = np.full((*shape, 2), np.nan), np.zeros(shape)
    confidence[rows] = np.nan_to_num(table.confidence.to_numpy(np.float64))
    pixels = table[["x", "y"]].to_numpy(np.float64)
    for number, camera in enumerate(cameras.values()):
        mine = (rows[0] == number) & np.isfinite(pixels).all(1)
        if mine.any():
            normalised[number, rows[1][mine], rows[2][mine]] = camera.undistort(pixels[mine])
    return Observations(list(cameras.values()), normalised, confidence)


def detected_pixels(
    table: pd.DataFrame, cameras: Sequence[str], frames: Int64[np.ndarray, " frames"], names: Sequence[str]
) -> Float64[np.ndarray, "cameras frames keypoints 2"]:
    """Detected keypoints of some cameras, frames and names, pixels; NaN where not."""
    table = table[table.camera.isin(cameras) & table.frame.isin(frames) & table.keypoint.isin(names)]
    rows = tuple(
        pd.Index(values).get_indexer(table[column])
        for values, column in ((list(cameras), "camera"), (frames, "frame"), (list(names), "keypoint"))
    )
    found = np.full((len(cameras), len(frames), len(names), 2), np.nan)
    found[rows] = table[["x", "y"]].to_numpy(np.float64)
    return found


def keypoint_residuals(
    detected: Float64[np.ndarray, "cameras frames keypoints 2"], cameras: Iterable[Camera],
    points: Float64[np.ndarray, "frames keypoints 3"],
) -> Float64[np.ndarray, "cameras frames keypoints"]:  # fmt: skip
    """Distances of detected keypoints from where known points are seen, pixels; NaN if not."""
    away = np.full(detected.shape[:3], np.nan)
    for number, camera in enumerate(cameras):
        pixels, depth = camera.project(points)
        away[number] = np.where(depth > 0, np.linalg.norm(detected[number] - pixels, axis=-1), np.nan)
    return away


def mask_views(
    source: ImageSource, images: pd.DataFrame, cameras: dict[str, Camera], frames: np.ndarray, most: int, size_px: int
) -> dict[str, View]:
    """Silhouettes of masks by camera, from at most `most` cameras, reduced to `size_px`.

    A mask that frames share, as those of a still subject do, is decoded once. Empty if the capture has no masks.
    """
    masked = images[images.mask_path.notna() & images.camera.isin(list(cameras)) & images.frame.isin(frames)]
    names = evenly(sorted(masked.camera.unique()), most)
    views = {}
    for name in progress(names, "read masks"):
        factor = reduction(cameras[name], size_px)
        camera = cameras[name].downsampled(float(factor))
        rows = masked[masked.camera == name].set_index("frame").mask_path
        paths = [rows.get(frame) for frame in frames]
        masks = {path: _mask(source, path, cameras[name], factor, camera) for path in dict.fromkeys(paths) if path}
        views[name] = view_from_masks(camera, [masks.get(path) for path in paths])
    return views


def _mask(source: ImageSource, path: str, camera: Camera, factor: int, small: Camera) -> np.ndarray:
    mask = source.read_mask(path, (camera.height, camera.width))
    return np.round(block_means(mask, factor, small)).astype(np.uint8)
