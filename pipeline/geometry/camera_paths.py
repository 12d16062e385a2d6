"""Cameras along a path: around a point, through calibrated cameras, or through keyframes. All without distortion."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Float64
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation, RotationSpline

from pipeline.base.errors import InputError, listed
from pipeline.base.files import read_json
from pipeline.geometry.cameras import Camera
from pipeline.geometry.lenses import BROWN_CONRADY

UP = np.array([0.0, 1.0, 0.0])
NO_DISTORTION = BROWN_CONRADY.no_distortion()

SMALLEST_SINE = 1e-6
"""Sine between view direction and the vertical below which 'upright' says nothing, and -z of the world is up."""

Vector = tuple[float, float, float]


class Keyframe(BaseModel):
    """Pose of the camera in one picture.

    Attributes:
        picture: number of the picture, from 0.
        eye, target: the camera's centre and a point it looks at, metres.
        fov_y_degrees: angle from the top to the bottom of the picture.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    picture: float
    eye: Vector
    target: Vector
    fov_y_degrees: float = Field(40.0, gt=0, lt=180)


class Keyframes(BaseModel):
    """A keyframe file."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    keyframes: Annotated[tuple[Keyframe, ...], Field(min_length=1)]


def look_at(
    eye: Float64[np.ndarray, " 3"], target: Float64[np.ndarray, " 3"], fov_y_degrees: float, width: int, height: int
) -> Camera:
    """An upright camera that sees `target` in the middle of its picture.

    Raises:
        ValueError: if eye and target are one point.
    """
    forward = target - eye
    if not np.linalg.norm(forward) > 0:
        raise ValueError(f"look_at: expected a target away from the eye, found both at {eye.tolist()}")
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, UP)
    if np.linalg.norm(right) < SMALLEST_SINE:
        right = np.cross(forward, [0.0, 0.0, -1.0])
    right /= np.linalg.norm(right)
    R = np.stack([right, np.cross(forward, right), forward])
    focal = height / 2 / np.tan(np.radians(fov_y_degrees) / 2)
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    return Camera(R, -R @ eye, K, NO_DISTORTION, width, height)


def orbit(
    center: Float64[np.ndarray, " 3"], radius: float, rise: float, turns: float, fov_y_degrees: float,
    width: int, height: int, pictures: int,
) -> list[Camera]:  # fmt: skip
    """Cameras on `turns` rounds about the vertical through `center`.

    `rise` metres above it, from its +z side towards +x.

    The last picture is one step short of the end, so that whole turns loop.
    """
    angles = 2 * np.pi * turns * np.arange(pictures) / pictures
    eyes = center + np.stack([radius * np.sin(angles), np.full(pictures, rise), radius * np.cos(angles)], 1)
    return [look_at(eye, center, fov_y_degrees, width, height) for eye in eyes]


def through_cameras(cameras: list[Camera], height: int, pictures: int) -> list[Camera]:
    """Cameras smoothly from the first to the last, at each in evenly spaced pictures.

    One camera stands still.

    Pictures have the first camera's shape, `height` pixels high. Centres and intrinsics follow monotone cubics
    (Fritsch and Carlson 1980: no overshoot), rotations a spline.
    """
    same = [camera.downsampled(camera.height / height).pinhole() for camera in cameras]
    first = same[0]
    if len(same) == 1:
        return [first] * pictures
    knots, at = np.arange(len(same)), np.linspace(0, len(same) - 1, pictures)
    centers, Ks = (
        PchipInterpolator(knots, np.stack(rows))(at) for rows in ([c.center for c in same], [c.K for c in same])
    )
    rotations = RotationSpline(knots, Rotation.from_matrix(np.stack([c.R for c in same])))(at).as_matrix()
    return [
        Camera(R, -R @ center, K, NO_DISTORTION, first.width, first.height)
        for R, center, K in zip(rotations, centers, Ks, strict=True)
    ]


def through_keyframes(path: Path, width: int, height: int, pictures: int) -> list[Camera]:
    """Smoothly through a keyframe file's cameras; still before the first and after the last.

    Raises:
        InputError: if the file is not `{"keyframes": [{picture, eye, target, fov_y_degrees}, ...]}` in rising order.
    """
    try:
        keys = Keyframes.model_validate(read_json(path)).keyframes
    except ValidationError as error:
        problems = [f"{'.'.join(map(str, e['loc']))}: {e['msg']}, found {e['input']!r}" for e in error.errors()]
        raise InputError(f"{path}: expected keyframes of picture, eye, target: {listed(problems)}") from error
    times = np.array([key.picture for key in keys], np.float64)
    if (np.diff(times) <= 0).any():
        raise InputError(f"{path}: expected pictures in rising order, found {times.tolist()}")
    rows = np.array([[*key.eye, *key.target, key.fov_y_degrees] for key in keys], np.float64)
    at = np.clip(np.arange(pictures), times[0], times[-1])
    along = PchipInterpolator(times, rows)(at) if len(keys) > 1 else np.repeat(rows, pictures, 0)
    try:
        return [look_at(row[:3], row[3:6], float(row[6]), width, height) for row in along]
    except ValueError as error:
        raise InputError(f"{path}: {error}") from error
