"""Keys of calibration boards in `calibration.cameras`: what is printed on them, in metres."""

from __future__ import annotations

import re
from typing import Annotated, Any

import cv2
from pydantic import AfterValidator, Field, field_validator

from pipeline.capture.schema.sections import Length, Section

LARGEST_SQUARE_M = 1.0
"""No printed square is larger; any square above 1 cm is, if centimetres or millimetres are taken for metres."""


def _in_metres(length: float) -> float:
    if length > LARGEST_SQUARE_M:
        raise ValueError(f"metres, {LARGEST_SQUARE_M:g} at most (not centimetres or millimetres)")
    return length


BoardLength = Annotated[Length, AfterValidator(_in_metres)]


# `info` is pydantic's ValidationInfo: a protocol that run-time type checks cannot test for.
def fits_a_square(marker_m: float | None, info: Any) -> float | None:
    """Check a marker's side against `square_m`.

    Raises:
        ValueError: if it is not smaller; the message is what was expected.
    """
    square_m = info.data.get("square_m")
    if marker_m is not None and square_m is not None and marker_m >= square_m:
        raise ValueError(f"less than square_m, {square_m}")
    return marker_m


def holds_enough(dictionary: str | None, markers: int, first_marker: int) -> str | None:
    """Check that a dictionary is one of OpenCV's and has all markers of a board.

    Raises:
        ValueError: if not; the message is what was expected.
    """
    if dictionary is None:
        return None
    if not dictionary.startswith("DICT_") or not hasattr(cv2.aruco, dictionary):
        raise ValueError("a predefined dictionary of cv2.aruco, for instance DICT_5X5_250")
    held = len(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary)).bytesList)
    needed = first_marker + markers
    if needed > held:
        raise ValueError(f"a dictionary of at least {needed} markers for this board (this one has {held})")
    return dictionary


def holds_a_charuco_board(dictionary: str | None, info: Any) -> str | None:
    """Check a ChArUco board's dictionary: a marker lies in every other square."""
    markers = (info.data.get("squares_x") or 0) * (info.data.get("squares_y") or 0) // 2
    return holds_enough(dictionary, markers, info.data.get("first_marker") or 0)


class CharucoBoard(Section):
    """A ChArUco board: a chessboard with a marker in every white square."""

    squares_x: int = Field(ge=2, description="squares of the board in x")
    squares_y: int = Field(ge=2, description="squares of the board in y")
    square_m: BoardLength = Field(description="side of a square, metres")
    marker_m: BoardLength = Field(description="side of a marker, metres; smaller than the square")
    first_marker: int = Field(0, ge=0, description="number of the board's first marker; the others follow it")
    dictionary: str = Field(description="a predefined dictionary of cv2.aruco, for instance DICT_5X5_250")

    _check_marker = field_validator("marker_m")(fits_a_square)
    _check_dictionary = field_validator("dictionary")(holds_a_charuco_board)

    @property
    def markers(self) -> range:
        """Numbers of its markers."""
        return range(self.first_marker, self.first_marker + self.squares_x * self.squares_y // 2)


class TagGrid(Section):
    """A grid of AprilTags or ArUco markers that stand apart.

    Kalibr's aprilgrid, whose tags touch, is not read.
    """

    tags_x: int = Field(ge=1, description="tags of the grid in x")
    tags_y: int = Field(ge=1, description="tags of the grid in y")
    tag_m: BoardLength = Field(description="side of a tag's black square, metres")
    gap_m: BoardLength = Field(description="white between two tags, metres")
    first_tag: int = Field(0, ge=0, description="number of the tag at the top left; the others follow it row by row")
    dictionary: str = Field(
        "DICT_APRILTAG_36H11", description="a predefined dictionary of cv2.aruco", validate_default=True
    )

    @field_validator("dictionary")
    @classmethod
    def _check_dictionary(cls, dictionary: str, info: Any) -> str | None:
        tags = (info.data.get("tags_x") or 0) * (info.data.get("tags_y") or 0)
        return holds_enough(dictionary, tags, info.data.get("first_tag") or 0)

    @property
    def markers(self) -> range:
        """Numbers of its tags."""
        return range(self.first_tag, self.first_tag + self.tags_x * self.tags_y)


class Checkerboard(Section):
    """A chessboard without markers, all of which has to be in view."""

    squares_x: int = Field(ge=4, description="squares of the board in x, one more than inner corners")
    squares_y: int = Field(ge=4, description="squares of the board in y, one more than inner corners")
    square_m: BoardLength = Field(description="side of a square, metres")


class CircleGrid(Section):
    """A grid of black discs on white, all of which has to be in view."""

    circles_x: int = Field(ge=2, description="circles in a row")
    circles_y: int = Field(ge=3, description="rows of circles")
    spacing_m: BoardLength = Field(
        description="distance of two rows, metres; of an asymmetric grid half the distance of two circles of a row, too"
    )
    asymmetric: bool = Field(False, description="every other row, the second first, is moved to the right by spacing_m")

    @field_validator("circles_y")
    @classmethod
    def _is_no_square(cls, circles_y: int, info: Any) -> int:
        # Known only where circles_x is valid itself.
        if circles_y == info.data.get("circles_x"):
            raise ValueError("another number than circles_x: a square grid looks the same from four sides")
        return circles_y


def check_markers(boards: list[CharucoBoard | TagGrid]) -> None:
    """Check that no two boards share a marker.

    Raises:
        ValueError: if they do; the message is what was expected.
    """
    taken: dict[tuple[str, int], int] = {}
    for number, board in enumerate(boards):
        # DICT_5X5_50 is the beginning of DICT_5X5_250.
        family = re.sub(r"_\d+$", "", board.dictionary)
        for marker in board.markers:
            if (other := taken.setdefault((family, marker), number)) != number:
                raise ValueError(
                    f"boards that share no marker: boards {other} and {number} (counted from 0) both have marker "
                    f"{marker} of {family}; set first_marker"
                )
