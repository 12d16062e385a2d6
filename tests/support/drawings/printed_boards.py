"""Prints of calibration boards by OpenCV or by hand, photographed through a known lens without the pipeline.

A photograph's truth is analytic: cv2.projectPoints of the print's points.
"""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np

SIZE = (640, 480)
K = np.array([[600.0, 0, 325], [0, 602, 238], [0, 0, 1]])
"""OpenCV's: the first pixel's centre is (0, 0)."""
DIST = np.array([-0.25, 0.08, 0.001, -0.0005, 0.0])
FINER = 3
"""Samples per pixel along each axis."""

PER_M = 2000.0
"""Pixels of a print per metre: of 40 mm, 80, which is a multiple of 8: no line of a marker is rounded."""

MARGIN_M = 0.03
"""White round a print."""


def print_charuco(x, y, square_m, marker_m, dictionary, legacy=False, first=0):
    """A ChArUco board as OpenCV draws it."""
    named = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    board = cv2.aruco.CharucoBoard((x, y), square_m, marker_m, named, np.arange(first, first + x * y // 2))
    board.setLegacyPattern(legacy)
    return _with_margin(board.generateImage((round(x * square_m * PER_M), round(y * square_m * PER_M))))


def print_tags(x, y, tag_m, gap_m, dictionary):
    """A grid of tags as OpenCV draws it."""
    named = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    board = cv2.aruco.GridBoard((x, y), tag_m, gap_m, named)
    size = (round((x * (tag_m + gap_m) - gap_m) * PER_M), round((y * (tag_m + gap_m) - gap_m) * PER_M))
    return _with_margin(board.generateImage(size))


def print_checkerboard(x, y, square_m):
    """Black and white squares, black first."""
    row, column = np.indices((y, x))
    side = round(square_m * PER_M)
    return _with_margin(np.kron(255 * ((row + column) % 2), np.ones((side, side))).astype(np.uint8))


def print_circles(points_m, radius_m):
    """Discs whose middles are points of the plane, the first of them at the print's origin."""
    size = np.ceil(points_m.max(0) * PER_M).astype(int)
    page = _with_margin(np.full((size[1], size[0]), 255, np.uint8), 2 * MARGIN_M)
    at = (points_m + 2 * MARGIN_M) * PER_M - 0.5
    for x, y in np.round(at * 16).astype(int).tolist():
        cv2.circle(page, (x, y), round(radius_m * PER_M * 16), 0, -1, cv2.LINE_AA, 4)
    return page, 2 * MARGIN_M


def _with_margin(drawn, margin_m=MARGIN_M):
    return cv2.copyMakeBorder(drawn, *[round(margin_m * PER_M)] * 4, cv2.BORDER_CONSTANT, value=255)


def photograph(page, turn, shift, margin_m=MARGIN_M, inverted=False, noise=2.0):
    """A photograph of a print whose origin lies at `shift`, turned by a rotation vector; the table is mid-grey."""
    to_camera = np.column_stack([cv2.Rodrigues(np.array(turn, float))[0][:, :2], shift])
    on_board = cv2.perspectiveTransform(_rays(), np.linalg.inv(to_camera)).reshape(FINER * SIZE[1], FINER * SIZE[0], 2)
    at = ((on_board + margin_m) * PER_M - 0.5).astype(np.float32)
    printed = 255 - page if inverted else page
    # Blurred to what one sample covers: a print is much finer than a photograph.
    coarse = cv2.GaussianBlur(printed, (0, 0), 1.0)
    fine = cv2.remap(coarse, at, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=150)
    image = fine.reshape(SIZE[1], FINER, SIZE[0], FINER).astype(float).mean((1, 3))
    image += np.random.default_rng(0).normal(0, noise, image.shape)
    return np.clip(np.round(image), 0, 255).astype(np.uint8)


@cache
def _rays():
    """Undistorted directions of all samples of a photograph, row by row."""
    columns, rows = np.meshgrid(*[(np.arange(FINER * n) + 0.5) / FINER - 0.5 for n in SIZE])
    pixels = np.stack([columns.ravel(), rows.ravel()], 1)
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-9)
    return cv2.undistortPoints(pixels[:, None], K, DIST, criteria=stop)


def true_pixels(points_m, turn, shift):
    """Where the photograph shows points of the print; first pixel centre at (0.5, 0.5)."""
    points = np.column_stack([points_m[:, :2], np.zeros(len(points_m))])
    return cv2.projectPoints(points, np.array(turn, float), np.array(shift, float), K, DIST)[0][:, 0] + 0.5
