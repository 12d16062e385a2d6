"""Errors of calibrated cameras, lights and tracked vertices.

They are against what is known to be true, or against better ones.

A rig's frame is arbitrary, so cameras are compared after a rigid alignment of their centres
(`pipeline.geometry.rigid_alignment`). Errors are root mean squares: a rig is as good as its bad cameras allow.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float, Float64

from pipeline.base.errors import InputError
from pipeline.geometry.cameras import Camera
from pipeline.geometry.rigid_alignment import Alignment, align_rigid

GRID = 9
"""Points along one side of an image at which projections are compared: a lens is smooth."""

Rig = Mapping[str, Camera]


def rms(values: Float[np.ndarray, "*shape"]) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values, dtype=np.float64))))


def align_rigs(rig: Rig, expected: Rig) -> Alignment:
    """Expected frame from the rig's, by the centres of the cameras that both have.

    Raises:
        InputError: if both share fewer than three cameras, or those stand on one line.
    """
    names = sorted(rig.keys() & expected.keys())
    try:
        return align_rigid(_centers(rig, names), _centers(expected, names))
    except ValueError as error:
        raise InputError(f"cameras to compare: found {len(names)} in both: {error}") from error


def camera_center_error_m(rig: Rig, expected: Rig) -> float:
    """RMS distance of aligned camera centres, metres."""
    return rms(np.linalg.norm(align_rigs(rig, expected).residual, axis=1))


def focal_error_percent(rig: Rig, expected: Rig) -> float:
    """RMS relative error of both focal lengths of all cameras, per cent."""
    names = sorted(rig.keys() & expected.keys())
    ratio = [np.diag(rig[name].K)[:2] / np.diag(expected[name].K)[:2] for name in names]
    return 100 * rms(np.array(ratio) - 1)


def projection_error_px(rig: Rig, expected: Rig) -> float:
    """RMS distance of projections all over each image, sensor pixels.

    The points are as far away as the subject.

    Counts what an image sees of all errors together: of pose, focal length and distortion that make up for each other
    nothing is left.
    """
    alignment, subject = align_rigs(rig, expected), focus(expected)
    squares = []
    for name in rig.keys() & expected.keys():
        true = expected[name]
        x, y = np.meshgrid(*((np.arange(GRID) + 0.5) / GRID * side for side in (true.width, true.height)))
        pixels = np.stack([x.ravel(), y.ravel()], 1)
        rays = true.ray_directions(pixels)
        seen = np.isfinite(rays).all(1)  # the corners of a fisheye's image may be dark
        points = true.center + np.linalg.norm(subject - true.center) * rays[seen]
        found, _ = rig[name].project((points - alignment.t) @ alignment.R)
        squares.append(((found - pixels[seen]) ** 2).sum(1))
    return float(np.sqrt(np.mean(np.concatenate(squares))))


def light_error_in_rig_m(
    lights: Float64[np.ndarray, "lights 3"], rig: Rig, expected: Float64[np.ndarray, "lights 3"], expected_rig: Rig
) -> float:
    """RMS distance of lights, metres, once the cameras lie over the expected ones.

    That is what lighting the subject needs.
    """
    return rms(np.linalg.norm(align_rigs(rig, expected_rig).apply(lights) - expected, axis=1))


def focus(rig: Rig) -> Float64[np.ndarray, " 3"]:
    """The point nearest to all optical axes: where the subject is."""
    across = [np.eye(3) - np.outer(camera.R[2], camera.R[2]) for camera in rig.values()]
    to_centers = [matrix @ camera.center for matrix, camera in zip(across, rig.values(), strict=True)]
    return np.linalg.lstsq(np.sum(across, 0), np.sum(to_centers, 0), rcond=None)[0]


def pixel_size_m(rig: Rig) -> float:
    """Median over the cameras of what one sensor pixel covers at the subject, metres."""
    subject = focus(rig)
    return float(np.median([np.linalg.norm(camera.center - subject) / camera.K[0, 0] for camera in rig.values()]))


def _centers(rig: Rig, names: list[str]) -> np.ndarray:
    return np.array([rig[name].center for name in names]).reshape(-1, 3)
