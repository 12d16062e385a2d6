"""Calibration targets: ChArUco board, 24-patch colour chart, and mirror ball."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float32, Float64

from pipeline.base.seeds import generator_for
from pipeline.config.synthesize_capture import SynthesizeCapture
from pipeline.geometry.cameras import Camera

BOARD_DICTIONARY = "DICT_5X5_250"
MARKER_MODULES = 7
"""Modules along a 5 x 5 marker with its border."""

MODULE_TEXELS = 12
"""Texels per marker module: several times finer than any view of the board."""

BOARD_BORDER_SQUARES = 0.5
"""White border around the board, so that dark outer squares stand out from the dark stage."""

PAPER, INK = 0.65, 0.04
"""Reflectance of white and black print."""

STEEPEST_VIEW_DEG = 58.0
"""Board views at a lower angle than this are left out: markers get too thin to read."""

BOARD_SPREAD = np.array([0.15, 0.34, 0.15])
BOARD_NEARER = 0.39
"""Distance of the board from the stage's centre, and towards the cameras it faces, at most.

In units of the framed height. Views have to reach the corners of the images, since lens distortion cannot be measured
where no board was.
"""

BALL_SPREAD = 0.2
"""Largest distance of the mirror ball from the stage's centre, of the framed height."""

BOARD_SHARE_IN_VIEW = 0.6
"""Share of the board that must lie in the image for a view to be taken."""

CHART_LIGHT = 0.9
"""Radiance around the colour chart: its white patch stays below saturation."""

CHART_WIDTH_SHARE = 0.72
"""Share of the image's width that the chart covers."""

CHART_FRAME = (0.022, 0.022, 0.022)
CHART_COLUMNS, CHART_ROWS = 6, 4
CHART_CELL_TEXELS, CHART_PATCH_TEXELS, CHART_BORDER_TEXELS = 50, 43, 12

CHART_PATCHES = np.array(
    [
        [0.171, 0.0844, 0.0578], [0.539, 0.3, 0.2197], [0.112, 0.194, 0.339], [0.103, 0.15, 0.0521],
        [0.227, 0.213, 0.434], [0.119, 0.509, 0.403], [0.694, 0.2, 0.0256], [0.0648, 0.104, 0.376],
        [0.533, 0.0887, 0.122], [0.1095, 0.044, 0.142], [0.342, 0.496, 0.0497], [0.749, 0.361, 0.0279],
        [0.0251, 0.0467, 0.301], [0.0561, 0.291, 0.0648], [0.434, 0.0331, 0.0423], [0.807, 0.571, 0.0127],
        [0.497, 0.0887, 0.301], [0.0, 0.235, 0.371], [0.896, 0.896, 0.879], [0.584, 0.591, 0.584],
        [0.352, 0.361, 0.361], [0.191, 0.194, 0.194], [0.0887, 0.0908, 0.0908], [0.0319, 0.0331, 0.0331],
    ]
)  # fmt: skip
"""Linear Rec. 709 reflectance of the ColorChecker's patches, row by row from the brown one, top left."""

REFLECTION_ROUNDS = 40
"""Fixed-point rounds for a reflection on the ball.

They contract at least 3x for a ball this small: 3^-40 is less than a float64 resolves.
"""


def board_texture(settings: SynthesizeCapture) -> Float32[np.ndarray, "h w 3"]:
    """The printed board with its white border, as reflectance, row 0 at the top."""
    board = cv2.aruco.CharucoBoard(
        (settings.board_squares_x, settings.board_squares_y), settings.board_square_m, settings.board_marker_m,
        cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, BOARD_DICTIONARY)),
    )  # fmt: skip
    square = round(MARKER_MODULES * MODULE_TEXELS * settings.board_square_m / settings.board_marker_m)
    square += square % 2  # the border is half a square
    size = (settings.board_squares_x * square, settings.board_squares_y * square)
    drawn = np.pad(board.generateImage(size, marginSize=0), int(BOARD_BORDER_SQUARES * square), constant_values=255)
    gray = INK + (PAPER - INK) * (drawn.astype(np.float32) / 255)
    return np.repeat(gray[..., None], 3, axis=2).astype(np.float32)


def board_poses(subject: str, settings: SynthesizeCapture) -> list[Float64[np.ndarray, "4 3"]]:
    """Corners of the print for each pose of the board, in metres.

    Top left, top right, bottom right, bottom left. Successive poses face a full turn of azimuths, so that neighbouring
    cameras share views.
    """
    border = 2 * BOARD_BORDER_SQUARES
    width = (settings.board_squares_x + border) * settings.board_square_m
    height = (settings.board_squares_y + border) * settings.board_square_m
    poses = []
    for pose in range(settings.board_poses):
        random = generator_for(subject, "board", pose)
        azimuth = 2 * np.pi * pose / settings.board_poses + np.radians(12) * random.uniform(-1, 1)
        tilt = np.radians(10 + 32 * random.uniform(-1, 1))
        normal = np.array([np.cos(tilt) * np.sin(azimuth), np.sin(tilt), np.cos(tilt) * np.cos(azimuth)])
        toward = np.array([np.sin(azimuth), 0.0, np.cos(azimuth)])
        center = BOARD_SPREAD * random.uniform(-1, 1, 3) + BOARD_NEARER * random.uniform(-0.3, 1) * toward
        center = settings.framed_height_m * center
        poses.append(facing_rectangle(center, normal, width, height, roll=np.radians(25) * random.uniform(-1, 1)))
    return poses


def facing_rectangle(
    center: np.ndarray, normal: np.ndarray, width: float, height: float, roll: float
) -> Float64[np.ndarray, "4 3"]:
    """Corners, clockwise from top left as seen from the side the normal points to."""
    right = np.cross([0.0, 1.0, 0.0], normal)
    right /= np.linalg.norm(right)
    down = -np.cross(normal, right)
    right, down = np.cos(roll) * right + np.sin(roll) * down, np.cos(roll) * down - np.sin(roll) * right
    halves = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    return np.array([center + x * width / 2 * right + y * height / 2 * down for x, y in halves])


def sees_board(camera: Camera, corners: Float64[np.ndarray, "4 3"]) -> bool:
    """True if a camera sees the board's front steeply enough, and most of it in the image."""
    normal = np.cross(corners[3] - corners[0], corners[1] - corners[0])
    normal /= np.linalg.norm(normal)
    to_camera = camera.center - corners.mean(axis=0)
    if normal @ to_camera / np.linalg.norm(to_camera) < np.cos(np.radians(STEEPEST_VIEW_DEG)):
        return False
    across, along = np.meshgrid(np.linspace(0, 1, 15), np.linspace(0, 1, 15))
    points = corners[0] + across[..., None] * (corners[1] - corners[0]) + along[..., None] * (corners[3] - corners[0])
    pixels, _ = camera.project(points.reshape(-1, 3))
    inside = ((pixels >= 0) & (pixels < [camera.width, camera.height])).all(axis=1)
    return bool(inside.mean() >= BOARD_SHARE_IN_VIEW)


def chart_texture() -> Float32[np.ndarray, "h w 3"]:
    """The colour chart as reflectance, row 0 at the top."""
    border = CHART_BORDER_TEXELS
    shape = (CHART_ROWS * CHART_CELL_TEXELS + 2 * border, CHART_COLUMNS * CHART_CELL_TEXELS + 2 * border, 3)
    texture = np.tile(np.array(CHART_FRAME, dtype=np.float32), (*shape[:2], 1))
    inset = (CHART_CELL_TEXELS - CHART_PATCH_TEXELS) // 2
    for patch, color in enumerate(CHART_PATCHES):
        top = border + inset + (patch // CHART_COLUMNS) * CHART_CELL_TEXELS
        left = border + inset + (patch % CHART_COLUMNS) * CHART_CELL_TEXELS
        texture[top : top + CHART_PATCH_TEXELS, left : left + CHART_PATCH_TEXELS] = color
    return texture


def chart_corners(camera: Camera, random: np.random.Generator) -> Float64[np.ndarray, "4 3"]:
    """Corners of a chart held up to the camera at the stage's centre, a little askew."""
    distance = np.linalg.norm(camera.center)
    forward = camera.R[2]
    width = CHART_WIDTH_SHARE * camera.width / camera.K[0, 0] * distance
    rows, columns = chart_texture().shape[:2]
    normal = -forward + 0.12 * random.uniform(-1, 1, 3)
    roll = np.radians(8) * random.uniform(-1, 1)
    center = camera.center + distance * forward
    return facing_rectangle(center, normal / np.linalg.norm(normal), width, width * rows / columns, roll)


def ball_centers(subject: str, settings: SynthesizeCapture) -> Float64[np.ndarray, "n 3"]:
    """Centres of the mirror ball, metres.

    Around the stage's centre, within every camera's image, not in a line.
    """
    count, spread = settings.ball_positions, BALL_SPREAD * settings.framed_height_m
    random = generator_for(subject, "mirror ball")
    angles = 2 * np.pi * (np.arange(count) + 0.3 * random.uniform(-1, 1, count)) / count
    heights = spread * np.where(np.arange(count) % 2, -1, 1) * random.uniform(0.6, 1, count)
    return np.stack([spread * np.sin(angles), heights, spread * np.cos(angles)], axis=1)


def sphere_points(center: np.ndarray, radius: float, count: int = 200) -> Float64[np.ndarray, "n 3"]:
    """Points spread evenly over a sphere."""
    index = np.arange(count) + 0.5
    y = 1 - 2 * index / count
    turn = index * np.pi * (3 - np.sqrt(5))
    around = np.sqrt(1 - y**2)
    return center + radius * np.stack([around * np.cos(turn), y, around * np.sin(turn)], axis=1)


def reflections(
    eye: Float64[np.ndarray, "3"], lights: Float64[np.ndarray, "n 3"], center: Float64[np.ndarray, "3"], radius: float
) -> Float64[np.ndarray, "m 3"]:
    """Points on a mirror ball in which `eye` sees `lights`.

    Lights hidden behind the ball are left out. The normal bisects the directions to eye and light; iterated from the
    bisector at the centre.
    """
    normals = np.zeros_like(lights)
    for _ in range(REFLECTION_ROUNDS):
        points = center + radius * normals
        bisectors = _unit(eye - points) + _unit(lights - points)
        normals = _unit(bisectors)
    points = center + radius * normals
    seen = ((eye - points) * normals).sum(axis=1) > 0
    seen &= ((lights - points) * normals).sum(axis=1) > 0
    return points[seen]


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)
