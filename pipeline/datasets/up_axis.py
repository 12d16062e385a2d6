"""The up axis of a set that does not say which one it is: cameras stand upright."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from pipeline.base.errors import InputError
from pipeline.geometry.cameras import Camera

log = logging.getLogger(__name__)

CLEAR = 0.8
"""Cosine between the cameras' mean up and the axis: cameras that look from above and from below by 35 degrees each."""

TURNS = {
    "+x": [[0, -1, 0], [1, 0, 0], [0, 0, 1]], "-x": [[0, 1, 0], [-1, 0, 0], [0, 0, 1]],
    "+y": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "-y": [[1, 0, 0], [0, -1, 0], [0, 0, -1]],
    "+z": [[1, 0, 0], [0, 0, 1], [0, -1, 0]], "-z": [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
}  # fmt: skip
"""Rotation that brings each axis to +y."""


def upright_from_set(cameras: Iterable[Camera], where: str) -> Float64[np.ndarray, "3 3"]:
    """Rotation of the set's world that brings its up axis to +y.

    Up is the axis next to the mean of the cameras' own up, which is opposite to y in their images.

    Raises:
        InputError: if that mean is near no axis.
    """
    ups = np.array([-camera.R[1] for camera in cameras])
    mean = ups.mean(0) / max(float(np.linalg.norm(ups.mean(0))), 1e-12)
    axis = int(np.abs(mean).argmax())
    name = f"{'+' if mean[axis] > 0 else '-'}{'xyz'[axis]}"
    log.info("%s: the cameras' mean up is %s: %s is up", where, np.round(mean, 3).tolist(), name)
    if abs(mean[axis]) < CLEAR:
        raise InputError(f"{where}: expected cameras whose mean up is near an axis of the world, found {mean.round(3)}")
    return np.array(TURNS[name], np.float64)


def turned(camera: Camera, upright: Float64[np.ndarray, "3 3"]) -> Camera:
    """The camera in the turned world."""
    return replace(camera, R=camera.R @ upright.T)
