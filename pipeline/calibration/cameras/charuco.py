"""ChArUco boards: a chessboard with a marker in every white square.

Parts of it will do.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float64

from pipeline.base.conventions import PIXEL_CENTER
from pipeline.calibration.cameras.boards import Board, BoardPhoto, Detection, opencv_dictionary


@dataclass(frozen=True)
class CharucoBoard(Board):
    """A ChArUco board; lengths in metres; `dictionary` is OpenCV's name, such as DICT_5X5_250.

    Its markers are numbered from `first_marker` on, so that several boards can share a dictionary.

    Attributes:
        legacy: the pattern printed before OpenCV 4.6, with a marker in the first corner; the two differ only where
            `squares_y` is even.
    """

    squares_x: int
    squares_y: int
    square_m: float
    marker_m: float
    dictionary: str
    first_marker: int = 0
    legacy: bool = False

    def opencv(self) -> cv2.aruco.CharucoBoard:
        """The board for OpenCV, black on white."""
        board = cv2.aruco.CharucoBoard(
            (self.squares_x, self.squares_y), self.square_m, self.marker_m, opencv_dictionary(self.dictionary),
            np.array(self.markers),
        )  # fmt: skip
        board.setLegacyPattern(self.legacy)
        return board

    def corners_m(self) -> Float64[np.ndarray, "corners 3"]:
        """The inner corners in the board's frame, metres, z = 0."""
        return np.asarray(self.opencv().getChessboardCorners(), dtype=np.float64)

    def detect(self, photo: BoardPhoto) -> Detection:
        """Find the inner corners between the markers that are read."""
        drawn = self.opencv()
        corners, ids = photo.markers(self.dictionary, self.inverted)
        own = np.flatnonzero(np.isin(ids, drawn.getIds()))
        pixels, found = None, None
        if len(own):
            pixels, found, *_ = cv2.aruco.CharucoDetector(drawn).detectBoard(
                photo.seen_by(self), markerCorners=[corners[k] for k in own], markerIds=ids[own]
            )
        if found is None or len(found) == 0:
            return Detection(np.zeros(0, np.int64), np.zeros((0, 2)), len(own))
        centered = pixels.reshape(-1, 2).astype(np.float64) + PIXEL_CENTER
        return Detection(found.ravel().astype(np.int64), centered, len(own))

    def describe(self) -> str:
        """Squares, dictionary, and how it differs from OpenCV's drawing of today."""
        more = [f"markers from {self.first_marker}"] * (self.first_marker > 0)
        more += ["legacy pattern"] * self.legacy + ["inverted"] * self.inverted
        return ", ".join([f"{self.squares_x} x {self.squares_y} squares", self.dictionary, *more])

    def variants(self) -> list[Board]:
        """Inverted and legacy prints of the board."""
        both = super().variants()
        return both + [replace(board, legacy=not board.legacy) for board in both if self.squares_y % 2 == 0]

    @property
    def markers_of(self) -> str:
        """The dictionary."""
        return self.dictionary

    @property
    def markers(self) -> range:
        """One number for each white square."""
        return range(self.first_marker, self.first_marker + self.squares_x * self.squares_y // 2)
