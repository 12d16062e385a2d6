"""Landmarks that a set has in its images, and the vertices of its meshes that they mark.

Sets say which landmarks a detector found, and not where they lie on a mesh. Cameras tell: landmarks of some frames are
triangulated, and each belongs to the vertex that stays nearest to it. One that stays near none, as the outline of a
face, which is another line in each view, has no place.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float64
from scipy.spatial.distance import cdist

from pipeline.base.spread import evenly
from pipeline.capture.keypoint_orders import read_orders
from pipeline.datasets.imported_capture import Keypoints, Provenance, TrackedMeshes
from pipeline.datasets.mask_agreement import posed_vertices
from pipeline.geometry.cameras import Camera
from pipeline.geometry.triangulation import triangulate

log = logging.getLogger(__name__)

PLACED_FRAMES = 8
"""Frames that landmarks are triangulated in, evenly chosen among those with a mesh."""

INLIER_SHARE = 0.005
"""Of an image's height: further from a triangulated landmark a detection is an outlier. A face fills half an image, and
good detections are off by a hundredth of it."""

MOST_AWAY_M = 0.01
"""Mean distance from the nearest vertex up to which a landmark lies on the mesh: vertices of faces are 5 mm apart."""

LEAST_PLACED = 3
"""Landmarks that say anything about a pose."""


def placed_keypoints(
    root: Path, pieces: Callable[[], Iterator[pd.DataFrame]], order: str, cameras: Mapping[str, Camera],
    tracked: TrackedMeshes, provenance: Provenance,
) -> Keypoints | None:  # fmt: skip
    """The landmarks with their vertices; None, and a note, if hardly one lies on the meshes.

    Args:
        root: folder of the set.
        pieces: their tables, keypoints numbered as in the order.
        order: as `keypoints_order` of capture.yaml names it.
        cameras: at the resolution of the images.
        tracked: the meshes.
        provenance: gets notes.
    """
    points, frames = read_orders()[order].points, evenly(tracked.table.frame.tolist(), PLACED_FRAMES)
    chosen = pd.concat([piece[piece.frame.isin(frames)] for piece in pieces()], ignore_index=True)
    away = [
        cdist(_triangulated(chosen[chosen.frame == frame], cameras, len(points)), posed_vertices(root, tracked, frame))
        for frame in frames
    ]
    known = np.isfinite(away).all(-1).mean(0) >= 0.5
    mean = np.nanmean(np.array(away)[:, known], axis=0)
    vertices, nearest = mean.argmin(1), mean.min(1)
    on_mesh = nearest < MOST_AWAY_M
    places = pd.DataFrame({"keypoint": np.array(points)[known][on_mesh], "vertex": vertices[on_mesh]})
    said = f"{len(places)} of {len(points)} landmarks lie on the meshes"
    log.info("%s: %s", root, said)
    if len(places) < LEAST_PLACED:
        provenance.left_out["landmarks"] = f"{said}, as triangulated in {len(frames)} frames"
        return None
    distance = 1000 * float(np.median(nearest[on_mesh]))
    provenance.given["keypoints"] = f"{order}; {said}, {distance:.1f} mm from a vertex (median)"
    provenance.computed["places of keypoints"] = (
        f"import_capture: vertices that stay nearest to landmarks triangulated in {len(frames)} frames"
    )
    return Keypoints(order, places, pieces)


def _triangulated(
    rows: pd.DataFrame, cameras: Mapping[str, Camera], count: int
) -> Float64[np.ndarray, "points 3"]:  # fmt: skip
    """Landmarks of one frame, metres; NaN where cameras do not agree."""
    observed = np.full((len(cameras), count, 2), np.nan)
    for number, (name, camera) in enumerate(cameras.items()):
        own = rows[rows.camera == name]
        if len(own):
            observed[number, own.keypoint.astype(int)] = camera.undistort(own[["x", "y"]].to_numpy(np.float64))
    height = max(camera.height for camera in cameras.values())
    seen = np.isfinite(observed).all(-1).astype(np.float64)
    return triangulate(list(cameras.values()), observed, seen, INLIER_SHARE * height).points
