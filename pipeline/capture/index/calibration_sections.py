"""Sections of a capture's calibration: contents of the index, and named photographs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd

from pipeline.base.errors import Complaints
from pipeline.capture.index import calibration_files, color_files
from pipeline.capture.index.feature_views import check_features
from pipeline.capture.index.image_checks import ExpectedImage
from pipeline.capture.schema.camera_schema import PhotographedBoards
from pipeline.capture.schema.capture_yaml import (
    Capture,
    EarlierLights,
    FeatureCameras,
    KnownCameras,
    KnownLights,
    MirrorBallLights,
)
from pipeline.capture.schema.manifest import MANIFEST

Contents = dict[str, dict[str, Any]]
"""By the names of the index's files."""


def find_calibration(
    root: Path, manifest: Capture, cameras: pd.DataFrame | None, lights: pd.DataFrame | None, complaints: Complaints
) -> tuple[Contents, list[ExpectedImage]]:
    """Contents of the index's files about calibration, and the photographs that they name.

    Args:
        root: folder of the capture.
        manifest: its description.
        cameras, lights: tables of the capture; None where one cannot be read.
        complaints: what is wrong goes there.
    """
    contents, expected, section = {}, [], manifest.calibration
    if section is None:
        return contents, expected
    if cameras is not None and section.cameras is not None:
        contents["calibration_cameras"], more = calibration_files.find_camera_calibration(
            root, section.cameras, cameras, complaints
        )
        expected += more
    if cameras is not None and lights is not None and section.lights is not None:
        contents["calibration_lights"], more = calibration_files.find_light_calibration(
            root, section.lights, cameras, lights, complaints
        )
        expected += more
    if cameras is not None and section.color is not None:
        contents["calibration_color"], more = color_files.find_color_calibration(
            root, section.color, cameras, complaints
        )
        expected += more
    if section.cameras is not None and section.lights is not None:
        _check_stage_frame(section.cameras, section.lights, complaints)
        if cameras is not None:
            check_features(section, cameras, complaints)
    return contents, expected


def _check_stage_frame(
    cameras: PhotographedBoards | KnownCameras | FeatureCameras,
    lights: MirrorBallLights | KnownLights | EarlierLights,
    complaints: Complaints,
) -> None:
    in_stage = isinstance(cameras, KnownCameras) and cameras.frame == "stage"
    if not in_stage and isinstance(lights, KnownLights):
        complaints.add(
            MANIFEST, "calibration.lights.method",
            expected="mirror_ball for cameras in a frame of their own", found="known",
            hint="only measured lights tie that frame to the surveyed ones: add mirror-ball images, or give known "
            "cameras in the frame of the lights",
        )  # fmt: skip
