"""Input of a review of the tracking: all chunks together, and the cameras' images."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float32, Float64

from pipeline.base.color import corrected
from pipeline.base.errors import InputError
from pipeline.base.files import read_arrays, read_json, read_rows, read_table
from pipeline.capture.images import ImageSource
from pipeline.capture.reduced_images import block_means
from pipeline.geometry.cameras import Camera
from pipeline.geometry.kinematics import Pose, point_positions, tracked_points
from pipeline.geometry.skin import Template
from pipeline.geometry.template_file import read_template
from pipeline.geometry.tracked import read_tracked
from pipeline.tracking.image_cameras import image_cameras
from pipeline.tracking.keypoint_targets import NO_TARGETS, KeypointTargets, read_keypoint_targets
from pipeline.tracking.tracking_inputs import detected_pixels


@dataclass(frozen=True)
class TrackedCapture:
    """The posed template in all frames, and what it is judged by.

    Attributes:
        source: of the images; the paths in `images` are relative to its folder.
        cameras: at image resolution, by name.
        held_out: cameras that took no part in tracking.
        frames: one row per frame: frame, timestamp_s, segment, chunk, fully_lit, and track_mesh's columns.
        vertices: posed, world, metres.
        keypoints_m: the posed template's, world, metres.
        triangulated_m: from what was detected alone, world, metres; NaN where fewer than two cameras agree.
        detected: keypoints as detected, pixels of the (distorted) images; NaN where not.
        images: index/images.parquet by (camera, frame).
        lights: light, x, y, z; patterns: frame, light, intensity_r, ...
        corrections: corrected-from-raw colour of each camera (`corrected`); cameras without one are as they are.
    """

    subject: str
    source: ImageSource
    template: Template
    cameras: Mapping[str, Camera]
    held_out: frozenset[str]
    frames: pd.DataFrame
    vertices: Float32[np.ndarray, "frames vertices 3"]
    keypoint_names: Sequence[str]
    keypoints_m: Float64[np.ndarray, "frames keypoints 3"]
    triangulated_m: Float32[np.ndarray, "frames keypoints 3"]
    detected: Float64[np.ndarray, "cameras frames keypoints 2"]
    images: pd.DataFrame
    lights: pd.DataFrame
    patterns: pd.DataFrame
    corrections: Mapping[str, Float64[np.ndarray, "3 columns"]]

    @cached_property
    def projected(self) -> Float64[np.ndarray, "cameras frames keypoints 2"]:
        """The template's keypoints in the (distorted) images, pixels; NaN behind a camera."""
        found = [camera.project(self.keypoints_m) for camera in self.cameras.values()]
        return np.stack([np.where(depth[..., None] > 0, pixels, np.nan) for pixels, depth in found])

    @cached_property
    def residual_px(self) -> Float64[np.ndarray, "cameras frames keypoints"]:
        """Distance between detected and projected keypoints, pixels; NaN where not detected."""
        return np.linalg.norm(self.detected - self.projected, axis=-1)

    @cached_property
    def trained(self) -> Bool[np.ndarray, " cameras"]:
        """Cameras that took part in tracking."""
        return np.array([name not in self.held_out for name in self.cameras])

    def image(self, name: str, row: int, factor: int) -> Float32[np.ndarray, "height width 3"] | None:
        """Corrected linear RGB of the `row`th frame, `factor` times smaller; None without an image."""
        entry = self._entry(name, row)
        if entry is None:
            return None
        image = self.source.read(entry.path, int(self.frames.frame.iloc[row]))
        matrix = self.corrections.get(name, np.eye(3)).astype(np.float32)
        small = self.cameras[name].downsampled(float(factor))
        return corrected(block_means(np.nan_to_num(image, posinf=0.0, neginf=0.0), factor, small), matrix)

    def mask(self, name: str, row: int, factor: int) -> Float32[np.ndarray, "height width"] | None:
        """Share of each pixel, 0..1, that shows the subject, `factor` times smaller.

        None if there is no mask.
        """
        entry = self._entry(name, row)
        if entry is None or pd.isna(entry.mask_path):
            return None
        camera = self.cameras[name]
        mask = self.source.read_mask(entry.mask_path, (camera.height, camera.width))
        return block_means(mask, factor, camera.downsampled(float(factor))) / np.float32(255)

    def _entry(self, name: str, row: int) -> Any:
        key = name, int(self.frames.frame.iloc[row])
        return self.images.loc[key] if key in self.images.index else None


def read_tracked_capture(
    capture: Path, index: Path, calibration: Path, tracking: Sequence[Path], patterns: Path
) -> TrackedCapture:
    """Read a capture with its index, its calibration and its tracked chunks.

    Raises:
        InputError: naming a file that is missing or unreadable, or does not belong to the template.
    """
    described, images = read_json(index / "capture.json"), read_table(index / "images.parquet")
    template = read_template(capture / described["template"]["mesh"], float(described["template"]["scale_to_m"]))
    targets = NO_TARGETS
    if described["template"].get("keypoints") is not None:
        targets = read_keypoint_targets(capture / described["template"]["keypoints"], template)
    cameras = image_cameras(
        calibration / "cameras.json", images, float(described["images"]["downsample_from_sensor"]), True
    )
    chunks = [_read_chunk(path, template, targets) for path in tracking]
    tables, *arrays = zip(*chunks, strict=True)
    vertices, keypoints, triangulated = map(np.concatenate, arrays)
    detected = []
    for table in tables:
        numbers = table.frame.to_numpy(np.int64)
        rows = read_rows(index / "keypoints_2d.parquet", "frame", numbers)
        detected.append(detected_pixels(rows, list(cameras), numbers, targets.names))
    synced = read_table(patterns)
    frames = pd.concat([table.assign(chunk=number) for number, table in enumerate(tables)], ignore_index=True)
    frames = frames.merge(read_table(index / "frames.parquet"), on="frame", how="left", validate="one_to_one")
    frames["fully_lit"] = frames.frame.isin(synced.frame[synced.fully_lit])
    colors = read_json(calibration / "color.json")["cameras"]
    return TrackedCapture(
        described["subject"], ImageSource.from_index(capture, described["images"]), template, cameras,
        frozenset(images.camera[images.test_camera]), frames, vertices, targets.names, keypoints, triangulated,
        np.concatenate(detected, axis=1), images.set_index(["camera", "frame"]).sort_index(),
        read_table(calibration / "lights.parquet"), synced,
        {name: np.asarray(matrix, np.float64) for name, matrix in colors.items()},
    )  # fmt: skip


def _read_chunk(
    path: Path, template: Template, targets: KeypointTargets
) -> tuple[pd.DataFrame, np.ndarray, np.ndarray, np.ndarray]:
    """Table, vertices, the template's keypoints and the triangulated ones."""
    tracked, arrays = read_tracked(path, len(template.vertices_rest)), read_arrays(path)
    missing = {"root_rotation", "root_translation", "keypoints"} - arrays.keys()
    if missing:
        raise InputError(f"{path}: expected an array '{min(missing)}', found {sorted(arrays)}; run track_mesh again")
    table = read_table(path.with_suffix(".parquet"))
    if table.frame.tolist() != tracked.frames.tolist():
        raise InputError(f"{path.with_suffix('.parquet')}: expected the frames of {path.name}, found others")
    keypoints = tracked.vertices[:, targets.vertices].astype(np.float64)
    on_joint = targets.joints >= 0
    if on_joint.any():
        roots = (arrays[name].astype(np.float64) for name in ("root_rotation", "root_translation"))
        pose = Pose(*roots, arrays["joint_rotations"].astype(np.float64))
        joints = targets.joints[on_joint]
        keypoints[:, on_joint] = point_positions(tracked_points(template, joints, np.full_like(joints, -1)), pose)
    return table, tracked.vertices, keypoints, arrays["keypoints"]
