"""Boards without markers: checkerboards, and grids of circles. All of a board has to be in view."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32, Float64, Int64

from pipeline.base.conventions import PIXEL_CENTER
from pipeline.calibration.cameras.boards import NOTHING, Board, BoardPhoto, Detection

REFINED_WITHIN = (2, 8)
"""Half of the side of the window in which a corner is refined, pixels: a quarter of a square, but no more than that
edges are straight in it."""

REFINED_UNTIL = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 40, 1e-3)


@dataclass(frozen=True)
class Checkerboard(Board):
    """A chessboard; its points are the inner corners, row by row; the first square is black.

    Half a turn makes the first square white if one of `squares_x` and `squares_y` is odd and the other even: such a
    board is always numbered from the same corner. Any other looks the same upside down.
    """

    squares_x: int
    squares_y: int
    square_m: float

    def corners_m(self) -> Float64[np.ndarray, "corners 3"]:
        """The inner corners, from the outer corner of the first square."""
        return self.square_m * (np.array([1.0, 1.0, 0.0]) + _rows_of(self.squares_x - 1, self.squares_y - 1))

    def detect(self, photo: BoardPhoto) -> Detection:
        """Find all inner corners, by Duda and Frese (2018), and refine them by the edges' gradients.

        The second step leaves a third of the error of the first (tests/unit/calibration/cameras/test_boards.py).
        """
        gray, size = photo.seen_by(self), (self.squares_x - 1, self.squares_y - 1)
        flags = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_NORMALIZE_IMAGE
        found, corners = cv2.findChessboardCornersSB(gray, size, flags=flags)
        if not found:
            return NOTHING
        grid = _refined(gray, corners.reshape(size[1], size[0], 2))
        turns = [grid, grid[::-1, ::-1]]
        if size[0] == size[1]:
            turns += [np.rot90(grid), np.rot90(grid, 3)]
        grid = max(map(_unmirrored, turns), key=lambda turn: _black_first(gray, turn))
        return Detection(np.arange(size[0] * size[1]), grid.reshape(-1, 2) + PIXEL_CENTER)

    def describe(self) -> str:
        """Squares."""
        return f"checkerboard of {self.squares_x} x {self.squares_y} squares" + ", inverted" * self.inverted

    def half_turn(self) -> Int64[np.ndarray, " corners"] | None:
        """The numbers in reverse, where both or neither of the numbers of squares are odd."""
        same = (self.squares_x + self.squares_y) % 2 == 0
        return np.arange((self.squares_x - 1) * (self.squares_y - 1))[::-1].copy() if same else None


@dataclass(frozen=True)
class CircleGrid(Board):
    """A grid of black discs; its points are their centres, row by row from the top left.

    An asymmetric grid has every other row moved to the right by half the distance of its discs, the second one first;
    `spacing_m` is then half that distance, which is also the distance of the rows (OpenCV's convention).

    What is found is the middle of a disc's image. In a slanted view that is not the image of its middle: off by about
    its radius squared over the focal length times the slope, a few hundredths of a pixel for discs of 20 pixels.
    """

    circles_x: int
    circles_y: int
    spacing_m: float
    asymmetric: bool = False

    def corners_m(self) -> Float64[np.ndarray, "corners 3"]:
        """The centres in the board's frame, whose origin is the first."""
        points = _rows_of(self.circles_x, self.circles_y)
        if self.asymmetric:
            points[:, 0] = 2 * points[:, 0] + points[:, 1] % 2
        return points * self.spacing_m

    def detect(self, photo: BoardPhoto) -> Detection:
        """Find all centres."""
        gray, size = photo.seen_by(self), (self.circles_x, self.circles_y)
        kind = cv2.CALIB_CB_ASYMMETRIC_GRID if self.asymmetric else cv2.CALIB_CB_SYMMETRIC_GRID
        found, centers = cv2.findCirclesGrid(gray, size, flags=kind | cv2.CALIB_CB_CLUSTERING)
        if not found:
            found, centers = cv2.findCirclesGrid(gray, size, flags=kind)
        if not found:
            return NOTHING
        grid = centers.reshape(size[1], size[0], 2).astype(np.float64)
        if not self.asymmetric:
            grid = _unmirrored(grid)
        return Detection(np.arange(size[0] * size[1]), grid.reshape(-1, 2) + PIXEL_CENTER)

    def describe(self) -> str:
        """Circles."""
        kind = "asymmetric grid" if self.asymmetric else "grid"
        return f"{kind} of {self.circles_x} x {self.circles_y} circles" + ", inverted" * self.inverted

    def half_turn(self) -> Int64[np.ndarray, " corners"] | None:
        """The numbers in reverse.

        An asymmetric grid of an odd number of rows looks different upside down.
        """
        if self.asymmetric and self.circles_y % 2 == 1:
            return None
        return np.arange(self.circles_x * self.circles_y)[::-1].copy()


def _rows_of(x: int, y: int) -> Float64[np.ndarray, "points 3"]:
    """Whole numbers (x, y, 0), row by row."""
    rows, columns = np.divmod(np.arange(x * y), x)
    return np.stack([columns, rows, np.zeros(x * y)], 1).astype(np.float64)


def _refined(gray: np.ndarray, grid: Float32[np.ndarray, "rows columns 2"]) -> Float64[np.ndarray, "rows columns 2"]:
    """Corners refined in windows that hold no other corner."""
    spacing = min(np.linalg.norm(np.diff(grid, axis=axis), axis=-1).min() for axis in (0, 1))
    half = int(np.clip(spacing / 4, *REFINED_WITHIN))
    refined = cv2.cornerSubPix(gray, grid.reshape(-1, 1, 2).copy(), (half, half), (-1, -1), REFINED_UNTIL)
    return refined.reshape(grid.shape).astype(np.float64)


def _unmirrored(grid: Float64[np.ndarray, "rows columns 2"]) -> Float64[np.ndarray, "rows columns 2"]:
    """The grid with its rows in reverse if it is seen from behind: x right, y down turn clockwise."""
    along, down = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    return grid if along[0] * down[1] - along[1] * down[0] > 0 else grid[::-1]


def _black_first(gray: np.ndarray, grid: Float64[np.ndarray, "rows columns 2"]) -> float:
    """Brightness of the inner squares that should be white, less that of those that should be black."""
    middle = (grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:]) / 4
    at = np.clip(np.round(middle).astype(int), 0, np.array(gray.shape[::-1]) - 1)
    value = gray[at[..., 1], at[..., 0]].astype(np.float64)
    rows, columns = np.indices(value.shape)
    black = (rows + columns) % 2 == 0
    # A single square has no other to be compared with: then the first is the darker by definition.
    return float(value[~black].mean() - value[black].mean()) if (~black).any() else 0.0
