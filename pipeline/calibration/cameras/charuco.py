"""ChArUco boards in images: their corners, and what to tell a person when none is found."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float64, Int32, Int64, UInt8

from pipeline.base.conventions import PIXEL_CENTER


@dataclass(frozen=True)
class Board:
    """A ChArUco board; lengths in metres; `dictionary` is OpenCV's name, such as DICT_5X5_250.

    Its markers are numbered from `first_marker` on, so that several boards can share a dictionary.
    """

    squares_x: int
    squares_y: int
    square_m: float
    marker_m: float
    dictionary: str
    first_marker: int = 0

    def opencv(self, legacy: bool = False) -> cv2.aruco.CharucoBoard:
        """The board for OpenCV.

        `legacy`: the pattern printed before OpenCV 4.6, with a marker in the first corner.

        The two differ only where `squares_y` is even.
        """
        board = cv2.aruco.CharucoBoard(
            (self.squares_x, self.squares_y), self.square_m, self.marker_m, opencv_dictionary(self.dictionary),
            np.arange(self.first_marker, self.first_marker + self.squares_x * self.squares_y // 2),
        )  # fmt: skip
        board.setLegacyPattern(legacy)
        return board

    def corners_m(self) -> Float64[np.ndarray, "corners 3"]:
        """The inner corners in the board's frame, metres, z = 0."""
        return np.asarray(self.opencv().getChessboardCorners(), dtype=np.float64)


@dataclass(frozen=True)
class Detection:
    """One board in one image.

    Attributes:
        ids: the corners' numbers in `Board.corners_m`.
        pixels: where they are; first pixel centre at (0.5, 0.5).
        markers: number of the board's markers that were read, with or without corners.
    """

    ids: Int64[np.ndarray, " corners"]
    pixels: Float64[np.ndarray, "corners 2"]
    markers: int


def detect_boards(
    gray: UInt8[np.ndarray, "height width"], boards: Sequence[Board], legacy: Sequence[bool]
) -> list[Detection]:
    """Detect each board's inner corners to a fraction of a pixel.

    Empty arrays where a board is not seen.

    Args:
        legacy: per board, see `Board.opencv`.
    """
    read = {name: read_markers(gray, name) for name in dict.fromkeys(board.dictionary for board in boards)}
    return [_find_corners(gray, board, old, *read[board.dictionary]) for board, old in zip(boards, legacy, strict=True)]


def read_markers(
    gray: UInt8[np.ndarray, "height width"], dictionary: str
) -> tuple[list[np.ndarray], Int32[np.ndarray, " markers"]]:
    """Markers of a dictionary in an image.

    Their corners as OpenCV gives them, and their numbers.
    """
    # Marker corners refined first: a tenth less noise in the chessboard corners than without (captures/walker).
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    corners, ids, _ = cv2.aruco.ArucoDetector(opencv_dictionary(dictionary), parameters).detectMarkers(gray)
    return list(corners), np.zeros(0, np.int32) if ids is None else ids.ravel()


def _find_corners(
    gray: np.ndarray, board: Board, legacy: bool, corners: list[np.ndarray], ids: np.ndarray
) -> Detection:
    drawn = board.opencv(legacy)
    own = np.flatnonzero(np.isin(ids, drawn.getIds()))
    pixels, found = None, None
    if len(own):
        pixels, found, *_ = cv2.aruco.CharucoDetector(drawn).detectBoard(
            gray, markerCorners=[corners[k] for k in own], markerIds=ids[own]
        )
    if found is None or len(found) == 0:
        return Detection(np.zeros(0, np.int64), np.zeros((0, 2)), len(own))
    centered = pixels.reshape(-1, 2).astype(np.float64) + PIXEL_CENTER
    return Detection(found.ravel().astype(np.int64), centered, len(own))


def mirrored_markers(gray: UInt8[np.ndarray, "height width"], boards: Sequence[Board]) -> int:
    """Number of markers in the mirror image of an image, less those in itself.

    Of the boards' dictionaries.
    """
    names = {board.dictionary for board in boards}
    flipped = np.ascontiguousarray(gray[:, ::-1])
    return sum(len(read_markers(flipped, name)[1]) - len(read_markers(gray, name)[1]) for name in names)


def opencv_dictionary(name: str) -> cv2.aruco.Dictionary:
    """OpenCV's dictionary of a name such as DICT_5X5_250."""
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def dictionary_names() -> list[str]:
    """The names that `Board.dictionary` may have; of two names of one dictionary, the first."""
    names = sorted((name for name in dir(cv2.aruco) if name.startswith("DICT_")), reverse=True)
    return sorted({getattr(cv2.aruco, name): name for name in names}.values())


def matching_dictionary(images: Iterable[UInt8[np.ndarray, "height width"]]) -> tuple[str, int] | None:
    """Dictionary that reads most markers in `images`, and how many.

    The smallest of equals; None if none does.
    """
    images = list(images)
    counts = {}
    for name in dictionary_names():
        dictionary = opencv_dictionary(name)
        detector = cv2.aruco.ArucoDetector(dictionary)
        found = sum(0 if ids is None else len(ids) for _, ids, *_ in map(detector.detectMarkers, images))
        counts[name] = (found, -len(dictionary.bytesList))
    best = max(counts, key=lambda name: counts[name])
    return (best, counts[best][0]) if counts[best][0] else None
