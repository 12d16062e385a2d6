"""Calibration boards: planar patterns of known points, whatever is printed between them.

A kind of board is one class: `charuco`, `tag_grids` and `plain_grids` have those that there are.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import cv2
import numpy as np
from jaxtyping import Float64, Int32, Int64, UInt8

Markers = tuple[list[np.ndarray], Int32[np.ndarray, " markers"]]
"""Markers in an image: their corners as OpenCV gives them, and their numbers."""


@dataclass(frozen=True)
class Detection:
    """One board in one image.

    Attributes:
        ids: the corners' numbers in `Board.corners_m`.
        pixels: where they are; first pixel centre at (0.5, 0.5).
        markers: number of the board's markers that were read, with or without corners; 0 for boards without any.
    """

    ids: Int64[np.ndarray, " corners"]
    pixels: Float64[np.ndarray, "corners 2"]
    markers: int = 0


@dataclass(frozen=True)
class BoardPhoto:
    """One image, and the markers read in it: once for all boards of a dictionary.

    Attributes:
        boards: those whose markers alone are read, as each number costs time; where there are none, all are.
    """

    gray: UInt8[np.ndarray, "height width"]
    boards: Sequence[Board] = ()

    @cached_property
    def negative(self) -> UInt8[np.ndarray, "height width"]:
        """The image with black and white exchanged."""
        return 255 - self.gray

    def seen_by(self, board: Board) -> UInt8[np.ndarray, "height width"]:
        """The image in which a board is black on white."""
        return self.negative if board.inverted else self.gray

    @cached_property
    def _read(self) -> dict[tuple[str, bool], Markers]:
        return {}

    def markers(self, dictionary: str, inverted: bool) -> Markers:
        """Markers of a dictionary, black on white or `inverted`."""
        if (key := (dictionary, inverted)) not in self._read:
            numbers = sorted({n for board in self.boards if board.markers_of == dictionary for n in board.markers})
            self._read[key] = read_markers(self.negative if inverted else self.gray, dictionary, numbers)
        return self._read[key]


@dataclass(frozen=True, kw_only=True)
class Board(ABC):
    """A planar board in the plane z = 0 of its own frame: x right, y down, seen from in front.

    Attributes:
        inverted: printed white on black.
    """

    inverted: bool = False

    @abstractmethod
    def corners_m(self) -> Float64[np.ndarray, "corners 3"]:
        """The points that are detected, in the board's frame, metres, z = 0."""

    @abstractmethod
    def detect(self, photo: BoardPhoto) -> Detection:
        """Find the board's points to a fraction of a pixel; empty arrays where it is not seen."""

    @abstractmethod
    def describe(self) -> str:
        """The board in words, without lengths: 4 x 5 squares, DICT_4X4_50, inverted."""

    def variants(self) -> list[Board]:
        """Boards of the same declaration that may have been printed in its place, itself first."""
        return [self, replace(self, inverted=not self.inverted)]

    def half_turn(self) -> Int64[np.ndarray, " corners"] | None:
        """Numbers of the points after half a turn, for a board that looks the same then.

        None for others.
        """
        return None

    @property
    def markers_of(self) -> str | None:
        """Dictionary of the board's markers; None for a board without markers."""
        return None

    @property
    def markers(self) -> range:
        """Numbers of the board's markers in their dictionary."""
        return range(0)


def detect_boards(gray: UInt8[np.ndarray, "height width"], boards: Sequence[Board]) -> list[Detection]:
    """Detect each board's points to a fraction of a pixel."""
    photo = BoardPhoto(gray, boards)
    return [board.detect(photo) for board in boards]


def read_markers(gray: UInt8[np.ndarray, "height width"], dictionary: str, numbers: Sequence[int] = ()) -> Markers:
    """Markers of a dictionary in an image, black on white: those of some numbers, or all."""
    # Marker corners refined first: a tenth less noise in the chessboard corners than without (captures/walker).
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    whole = opencv_dictionary(dictionary)
    asked = np.array(numbers or range(len(whole.bytesList)), np.int32)
    part = cv2.aruco.Dictionary(whole.bytesList[asked], whole.markerSize, whole.maxCorrectionBits)
    corners, ids, _ = cv2.aruco.ArucoDetector(part, parameters).detectMarkers(gray)
    return list(corners), np.zeros(0, np.int32) if ids is None else asked[ids.ravel()]


def opencv_dictionary(name: str) -> cv2.aruco.Dictionary:
    """OpenCV's dictionary of a name such as DICT_5X5_250."""
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


@cache
def dictionary_names() -> list[str]:
    """The names that a dictionary may have; of two names of one dictionary, the first."""
    names = sorted((name for name in dir(cv2.aruco) if name.startswith("DICT_")), reverse=True)
    return sorted({getattr(cv2.aruco, name): name for name in names}.values())


NOTHING = Detection(np.zeros(0, np.int64), np.zeros((0, 2)))
"""A board that is not seen."""
