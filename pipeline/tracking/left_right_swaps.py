"""Left-right swaps: keypoints that a detector named for each other in one view.

They are found because the other views disagree. Which keypoints may be mistaken for each other need not be known: the
two observations each fit the other's point.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float64, Int64

from pipeline.geometry.cameras import Camera
from pipeline.geometry.triangulation import reprojection


def find_left_right_swaps(
    cameras: Sequence[Camera],
    observed: Float64[np.ndarray, "cameras frames keypoints 2"],
    points: Float64[np.ndarray, "frames keypoints 3"],
    inlier_px: float,
) -> Int64[np.ndarray, "swaps 4"]:
    """Rows (camera, frame, keypoint, other keypoint) of swapped pairs, keypoint < other.

    Both observations miss their own point by more than `inlier_px` and hit the other's within it; of several such
    partners the nearest counts, if that is mutual.

    Args:
        cameras: of the views.
        observed: normalised coordinates, NaN where not detected.
        points: triangulated from all views, NaN where that failed.
        inlier_px: largest distance of a good observation, undistorted pixels.
    """
    _, frames, count, _ = observed.shape
    found = []
    others = np.broadcast_to(points[:, None], (frames, count, count, 3)).reshape(-1, 3)
    for number, camera in enumerate(cameras):
        mine = np.repeat(observed[number].reshape(-1, 2), count, 0)
        length = reprojection([camera], mine[None], others)[0].reshape(frames, count, count)
        found += [(number, *row) for row in _exchanged(np.nan_to_num(length, nan=np.inf), inlier_px)]
    return np.array(found, np.int64).reshape(-1, 4)


def _exchanged(length: Float64[np.ndarray, "frames keypoints keypoints"], inlier_px: float) -> list[tuple[int, ...]]:
    """(frame, keypoint, other) from the distances of every observation to every point."""
    own = np.diagonal(length, axis1=1, axis2=2)
    # Infinite where it was not observed at all: then it cannot have been exchanged.
    gross_outlier: Bool[np.ndarray, "frames keypoints"] = (own > inlier_px) & np.isfinite(own)
    fits = (
        (length < inlier_px)
        & (length < inlier_px).swapaxes(1, 2)
        & gross_outlier[:, :, None]
        & gross_outlier[:, None, :]
    )
    near = np.where(fits, length, 0.0)
    both = np.where(fits, near + near.swapaxes(1, 2), np.inf)
    partner = both.argmin(2)
    frame, keypoint = np.nonzero(np.isfinite(both.min(2)))
    other = partner[frame, keypoint]
    mutual = (partner[frame, other] == keypoint) & (keypoint < other)
    return [tuple(int(x) for x in row) for row in zip(frame[mutual], keypoint[mutual], other[mutual], strict=True)]


def exchanged(values: np.ndarray, swaps: Int64[np.ndarray, "swaps 4"]) -> np.ndarray:
    """`values` [cameras, frames, keypoints, ...] with each pair of `swaps` exchanged."""
    result = values.copy()
    camera, frame, keypoint, other = swaps.T
    result[camera, frame, keypoint], result[camera, frame, other] = (
        values[camera, frame, other], values[camera, frame, keypoint],
    )  # fmt: skip
    return result
