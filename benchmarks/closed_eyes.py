"""A real face with closed eyes (yqueau/near_ps) as pixels of spheres as large as eyes, laid all over it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float64
from scipy.io import loadmat

from benchmarks.face_lights import HEAD_M, IMAGES, REDUCED, read_colors
from pipeline.eyes.eye_pixels import EyePixels, join_views, seen_pixels
from pipeline.geometry.cameras import Camera

RADIUS_M = 0.0125
"""Of an eye; its centre lies so far behind the skin."""

STEP_PX = 12
"""Between neighbouring spheres, 8 mm of the face."""

HALVES = ((1, 3, 6, 8), (2, 4, 7))
"""LEDs that are added up to a picture each: as near to full light as two different pictures come."""


LIDS = {"right lid": (280.5, 195.5), "left lid": (384.5, 192.5)}
"""Middles of the closed lids in the reduced photographs, by eye."""

AROUND_PX = (-6, 0, 6)
"""Offsets of spheres about a lid's middle: a template's eyes are not placed better than to 4 mm."""


def lid_places(lid: str) -> Float64[np.ndarray, "places 2"]:
    """Places of spheres behind a closed lid."""
    return np.array([np.add(LIDS[lid], (right, down)) for right in AROUND_PX for down in AROUND_PX])


def read_pictures(folder: Path, together: Sequence[tuple[int, ...]]) -> list[Float64[np.ndarray, "height width 3"]]:
    """Photographs under some LEDs each, less ambient light."""
    ambient = read_colors(folder / "ambient.png").astype(np.float64)
    single = {number: read_colors(folder / f"{number:04d}.png") - ambient for number in IMAGES}
    return [sum(single[number] for number in numbers) for numbers in together]


def face_camera(folder: Path) -> Camera:
    """The camera, of the reduced photographs, at the origin."""
    K = loadmat(folder / "camera.mat")["K"].astype(np.float64)
    mask = cv2.imread(str(folder / "mask_2601x1732.png"), cv2.IMREAD_UNCHANGED)
    scale = np.array([*(np.array(REDUCED) / mask.shape[::-1]), 1.0])
    return Camera(np.eye(3), np.zeros(3), scale[:, None] * K, np.zeros(5), *REDUCED)


def sphere_places(folder: Path) -> Float64[np.ndarray, "places 2"]:
    """Pixels of a grid around which the mask is all face, a sphere's width and more."""
    mask = cv2.resize(
        cv2.imread(str(folder / "mask_2601x1732.png"), cv2.IMREAD_UNCHANGED), REDUCED, interpolation=cv2.INTER_AREA
    )
    reach = 2 * round(1.2 * RADIUS_M / HEAD_M * face_camera(folder).K[0, 0]) + 1
    inside = cv2.erode((mask == 255).astype(np.uint8), np.ones((reach, reach), np.uint8), borderValue=0)
    rows, columns = np.nonzero(inside[::STEP_PX, ::STEP_PX])
    return STEP_PX * np.stack([columns, rows], 1) + 0.5


def sphere_pixels(pictures: list[np.ndarray], camera: Camera, place: Float64[np.ndarray, "2"]) -> EyePixels:
    """Pixels of a sphere behind the skin at a place of the face, in all pictures."""
    center = (HEAD_M + RADIUS_M) * np.append((place - camera.K[:2, 2]) / np.diag(camera.K)[:2], 1.0)
    nothing_before = np.full((camera.height, camera.width), np.inf, np.float32)
    pose = np.column_stack([np.eye(3), np.zeros(3)])
    return join_views(
        [seen_pixels(camera, image.astype(np.float32), nothing_before, pose, center, RADIUS_M) for image in pictures]
    )
