"""Images of ChArUco boards before pinhole cameras, drawn by homography, as a capture."""

from __future__ import annotations

import cv2
import numpy as np
import pandas as pd

from pipeline.base.files import write_json, write_table
from pipeline.calibration.cameras.charuco import CharucoBoard

SIZE = (320, 240)
BOARD = CharucoBoard(7, 5, 0.12, 0.09, "DICT_5X5_250")
FOCAL = 400.0
K = np.array([[FOCAL, 0, 160], [0, FOCAL, 120], [0, 0, 1]])
SQUARE, MARGIN = 80, 40
"""Pixels of a drawn square (a multiple of 8: no line of a marker is rounded) and of the white margin around."""
FINER = 3
"""Samples per pixel along each axis: the homography itself must not alias."""


def middle(board):
    """The middle of a board in its own frame, metres."""
    return np.array([board.squares_x, board.squares_y, 0]) * board.square_m / 2


def pose(turn, center, board=BOARD):
    """world_from_board of a board turned by a rotation vector, whose middle is at `center`."""
    result = np.eye(4)
    result[:3, :3] = cv2.Rodrigues(np.array(turn, float))[0]
    result[:3, 3] = center - result[:3, :3] @ middle(board)
    return result


def camera_at(angle_deg, distance_m=1.3, turned_deg=0.0):
    """cam_from_world on an arc around the origin, looking at it, or past it by `turned_deg`."""
    result = np.eye(4)
    result[:3, :3] = cv2.Rodrigues(np.radians([0.0, angle_deg + turned_deg, 0.0]))[0]
    center = cv2.Rodrigues(np.radians([0.0, -angle_deg, 0.0]))[0] @ [0.0, 0.0, -distance_m]
    result[:3, 3] = -result[:3, :3] @ center
    return result


def draw(cam_from_world, placed):
    """A camera's image of `placed`: [(board, world_from_board)] that do not cover each other."""
    fine = np.full((FINER * SIZE[1], FINER * SIZE[0]), 200, np.uint8)
    to_centers = np.array([[1, 0, -0.5], [0, 1, -0.5], [0, 0, 1.0]])
    for board, world_from_board in placed:
        size = (board.squares_x * SQUARE, board.squares_y * SQUARE)
        drawn = cv2.copyMakeBorder(
            board.opencv().generateImage(size), *[MARGIN] * 4, cv2.BORDER_CONSTANT, value=255
        )  # fmt: skip
        in_camera = cam_from_world @ world_from_board
        pixel, edge = board.square_m / SQUARE, -MARGIN * board.square_m / SQUARE
        metres_from_drawn = np.array([[pixel, 0, edge], [0, pixel, edge], [0, 0, 1]])
        pinhole = np.diag([FINER, FINER, 1.0]) @ K @ in_camera[:3, [0, 1, 3]]
        homography = to_centers @ pinhole @ metres_from_drawn @ np.linalg.inv(to_centers)
        cv2.warpPerspective(drawn, homography, fine.shape[::-1], fine, borderMode=cv2.BORDER_TRANSPARENT)
    return fine.reshape(SIZE[1], FINER, SIZE[0], FINER).mean((1, 3)).round().astype(np.uint8)


def write_capture(folder, images, board_keys=None, size=SIZE, cameras=None):
    """`images`: {(camera, view): gray}. The arguments of the stage's `run`."""
    entries = []
    for (camera, view), gray in images.items():
        path = f"{camera}_{view}.png"
        cv2.imwrite(str(folder / path), gray)
        entries.append({"camera": camera, "view": view, "path": path, "digest": ""})
    sizes = {"width": 160, "height": 120, "sensor_width": size[0], "sensor_height": size[1]}
    names = cameras or list(dict.fromkeys(camera for camera, _ in images))
    write_table(folder / "index/cameras.parquet", pd.DataFrame([{"camera": name, **sizes} for name in names]))
    content = {"method": "charuco", **(board_keys or vars(BOARD)), "views": entries}
    write_json(folder / "index/calibration_cameras.json", content)
    return {"capture": folder, "index": folder / "index", "out": folder / "out"}
