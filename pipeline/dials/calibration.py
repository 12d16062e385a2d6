"""Dials of calibrate_cameras and calibrate_lights."""

from __future__ import annotations

import math

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.files import read_json, read_table
from pipeline.config.calibrate_cameras import BOARD_METHODS
from pipeline.config.plan_effects import LENS_DISTORTION_PX
from pipeline.dials.dial import CostedStage, Dial, Files, Metric
from pipeline.dials.subject import Subject
from pipeline.dials.tolerances import (
    YARDSTICKS,
    sensor_per_image_px,
    small_focal_percent,
    small_length_mm,
    small_light_mm,
)
from pipeline.geometry.cameras import Camera, read_cameras
from pipeline.metrics.output_errors import (
    camera_center_error_m,
    focal_error_percent,
    light_error_in_rig_m,
    projection_error_px,
    rms,
)

VIEW_SHARES = (0.2, 0.35, 0.5, 0.75)
"""Of a capture's board views: with fewer, cameras that see a quarter of them have too few to be calibrated."""

BALL_COUNTS = (1, 2, 3, 4, 6, 8, 12, 16)
"""Positions of the mirror ball, as far as the capture has more."""


def _method(subject: Subject, what: str) -> str:
    return read_json(subject.results / f"index/calibration_{what}.json")["method"]


def _rigs(subject: Subject, output: Files, expected: Files) -> tuple[dict[str, Camera], dict[str, Camera]] | None:
    """Both rigs; None if a camera is missing that the workflow, with all views, did calibrate.

    Without a camera that is hard to calibrate, errors are small: no merit of the setting.
    """
    found, wanted = read_cameras(output["rig"]), read_cameras(expected["rig"])
    known = read_cameras(subject.results / "calibration/cameras.json").keys() & wanted.keys()
    return (found, wanted) if known <= found.keys() else None


def _projection(subject: Subject, output: Files, expected: Files) -> float:
    rigs = _rigs(subject, output, expected)
    return projection_error_px(*rigs) / sensor_per_image_px(subject) if rigs else math.inf


def _centers(subject: Subject, output: Files, expected: Files) -> float:
    rigs = _rigs(subject, output, expected)
    return 1000 * camera_center_error_m(*rigs) if rigs else math.inf


def _focal(subject: Subject, output: Files, expected: Files) -> float:
    rigs = _rigs(subject, output, expected)
    return focal_error_percent(*rigs) if rigs else math.inf


def _lights(output: Files, expected: Files) -> tuple[np.ndarray, np.ndarray]:
    """Positions of the same lights: found and expected.

    Raises:
        InputError: if they are not the same: every light has a position, be it the surveyed one.
    """
    tables = [read_table(files["lights"]).set_index("light").sort_index() for files in (output, expected)]
    if list(tables[0].index) != list(tables[1].index):
        raise InputError(f"{expected['lights']}: expected the lights of {output['lights']}, found others")
    found, wanted = (table[["x", "y", "z"]].to_numpy(np.float64) for table in tables)
    return found, wanted


def _lights_in_rig(subject: Subject, output: Files, expected: Files) -> float:
    found, wanted = _lights(output, expected)
    return 1000 * light_error_in_rig_m(found, read_cameras(output["rig"]), wanted, read_cameras(expected["rig"]))


def _lights_in_stage(subject: Subject, output: Files, expected: Files) -> float:
    found, wanted = _lights(output, expected)
    return 1000 * rms(np.linalg.norm(found - wanted, axis=1))


def _view_counts(subject: Subject) -> list[int | None]:
    """Shares of the board's views, then all."""
    views = read_json(subject.results / "index/calibration_cameras.json")["views"]
    count = len({view["view"] for view in views})
    return [*sorted({max(1, round(share * count)) for share in VIEW_SHARES} - {count}), None]


def _ball_counts(subject: Subject) -> list[int | None]:
    """Numbers of the ball's positions, then all."""
    images = read_json(subject.results / "index/calibration_lights.json")["images"]
    positions = len({image["position"] for image in images})
    return [*(count for count in BALL_COUNTS if count < positions), None]


CAMERAS = CostedStage(
    name="calibrate_cameras",
    files={"calibration": "{out}"},
    inputs=("index/calibration_cameras.json", "index/cameras.parquet", *YARDSTICKS),
    outputs={"rig": ("rig.json", "cameras.json"), "residuals": ("residuals_cameras.parquet", None)},
    metrics=(
        Metric("projection all over the image, RMS, image px", _projection, lambda subject: LENS_DISTORTION_PX),
        Metric("camera centre in the rig, RMS, mm", _centers, small_length_mm),
        Metric("focal length, RMS, %", _focal, small_focal_percent),
    ),
    unit="corners",
    work=lambda output: len(read_table(output["residuals"])),
    runs_on=lambda subject: _method(subject, "cameras") in BOARD_METHODS,
)

LIGHTS = CostedStage(
    name="calibrate_lights",
    files={"calibration": "{out}"},
    inputs=("index/calibration_lights.json", "calibration/rig.json", "calibration/lights.parquet", *YARDSTICKS),
    outputs={
        "rig": ("cameras.json", "cameras.json"), "lights": ("lights.parquet", "lights.parquet"),
        "residuals": ("residuals_lights.parquet", None),
    },
    metrics=(
        Metric("light in the rig, RMS, mm", _lights_in_rig, small_light_mm),
        Metric("light in the stage, RMS, mm", _lights_in_stage, small_light_mm),
    ),
    unit="highlights",
    work=lambda output: len(read_table(output["residuals"])),
    runs_on=lambda subject: _method(subject, "lights") == "mirror_ball",
)  # fmt: skip

CALIBRATION_DIALS = [
    Dial("board_views", CAMERAS, "most_views", _view_counts),
    Dial("distortion", CAMERAS, "distortion", lambda subject: (0, 1, 2, 5, "auto")),
    Dial("ball_positions", LIGHTS, "most_balls", _ball_counts),
]
