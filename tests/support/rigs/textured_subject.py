"""Photographs of textured ellipsoids by cameras around them: planted truth for rigs without boards."""

from __future__ import annotations

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from pipeline.geometry.cameras import Camera

SIZE = (360, 480)

PARTS = [
    ((0, 0.25, 0), (0.11, 0.14, 0.12)),
    ((0, -0.15, 0), (0.2, 0.27, 0.13)),
    ((0.24, -0.1, 0.05), (0.07, 0.2, 0.07)),
]
"""Centres and semiaxes, metres: a head, a trunk, an arm."""


def texture(seed, size=(512, 1024)):
    """Noise of six octaves on longitude and latitude, linear, 0 to 1."""
    random, total = np.random.default_rng(seed), np.zeros(size)
    for rows in (8, 16, 32, 64, 128, 256):
        octave = random.normal(size=(rows, 2 * rows))
        total += cv2.resize(octave, size[::-1], interpolation=cv2.INTER_CUBIC) * rows**-0.5
    return np.clip(0.45 + 0.16 * (total - total.mean()) / total.std(), 0.02, 1).astype(np.float32)


TEXTURES = [texture(seed) for seed in range(len(PARTS))]


def ring(count, arc_deg, seed=0, tilts=(-12, 8)):
    """Cameras 1.5 m away that look at the middle, no two alike; focal lengths differ by 3 %, k1 by 0.01."""
    random, found = np.random.default_rng(seed), {}
    for k in range(count):
        angles = [arc_deg * (k / (count - 1) - 0.5), -tilts[k % len(tilts)]]
        center = 1.5 * (1 + 0.05 * random.normal()) * Rotation.from_euler("YX", angles, degrees=True).apply([0, 0, 1.0])
        ahead = 0.03 * random.normal(size=3) - center
        ahead /= np.linalg.norm(ahead)
        right = np.cross(ahead, [0.0, 1.0, 0.0])
        R = np.stack([right / np.linalg.norm(right), np.zeros(3), ahead])
        R[1] = np.cross(R[2], R[0])
        f = 520 * (1 + 0.03 * random.normal())
        K = np.array([[f, 0, SIZE[0] / 2], [0, f, SIZE[1] / 2], [0, 0, 1]])
        found[f"cam{k}"] = Camera(R, -R @ center, K, np.array([-0.08 + 0.01 * random.normal(), 0, 0, 0, 0]), *SIZE)
    return found


def photograph(camera, pose, textures=TEXTURES):
    """Linear grey image of the parts, moved by `pose` (rotation, shift), and the mask of what shows."""
    columns, rows = np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5)
    ways = camera.ray_directions(np.stack([columns.ravel(), rows.ravel()], 1))
    turn, shift = pose
    nearest, image = np.full(len(ways), np.inf), np.zeros(len(ways), np.float32)
    for (center, axes), paint in zip(PARTS, textures, strict=True):
        origin, way = (turn.T @ (camera.center - shift) - center) / axes, ways @ turn / axes
        a, b, c = (way**2).sum(1), way @ origin, origin @ origin - 1
        root = b * b - a * c
        along = np.where(root > 0, (-b - np.sqrt(np.maximum(root, 0))) / a, np.inf)
        place = origin + np.where(np.isfinite(along), along, 0)[:, None] * way
        x = (np.arctan2(place[:, 0], place[:, 2]) / (2 * np.pi) + 0.5) * paint.shape[1]
        y = (np.arcsin(np.clip(place[:, 1], -1, 1)) / np.pi + 0.5) * paint.shape[0]
        shape = (SIZE[1], SIZE[0])
        seen = cv2.remap(
            paint, x.astype(np.float32).reshape(shape), y.astype(np.float32).reshape(shape), cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_WRAP,
        ).ravel()  # fmt: skip
        image = np.where(along < nearest, seen, image)
        nearest = np.minimum(nearest, along)
    return image.reshape(SIZE[::-1]), np.isfinite(nearest).reshape(SIZE[::-1])


def moved(seed):
    """A pose of the subject: it turned by some degrees and moved by some centimetres."""
    random = np.random.default_rng(seed)
    return Rotation.from_rotvec(0.15 * random.normal(size=3)).as_matrix(), 0.05 * random.normal(size=3)
