"""Places of boards and mirror balls, found again from images and residuals.

No stage keeps them.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from jaxtyping import Float64

from pipeline.calibration.lights.mirror_ball import locate_ball
from pipeline.geometry.cameras import Camera
from pipeline.geometry.triangulation import triangulate

SAME_POINT_PX = 1.0
"""Projections of one corner of the fitted board agree to rounding; a pixel is far more."""

MOST_BOARDS = 60
"""Boards located: more would hide each other in the picture, and take minutes on large rigs."""

FEWEST_CORNERS = 3
"""Corners that span an area."""

Outlines = dict[tuple[str, str], Float64[np.ndarray, "points 2"]]
"""(position, camera) -> outline of the ball in the camera's image."""


def locate_balls(
    outlines: Outlines, cameras: Mapping[str, Camera], radius_m: float
) -> dict[str, Float64[np.ndarray, "3"]]:
    """Centre of the ball at each position, in the frame of `cameras`."""
    centers = {}
    for position in sorted({position for position, _ in outlines}):
        seen = {camera: outline for (p, camera), outline in outlines.items() if p == position}
        centers[position] = locate_ball([cameras[name] for name in seen], list(seen.values()), radius_m).center
    return centers


def locate_boards(corners: pd.DataFrame, cameras: Mapping[str, Camera]) -> list[Float64[np.ndarray, "corners 3"]]:
    """Corners of boards, triangulated from their projections by the fit.

    Two cameras have to see them. Of more than `MOST_BOARDS` views of boards, at most so many are chosen, evenly over
    their numbers.

    Args:
        corners: residuals_cameras.parquet.
    """
    names = list(cameras)
    shown = corners[["view", "board"]].drop_duplicates().sort_values(["view", "board"])
    step = max(1, -(-len(shown) // MOST_BOARDS))
    corners = corners.merge(shown[::step])
    point, index = pd.factorize(pd.MultiIndex.from_frame(corners[["view", "board", "corner"]]))
    observed = np.full((len(names), len(index), 2), np.nan)
    projected = (corners[["x", "y"]].to_numpy() + corners[["residual_x", "residual_y"]].to_numpy()).astype(np.float64)
    row = corners.camera.map(names.index).to_numpy(np.int64)
    for c, name in enumerate(names):
        observed[c, point[row == c]] = cameras[name].undistort(projected[row == c])
    confidence = np.ones(observed.shape[:2])
    places = triangulate(list(cameras.values()), observed, confidence, SAME_POINT_PX).points
    table = pd.DataFrame(places, columns=["x", "y", "z"], index=index).dropna().sort_index()
    boards = [rows.to_numpy(np.float64) for _, rows in table.groupby(level=[0, 1])]
    return [board for board in boards if len(board) >= FEWEST_CORNERS]
