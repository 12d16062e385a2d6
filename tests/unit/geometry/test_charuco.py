"""Board detection on boards drawn by OpenCV and warped by a known homography."""

import cv2
import numpy as np
import pytest

from pipeline.geometry.charuco import Board, detect_board, matching_dictionary

SQUARE = 80
"""Pixels per square of the drawn board: a multiple of 8, so that no line of a marker is rounded."""


def warped_board(board, legacy=False, scale=0.6, noise=0.0):
    """A board drawn large, warped; and the homography from board squares to this project's pixels."""
    size = (board.squares_x * SQUARE, board.squares_y * SQUARE)
    drawn = board.opencv(legacy).generateImage(size, marginSize=0, borderBits=1)
    # Pixel edges, not centres: square k of the drawing begins at k * SQUARE.
    to_pixels = np.array([[scale, 0.08, 40.0], [-0.05, scale, 60.0], [1e-4, 5e-5, 1.0]])
    to_centers = np.array([[1, 0, -0.5], [0, 1, -0.5], [0, 0, 1.0]])
    between_centers = to_centers @ to_pixels @ np.linalg.inv(to_centers)
    # Drawn four times finer, then averaged: the warp itself must not alias.
    fine = np.array([[4, 0, 1.5], [0, 4, 1.5], [0, 0, 1.0]])
    image = cv2.warpPerspective(
        drawn, fine @ between_centers, (4 * 480, 4 * 400), flags=cv2.INTER_LINEAR, borderValue=255
    ).astype(np.float64)
    image = image.reshape(400, 4, 480, 4).mean((1, 3))
    image += np.random.default_rng(0).normal(0, noise, image.shape)
    scaled = to_pixels @ np.diag([SQUARE, SQUARE, 1.0])
    return np.clip(np.round(image), 0, 255).astype(np.uint8), scaled


def expected_corners(board, homography):
    corners = board.corners_m()[:, :2] / board.square_m
    return cv2.perspectiveTransform(corners[None], homography)[0]


@pytest.mark.parametrize("noise", [0.0, 4.0])
def test_corners_have_this_projects_pixel_centres(noise):
    board = Board(7, 5, 0.12, 0.09, "DICT_5X5_250")
    gray, homography = warped_board(board, noise=noise)
    found = detect_board(gray, board)
    error = found.pixels - expected_corners(board, homography)[found.ids]
    assert len(found.ids) == 24
    # A wrong pixel convention would show as a mean of 0.5.
    assert np.abs(error.mean(0)).max() < 0.03
    assert np.sqrt((error**2).sum(1).mean()) < 0.15


def test_boards_printed_before_opencv_4_6():
    board = Board(6, 4, 0.1, 0.075, "DICT_4X4_50")
    gray, homography = warped_board(board, legacy=True)
    assert len(detect_board(gray, board).ids) == 0
    assert detect_board(gray, board).markers > 0
    found = detect_board(gray, board, legacy=True)
    assert len(found.ids) == 15
    assert np.abs(found.pixels - expected_corners(board, homography)[found.ids]).max() < 0.5


def test_an_empty_image_has_no_board():
    found = detect_board(np.full((200, 300), 128, np.uint8), Board(7, 5, 0.12, 0.09, "DICT_5X5_250"))
    assert found.ids.shape == (0,)
    assert found.pixels.shape == (0, 2)
    assert found.markers == 0


def test_the_right_dictionary_is_named():
    gray, _ = warped_board(Board(7, 5, 0.12, 0.09, "DICT_5X5_250"))
    name, count = matching_dictionary([gray])
    # DICT_5X5_50, _100, _250 and _1000 share their first markers; the smallest that reads all 17 is named.
    assert name == "DICT_5X5_50"
    assert count == 17
    assert matching_dictionary([np.full((100, 100), 200, np.uint8)]) is None
