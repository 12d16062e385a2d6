"""Pictures of eyes with a painted iris, planted truth for gaze from images."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from pipeline.eyes.eye_shape import eye_surface, usual_shape
from pipeline.geometry.cameras import Camera

RADIUS_M = 0.012
SHAPE = usual_shape(RADIUS_M)
CENTER = np.array([0.03, 0.01, 0.06])
IRIS_DEG, PUPIL_DEG = 25.0, 9.0
WHITE, IRIS, PUPIL, SKIN = ([0.8, 0.75, 0.7], [0.2, 0.3, 0.4], [0.02, 0.02, 0.02], [0.6, 0.4, 0.3])
LOOKS = [
    Rotation.from_euler("YX", angles, degrees=True).apply([0.0, 0.0, 1.0]) for angles in [(0, 0), (16, -6), (-12, 9)]
]


def cameras(head):
    """Five around the left eye, half a metre away; `head` is the turn and shift of the head's frame."""
    for azimuth, height in [(-40, 0), (0, 15), (40, 0), (-20, -20), (20, 25)]:
        back = Rotation.from_euler("YX", [azimuth, -height], degrees=True).apply([0.0, 0.0, 1.0])
        right = np.cross([0.0, 1.0, 0.0], back)
        R = np.stack([right / np.linalg.norm(right), np.zeros(3), -back])
        R[1] = np.cross(R[2], R[0])
        place = CENTER + 0.5 * back
        turn, shift = head
        R_world = R @ turn.T
        t = -R_world @ (turn @ place + shift)
        yield Camera(R_world, t, np.array([[400.0, 0, 32], [0, 400.0, 30], [0, 0, 1]]), np.zeros(5), 64, 60)


def painted(camera, head, gaze, center=CENTER, glint=True, skin=False):
    """A picture of the eye on a background of skin, by its surface sampled a hundredfold."""
    turn, shift = head
    image = np.tile(np.float32(SKIN), (camera.height, camera.width, 1))
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(60_000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    surface = eye_surface(directions, gaze[None], SHAPE.radius_m, SHAPE.cornea_radius_m, SHAPE.cornea_offset_m)
    world = (surface.points + center) @ turn.T + shift
    facing = ((camera.center - world) * (surface.normals @ turn.T)).sum(1) > 0
    angle = np.degrees(np.arccos(np.clip(directions @ gaze, -1, 1)))
    color = np.select([angle[:, None] < PUPIL_DEG, angle[:, None] < IRIS_DEG], [PUPIL, IRIS], WHITE)
    color = np.tile(SKIN, (len(angle), 1)) if skin else color
    pixels = np.floor(camera.project(world[facing])[0]).astype(int)
    total, count = np.zeros((camera.height, camera.width, 3)), np.zeros((camera.height, camera.width, 1))
    np.add.at(total, (pixels[:, 1], pixels[:, 0]), color[facing])
    np.add.at(count, (pixels[:, 1], pixels[:, 0]), 1)
    image = np.where(count > 0, total / np.maximum(count, 1), image).astype(np.float32)
    if glint:
        row, column = np.argwhere(count[..., 0] > 0)[rng.integers(0, int((count > 0).sum()), 4)].T
        image[row, column] = 5.0
    return image * np.float32(rng.uniform(0.5, 2.0))
