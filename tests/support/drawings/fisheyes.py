"""Images of ChArUco boards before fisheyes, drawn ray by ray, without the pipeline's lens."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np

from tests.support.drawings.boards import MARGIN, SQUARE

FINER = 3
"""Samples per pixel along each axis."""

SIZE = (480, 360)
FOCAL = 150.0
TERMS = (-0.02, 0.012, -0.006, 0.0008)
"""At the side of the image, 240 pixels from the middle, a ray is 94 degrees from the optical axis."""


@cache
def ray_directions():
    """Rays [rows, columns, 3] of all samples, the same for every image: theta looked up in a table of theta_d."""
    theta = np.linspace(0, 2.4, 200_001)
    theta_d = theta * (1 + sum(k * theta ** (2 * n) for n, k in enumerate(TERMS, 1)))
    assert (np.diff(theta_d) > 0).all()
    width, height = SIZE
    x, y = np.meshgrid(*((np.arange(n * FINER) + 0.5) / FINER - n / 2 for n in (width, height)))
    radius = np.hypot(x, y)
    angle = np.interp(radius / FOCAL, theta_d, theta)
    along = np.sin(angle) / np.maximum(radius, 1e-12)
    return np.stack([along * x, along * y, np.cos(angle)], -1)


def draw_fisheye(cam_from_world, placed):
    """Image of `placed`, [(board, world_from_board)], by intersecting every ray with each board's plane."""
    fine, rays = np.full((FINER * SIZE[1], FINER * SIZE[0]), 200, np.uint8), ray_directions()
    for board, world_from_board in placed:
        size = (board.squares_x * SQUARE, board.squares_y * SQUARE)
        drawn = cv2.copyMakeBorder(
            board.opencv().generateImage(size), *[MARGIN] * 4, cv2.BORDER_CONSTANT, value=255
        )  # fmt: skip
        # A drawn pixel is as fine as a sample: coarser ones would alias.
        blurred = cv2.GaussianBlur(drawn, (0, 0), 1.0)
        board_from_cam = np.linalg.inv(cam_from_world @ world_from_board)
        turned, eye = rays @ board_from_cam[:3, :3].T, board_from_cam[:3, 3]
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = -eye[2] / turned[..., 2]
            spot = eye[:2] + distance[..., None] * turned[..., :2]
        at = np.nan_to_num(spot * SQUARE / board.square_m + MARGIN - 0.5, nan=-1e6, posinf=-1e6, neginf=-1e6)
        hit = (distance > 0) & (at > -0.5).all(-1) & (at < np.array(drawn.shape[::-1]) - 0.5).all(-1)
        found = cv2.remap(blurred, *np.moveaxis(at.astype(np.float32), -1, 0), cv2.INTER_LINEAR)
        fine[hit] = found[hit]
    return fine.reshape(SIZE[1], FINER, SIZE[0], FINER).mean((1, 3)).round().astype(np.uint8)
