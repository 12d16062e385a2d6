"""Boards that are not what was declared are told: dictionary, size, pattern, inverted or not."""

import pytest

from pipeline.calibration.cameras.board_identity import identify_board
from pipeline.calibration.cameras.charuco import CharucoBoard
from pipeline.calibration.cameras.plain_grids import Checkerboard
from tests.support.drawings.printed_boards import photograph, print_charuco, print_checkerboard, print_tags

DECLARED = CharucoBoard(9, 6, 0.03, 0.02, "DICT_4X4_1000")


def photographs(page, inverted=False):
    """One is enough: a layout that several boards fit is told as none."""
    return [photograph(page, [0.25, -0.3, 0.1], [-0.15, -0.12, 0.65], inverted=inverted)]


@pytest.mark.parametrize(
    ("x", "y", "dictionary", "legacy", "inverted", "told"),
    [
        (4, 5, "DICT_4X4_1000", False, True, "4 x 5 squares, DICT_4X4_1000, inverted"),
        (7, 5, "DICT_5X5_250", False, False, "7 x 5 squares, DICT_5X5_50"),
        (6, 6, "DICT_6X6_100", True, False, "6 x 6 squares, DICT_6X6_50, legacy pattern"),
        (5, 6, "DICT_4X4_1000", True, True, "5 x 6 squares, DICT_4X4_1000, legacy pattern, inverted"),
        (8, 5, "DICT_ARUCO_ORIGINAL", False, False, "8 x 5 squares, DICT_ARUCO_ORIGINAL"),
    ],
)
def test_charuco_boards_of_other_sizes_and_dictionaries(x, y, dictionary, legacy, inverted, told):
    page = print_charuco(x, y, 0.04, 0.03, dictionary, legacy)
    assert identify_board(photographs(page, inverted), [DECLARED]).describe() == told


def test_a_board_of_smaller_markers():
    page = print_charuco(7, 5, 0.04, 0.025, "DICT_5X5_250")
    assert identify_board(photographs(page), [DECLARED]).describe() == "7 x 5 squares, DICT_5X5_50"


def test_a_grid_of_tags_instead_of_a_charuco_board():
    page = print_tags(5, 3, 0.045, 0.015, "DICT_APRILTAG_36H11")
    assert identify_board(photographs(page), [DECLARED]).describe() == "5 x 3 tags, DICT_APRILTAG_36H11"


def test_a_checkerboard_of_another_size():
    found = identify_board(photographs(print_checkerboard(8, 5, 0.04)), [Checkerboard(10, 7, 0.025)])
    assert found.describe() in ("checkerboard of 8 x 5 squares", "checkerboard of 5 x 8 squares")


def test_a_table_without_a_board():
    page = print_checkerboard(1, 1, 0.2) * 0 + 150
    assert identify_board(photographs(page), [DECLARED]) is None
