"""Board detection on boards drawn by OpenCV and warped by a known homography."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from pipeline.calibration.cameras.board_identity import matching_dictionary
from pipeline.calibration.cameras.board_views import mirrored_markers
from pipeline.calibration.cameras.boards import BoardPhoto, detect_boards, dictionary_names, read_markers
from pipeline.calibration.cameras.charuco import CharucoBoard

SQUARE = 80
"""Pixels per square of the drawn board: a multiple of 8, so that no line of a marker is rounded."""


def warped_board(board, scale=0.6, noise=0.0):
    """A board drawn large, warped; and the homography from board squares to this project's pixels."""
    size = (board.squares_x * SQUARE, board.squares_y * SQUARE)
    drawn = board.opencv().generateImage(size, marginSize=0, borderBits=1)
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


def detect_board(gray, board):
    return detect_boards(gray, [board])[0]


def expected_corners(board, homography):
    corners = board.corners_m()[:, :2] / board.square_m
    return cv2.perspectiveTransform(corners[None], homography)[0]


@pytest.mark.parametrize("noise", [0.0, 4.0])
def test_corners_have_this_projects_pixel_centres(noise):
    board = CharucoBoard(7, 5, 0.12, 0.09, "DICT_5X5_250")
    gray, homography = warped_board(board, noise=noise)
    found = detect_board(gray, board)
    error = found.pixels - expected_corners(board, homography)[found.ids]
    assert len(found.ids) == 24
    # A wrong pixel convention would show as a mean of 0.5.
    assert np.abs(error.mean(0)).max() < 0.03
    assert np.sqrt((error**2).sum(1).mean()) < 0.15


def test_boards_printed_before_opencv_4_6():
    board = CharucoBoard(6, 4, 0.1, 0.075, "DICT_4X4_50")
    gray, homography = warped_board(replace(board, legacy=True))
    assert len(detect_board(gray, board).ids) == 0
    assert detect_board(gray, board).markers > 0
    found = detect_board(gray, replace(board, legacy=True))
    assert len(found.ids) == 15
    assert np.abs(found.pixels - expected_corners(board, homography)[found.ids]).max() < 0.5


def test_an_empty_image_has_no_board():
    found = detect_board(np.full((200, 300), 128, np.uint8), CharucoBoard(7, 5, 0.12, 0.09, "DICT_5X5_250"))
    assert found.ids.shape == (0,)
    assert found.pixels.shape == (0, 2)
    assert found.markers == 0


def test_the_right_dictionary_is_named():
    gray, _ = warped_board(CharucoBoard(7, 5, 0.12, 0.09, "DICT_5X5_250"))
    name, inverted, count = matching_dictionary([BoardPhoto(gray)], (), dictionary_names())
    # DICT_5X5_50, _100, _250 and _1000 share their first markers; the smallest that reads all 17 is named.
    assert name == "DICT_5X5_50"
    assert not inverted
    assert count == 17
    assert matching_dictionary([BoardPhoto(np.full((100, 100), 200, np.uint8))], (), dictionary_names()) is None


def side_by_side(boards):
    """Boards next to each other in one image, and where their corners are."""
    drawn = [warped_board(board) for board in boards]
    image = np.concatenate([gray for gray, _ in drawn], 1)
    homographies = [np.array([[1, 0, 480.0 * k], [0, 1, 0], [0, 0, 1]]) @ h for k, (_, h) in enumerate(drawn)]
    corners = [expected_corners(board, homography) for board, homography in zip(boards, homographies, strict=True)]
    return image, corners


def test_two_boards_of_one_dictionary_are_told_apart_by_their_markers():
    boards = [
        CharucoBoard(7, 5, 0.12, 0.09, "DICT_5X5_250"),
        CharucoBoard(7, 5, 0.12, 0.09, "DICT_5X5_250", first_marker=17),
    ]
    image, corners = side_by_side(boards)
    for detection, expected in zip(detect_boards(image, boards), corners, strict=True):
        assert len(detection.ids) == 24
        assert detection.markers == 17
        assert np.abs(detection.pixels - expected[detection.ids]).max() < 0.3


def test_boards_of_two_dictionaries_in_one_image():
    boards = [
        CharucoBoard(5, 6, 0.1, 0.07, "DICT_4X4_50"),
        CharucoBoard(7, 5, 0.12, 0.09, "DICT_6X6_100", first_marker=3),
    ]
    image, corners = side_by_side(boards)
    for detection, expected in zip(detect_boards(image, boards), corners, strict=True):
        assert len(detection.ids) == len(expected)
        assert np.abs(detection.pixels - expected[detection.ids]).max() < 0.3


def test_a_board_partly_outside_the_image_keeps_its_own_corners():
    board = CharucoBoard(7, 5, 0.12, 0.09, "DICT_5X5_250")
    gray, homography = warped_board(board)
    half = np.ascontiguousarray(gray[:, :220])
    found, expected = detect_board(half, board), expected_corners(board, homography)
    assert 6 <= len(found.ids) < 24
    assert np.abs(found.pixels - expected[found.ids]).max() < 0.5


def test_a_mirrored_board_is_read_in_the_mirror():
    board = CharucoBoard(7, 5, 0.12, 0.09, "DICT_5X5_250")
    gray, _ = warped_board(board)
    mirrored = np.ascontiguousarray(gray[:, ::-1])
    assert len(detect_board(mirrored, board).ids) == 0
    assert mirrored_markers(mirrored, [board]) >= 15
    assert mirrored_markers(gray, [board]) <= -15


def test_own_markers_are_read_as_among_all_of_their_dictionary():
    """Searching for a board's own numbers saves time, and finds the same corners to the bit."""
    board = CharucoBoard(7, 5, 0.12, 0.09, "DICT_5X5_1000", first_marker=40)
    image, _ = side_by_side([replace(board, first_marker=3), board])
    noisy = np.clip(image + np.random.default_rng(0).normal(0, 8, image.shape), 0, 255).astype(np.uint8)
    corners, ids = read_markers(noisy, "DICT_5X5_1000")
    own = {int(number): corner for number, corner in zip(ids, corners, strict=True) if number in board.markers}
    corners, ids = read_markers(noisy, "DICT_5X5_1000", board.markers)
    assert len(own) == 17 and sorted(ids.tolist()) == sorted(own)
    for number, corner in zip(ids.tolist(), corners, strict=True):
        np.testing.assert_array_equal(corner, own[number])
