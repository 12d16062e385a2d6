"""Boards of every kind in photographs through a known lens: corners against projections by OpenCV."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.calibration.cameras.boards import detect_boards
from pipeline.calibration.cameras.charuco import CharucoBoard
from pipeline.calibration.cameras.plain_grids import Checkerboard, CircleGrid
from pipeline.calibration.cameras.tag_grids import TagGrid
from tests.support.drawings.printed_boards import (
    photograph,
    print_charuco,
    print_checkerboard,
    print_circles,
    print_tags,
    true_pixels,
)

TURN, SHIFT = [0.25, -0.3, 0.1], [-0.15, -0.1, 0.6]
UPSIDE_DOWN = [0.0, 0.0, np.pi]


def grid(x, y, spacing):
    """Points (x, y) row by row, as a person would number a board."""
    return np.array([[spacing * i, spacing * j] for j in range(y) for i in range(x)])


def errors(board, gray, points_m, turn=TURN, shift=SHIFT):
    """Pixels between what is detected and the truth, of all points."""
    (found,) = detect_boards(gray, [board])
    assert sorted(found.ids.tolist()) == list(range(len(points_m)))
    return found.pixels - true_pixels(points_m, turn, shift)[found.ids]


def is_near(error, most_px=0.5, rms_px=0.15):
    # A wrong pixel convention would show as a mean of 0.5.
    assert np.abs(error.mean(0)).max() < 0.06
    assert np.abs(error).max() < most_px
    assert np.sqrt((error**2).sum(1).mean()) < rms_px


@pytest.mark.parametrize("inverted", [False, True])
@pytest.mark.parametrize("legacy", [False, True])
def test_charuco_boards_in_all_prints(inverted, legacy):
    board = CharucoBoard(7, 6, 0.04, 0.03, "DICT_4X4_50", legacy=legacy, inverted=inverted)
    gray = photograph(print_charuco(7, 6, 0.04, 0.03, "DICT_4X4_50", legacy), TURN, SHIFT, inverted=inverted)
    is_near(errors(board, gray, grid(6, 5, 0.04) + 0.04))
    assert np.abs(board.corners_m()[:, :2] - (grid(6, 5, 0.04) + 0.04)).max() < 1e-6
    for other in board.variants()[1:]:
        assert len(detect_boards(gray, [other])[0].ids) == 0


@pytest.mark.parametrize("inverted", [False, True])
@pytest.mark.parametrize("dictionary", ["DICT_APRILTAG_36H11", "DICT_4X4_50"])
def test_grids_of_tags(inverted, dictionary):
    board = TagGrid(4, 3, 0.06, 0.02, dictionary, inverted=inverted)
    corners = np.array([[x + i, y + j] for x, y in grid(4, 3, 0.08) for i, j in 0.06 * board_corners()])
    gray = photograph(print_tags(4, 3, 0.06, 0.02, dictionary), TURN, SHIFT, inverted=inverted)
    is_near(errors(board, gray, corners), rms_px=0.3)
    assert board.corners_m()[:, :2] == pytest.approx(corners)


def board_corners():
    """Clockwise from the top left."""
    return np.array([[0, 0], [1, 0], [1, 1], [0, 1]])


@pytest.mark.parametrize("inverted", [False, True])
def test_checkerboards(inverted):
    board = Checkerboard(8, 5, 0.04, inverted=inverted)
    gray = photograph(print_checkerboard(8, 5, 0.04), TURN, SHIFT, inverted=inverted)
    is_near(errors(board, gray, grid(7, 4, 0.04) + 0.04), rms_px=0.08)
    assert board.corners_m()[:, :2] == pytest.approx(grid(7, 4, 0.04) + 0.04)


@pytest.mark.parametrize("turn", [[0.1, 0.1, a] for a in (0.0, 1.5, 3.1, -1.5)])
def test_an_odd_checkerboard_is_numbered_from_its_black_corner(turn):
    center = np.array([0.16, 0.1])
    shift = np.array([0.0, 0.0, 0.75])
    shift[:2] -= [np.cos(turn[2]) * center[0] - np.sin(turn[2]) * center[1],
                  np.sin(turn[2]) * center[0] + np.cos(turn[2]) * center[1]]  # fmt: skip
    gray = photograph(print_checkerboard(8, 5, 0.04), turn, shift)
    is_near(errors(Checkerboard(8, 5, 0.04), gray, grid(7, 4, 0.04) + 0.04, turn, shift), rms_px=0.08)
    assert Checkerboard(8, 5, 0.04).half_turn() is None


@pytest.mark.parametrize("inverted", [False, True])
@pytest.mark.parametrize("asymmetric", [False, True])
def test_circle_grids(inverted, asymmetric):
    if asymmetric:
        board = CircleGrid(4, 11, 0.02, True, inverted=inverted)
        points = np.array([[0.02 * (2 * i + j % 2), 0.02 * j] for j in range(11) for i in range(4)])
    else:
        board = CircleGrid(7, 5, 0.04, inverted=inverted)
        points = grid(7, 5, 0.04)
    page, margin_m = print_circles(points, 0.008)
    gray = photograph(page, TURN, [-0.1, -0.1, 0.6], margin_m, inverted=inverted)
    # The middle of a disc's image is not the image of its middle: 0.1 px for discs of 16 px so close and slanted.
    error = errors(board, gray, points, shift=[-0.1, -0.1, 0.6])
    if not asymmetric and np.abs(error).max() > 10:
        # Which way up a symmetric grid is, nothing in it tells.
        error = errors(board, gray, points[board.half_turn()], shift=[-0.1, -0.1, 0.6])
    is_near(error, rms_px=0.25)
    assert board.corners_m()[:, :2] == pytest.approx(points)


def test_an_empty_image_has_no_board_of_any_kind():
    gray = np.full((200, 300), 128, np.uint8)
    boards = [
        CharucoBoard(7, 5, 0.12, 0.09, "DICT_5X5_250"),
        TagGrid(4, 3, 0.06, 0.02),
        Checkerboard(8, 5, 0.04),
        CircleGrid(7, 5, 0.04),
    ]
    for found in detect_boards(gray, boards):
        assert found.ids.shape == (0,)
        assert found.pixels.shape == (0, 2)


@pytest.mark.parametrize(
    ("board", "same"),
    [
        (Checkerboard(8, 6, 0.04), True),
        (Checkerboard(7, 5, 0.04), True),
        (CircleGrid(7, 5, 0.04), True),
        (CircleGrid(4, 10, 0.02, True), True),
        (CircleGrid(4, 11, 0.02, True), False),
    ],
)
def test_boards_that_look_the_same_upside_down_say_so(board, same):
    """Half a turn about the middle maps the points onto themselves, and what is printed as well."""
    turned = board.half_turn()
    assert (turned is not None) == same
    if same:
        points = board.corners_m()[:, :2]
        middle = (points.min(0) + points.max(0)) / 2
        assert 2 * middle - points == pytest.approx(points[turned])


def test_variants_differ_in_print_alone():
    board = CharucoBoard(4, 5, 0.04, 0.03, "DICT_4X4_50")
    assert board.variants() == [board, replace(board, inverted=True)]
    assert len(CharucoBoard(4, 6, 0.04, 0.03, "DICT_4X4_50").variants()) == 4
