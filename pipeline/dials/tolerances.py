"""Errors that nobody minds, as one yardstick for every subject.

They are what its images and its noise would hardly show.
"""

from __future__ import annotations

import numpy as np

from pipeline.base.files import read_json, read_table
from pipeline.config.plan_effects import LENS_DISTORTION_PX
from pipeline.dials.subject import Subject
from pipeline.geometry.cameras import Camera, read_cameras
from pipeline.metrics.output_errors import focus, pixel_size_m

LIGHT_TOLERANCE = 0.01 / 2
"""Error of a light's position over its distance: received light falls with the square of it, so this makes 1 %, the
noise of a capture (40 dB, or 1 % of full scale; see `pipeline.config.plan_effects`)."""

YARDSTICKS = ("index/capture.json", "calibration/cameras.json")
"""What every function here reads, below a subject's results."""


def small_length_mm(subject: Subject) -> float:
    """Length at the subject that LENS_DISTORTION_PX image pixels cover, mm."""
    return 1000 * LENS_DISTORTION_PX * sensor_per_image_px(subject) * pixel_size_m(_cameras(subject))


def small_focal_percent(subject: Subject) -> float:
    """Tolerable error of the focal length, percent.

    It moves the middle of an image's shorter edges by LENS_DISTORTION_PX.
    """
    longer_side = np.median([max(camera.width, camera.height) for camera in _cameras(subject).values()])
    return float(100 * LENS_DISTORTION_PX / (longer_side / sensor_per_image_px(subject) / 2))


def small_light_mm(subject: Subject) -> float:
    """LIGHT_TOLERANCE of the median distance between lights and subject."""
    lights = read_table(subject.results / "calibration/lights.parquet")[["x", "y", "z"]].to_numpy(np.float64)
    return float(1000 * LIGHT_TOLERANCE * np.median(np.linalg.norm(lights - focus(_cameras(subject)), axis=1)))


def sensor_per_image_px(subject: Subject) -> float:
    """Sensor pixels per image pixel along one axis."""
    return float(read_json(subject.results / "index/capture.json")["images"]["downsample_from_sensor"])


def _cameras(subject: Subject) -> dict[str, Camera]:
    return read_cameras(subject.results / "calibration/cameras.json")
