"""Finding ChArUco boards in images, and what to tell a person when none is found."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float64, Int64, UInt8

from pipeline.base.conventions import PIXEL_CENTER


@dataclass(frozen=True)
class Board:
    """A ChArUco board; lengths in metres; `dictionary` is OpenCV's name, such as DICT_5X5_250."""

    squares_x: int
    squares_y: int
    square_m: float
    marker_m: float
    dictionary: str

    def opencv(self, legacy: bool = False) -> cv2.aruco.CharucoBoard:
        """The board for OpenCV; `legacy`: the pattern printed before OpenCV 4.6, with a marker in the first corner.

        The two differ only where `squares_y` is even.
        """
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        board = cv2.aruco.CharucoBoard((self.squares_x, self.squares_y), self.square_m, self.marker_m, dictionary)
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
        markers: number of markers of the dictionary that were read, with or without corners.
    """

    ids: Int64[np.ndarray, " corners"]
    pixels: Float64[np.ndarray, "corners 2"]
    markers: int


def detect_board(gray: UInt8[np.ndarray, "height width"], board: Board, legacy: bool = False) -> Detection:
    """Detect the board's inner corners to a fraction of a pixel; empty arrays if it is not seen."""
    # Marker corners refined first: a tenth less noise in the chessboard corners than without (captures/walker).
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    detector = cv2.aruco.CharucoDetector(board.opencv(legacy), cv2.aruco.CharucoParameters(), parameters)
    corners, ids, _, marker_ids = detector.detectBoard(gray)
    markers = 0 if marker_ids is None else len(marker_ids)
    if ids is None or len(ids) == 0:
        return Detection(np.zeros(0, np.int64), np.zeros((0, 2)), markers)
    pixels = corners.reshape(-1, 2).astype(np.float64) + PIXEL_CENTER
    return Detection(ids.ravel().astype(np.int64), pixels, markers)


def dictionary_names() -> list[str]:
    """The names that `Board.dictionary` may have; of two names of one dictionary, the first."""
    names = sorted((name for name in dir(cv2.aruco) if name.startswith("DICT_")), reverse=True)
    return sorted({getattr(cv2.aruco, name): name for name in names}.values())


def matching_dictionary(images: Iterable[UInt8[np.ndarray, "height width"]]) -> tuple[str, int] | None:
    """The dictionary that reads most markers in `images` and how many; the smallest of equals; None if none does."""
    images = list(images)
    counts = {}
    for name in dictionary_names():
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
        detector = cv2.aruco.ArucoDetector(dictionary)
        found = sum(0 if ids is None else len(ids) for _, ids, *_ in map(detector.detectMarkers, images))
        counts[name] = (found, -len(dictionary.bytesList))
    best = max(counts, key=lambda name: counts[name])
    return (best, counts[best][0]) if counts[best][0] else None
