"""Reading cameras from nerfstudio's transforms.json.

Its poses are world-from-camera, x right, y up, looking along -z. Its world is the original one after
`applied_transform` and then `applied_scale` (nerfstudio's own data parser applies them in this order): both are
undone. The first pixel's centre is (0.5, 0.5), and lenses, fisheyes too, distort as OpenCV's do. A value stands in a
frame or, for all frames, beside them.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.errors import Complaints, InputError
from pipeline.base.files import read_json
from pipeline.capture.cameras.camera_formats import (
    FURTHER_TERMS,
    SourceImage,
    SourceLens,
    camera_from_lens,
    finite_numbers,
    resolve_owner,
)
from pipeline.geometry.cameras import Camera
from pipeline.geometry.lenses import BROWN_CONRADY, FISHEYE

PERSPECTIVE = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV")
"""nerfstudio's names for its one perspective model, which is also what a file without `camera_model` means."""

TERMS = tuple(dict.fromkeys([*BROWN_CONRADY.terms, *FISHEYE.terms, *FURTHER_TERMS]))

MODELS = {**dict.fromkeys(PERSPECTIVE, BROWN_CONRADY), "OPENCV_FISHEYE": FISHEYE}

OPENCV_FROM_OPENGL = np.diag([1.0, -1.0, -1.0])

LEAST_DETERMINANT = 1e-6
"""Of `applied_transform`, whose axes are of length 1: below this its 32-bit numbers cannot be undone."""


def read_nerfstudio(file: Path, cameras: Collection[str], complaints: Complaints) -> list[SourceImage]:
    """The frames of a transforms.json that the capture's cameras took, by name. Other frames may be anything.

    Raises:
        InputError: if the file is none, or its world cannot be told.
    """
    content = read_json(file)
    frames = content.get("frames") if isinstance(content, dict) else None
    if not isinstance(frames, list) or not all(isinstance(frame, dict) for frame in frames):
        raise InputError(
            "frames: expected a list of sections with file_path and transform_matrix, found something else"
        )
    applied, scale = _applied(content)
    found = []
    for place, frame in enumerate(frames):
        name, owner, camera = frame.get("file_path"), None, None
        with complaints.collecting():
            if not isinstance(name, str):
                raise InputError(f"frames[{place}]: file_path: expected text, found {name!r}")
            if (owner := resolve_owner(name, cameras)) is not None:
                camera = _camera(f"frame {name}", content, frame, applied, scale)
        if owner is not None:
            found.append(SourceImage(owner, name, camera))
    return sorted(found, key=lambda image: image.name)


def _applied(content: Mapping[str, Any]) -> tuple[np.ndarray, float]:
    """applied_transform [3, 4] and applied_scale: x_here = scale * (A x_original + a)."""
    applied = np.eye(4)[:3]
    if "applied_transform" in content:
        applied = finite_numbers(content, "applied_transform", (3, 4))
    scale = float(finite_numbers(content, "applied_scale", ())) if "applied_scale" in content else 1.0
    if scale <= 0 or abs(np.linalg.det(applied[:, :3])) < LEAST_DETERMINANT:
        found = f"a scale of {scale:g} and axes {applied[:, :3].tolist()}"
        raise InputError(f"applied_transform, applied_scale: expected what can be undone, found {found}")
    return applied, scale


def _camera(
    where: str, content: Mapping[str, Any], frame: Mapping[str, Any], applied: np.ndarray, scale: float
) -> Camera:
    try:
        pose = finite_numbers(frame, "transform_matrix", (4, 4))
        turn, center = np.linalg.solve(applied[:, :3], pose[:3, :3]), pose[:3, 3] / scale - applied[:, 3]
        R = (turn @ OPENCV_FROM_OPENGL).T
        t = -R @ np.linalg.solve(applied[:, :3], center)
        return camera_from_lens(R, t, _lens(_merged(content, frame)))
    except InputError as error:
        raise InputError(f"{where}: {error}") from error


def _merged(content: Mapping[str, Any], frame: Mapping[str, Any]) -> dict[str, Any]:
    if twice := [key for key in frame if key in content and content[key] != frame[key]]:
        found = ", ".join(f"{key} of {frame[key]} and of {content[key]}" for key in twice)
        raise InputError(f"expected a value for this frame or one for all frames, found {found}; remove one")
    return {**content, **frame}


def _lens(values: Mapping[str, Any]) -> SourceLens:
    name = values.get("camera_model", "OPENCV")
    if values.get("is_fisheye") and name != "OPENCV_FISHEYE":  # instant-ngp's key, which says nothing of the terms
        name = "is_fisheye"
    if name not in MODELS:
        hint = "undistort the images and calibrate with one of those"
        raise InputError(f"camera_model: expected one of {', '.join(MODELS)}, found {name}; {hint}")
    model = MODELS[name]
    if "fl_x" not in values and "camera_angle_x" in values:
        hint = "give fl_x = w / (2 tan(camera_angle_x / 2)), fl_y, cx, cy"
        raise InputError(f"fl_x: expected a number of pixels, found none, only camera_angle_x; {hint}")
    terms = {name: float(finite_numbers(values, key, ())) for name, key in
             {"fx": "fl_x", "fy": "fl_y", "cx": "cx", "cy": "cy"}.items()}  # fmt: skip
    terms |= {key: float(finite_numbers(values, key, ())) for key in TERMS if key in values}
    width, height = (float(finite_numbers(values, key, ())) for key in "wh")
    if width % 1 or height % 1:
        raise InputError(f"w, h: expected whole numbers of pixels, found {width} and {height}")
    return SourceLens(model, terms, int(width), int(height))
