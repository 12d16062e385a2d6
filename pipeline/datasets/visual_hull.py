"""Visual hull of a still object: the largest shape whose outlines lie in all masks.

Laurentini, "The visual hull concept for silhouette-based image understanding", 1994. It is where the signed distances
to all outlines are positive, each in metres at the point's depth; the surface is found by marching cubes (Lorensen and
Cline, 1987). No mask shows a hollow, so that no hull has one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, UInt8
from scipy.ndimage import gaussian_filter, map_coordinates

from pipeline.base.conventions import PIXEL_CENTER
from pipeline.geometry.cameras import Camera
from pipeline.geometry.mesh_files import Mesh
from pipeline.geometry.signed_distance import FARTHEST_PX, HALF_COVERED, signed_distance

COARSE_CELLS = 24
"""Cells along a side of the first box, which only finds the second."""

MARGIN = 1.1
"""Of the first box: the outlines bound the object across each camera's view, and not along it."""


PIXELS_PER_CELL = 2.0
"""Smaller cells would show the staircase of binary masks."""

SMOOTHING_CELLS, CLIPPED_CELLS = 0.7, 2.1
"""Blur of the distances, which are clipped at three times that: the edges in which outlines meet are none of the
object's, and cut its texture into shreds. A sphere of 20 cells shrinks by a fortieth of a cell (its curvature)."""


@dataclass(frozen=True)
class OutlineView:
    """A camera, and the mask that it has of the object.

    Attributes:
        camera: at the mask's resolution.
        mask: 0..255.
    """

    camera: Camera
    mask: UInt8[np.ndarray, "height width"]


def carve(views: Sequence[OutlineView], cells: int) -> Mesh | None:
    """The hull's surface, its triangles counterclockwise seen from outside.

    None if the masks leave nothing.

    Args:
        cells: along the longest side of the box that the hull fills.
    """
    views = [view for view in views if (view.mask >= HALF_COVERED).any()]
    box = _first_box(views) if len(views) > 1 else None
    if box is None:
        return None
    distances = [signed_distance(view.mask) for view in views]
    points, step = _grid(*box, COARSE_CELLS)
    # Something thinner than a cell may lie between its corners.
    near = _inside(views, distances, points) > -np.sqrt(3) * step
    if not near.any():
        return None
    found = points[near]
    low, high = found.min(0) - step, found.max(0) + step
    points, step = _grid(low, high, min(cells, int((high - low).max() / _finest(views, found.mean(0)))))
    inside = _inside(views, distances, points)
    if not (inside > 0).any():
        return None
    # A rim outside of everything closes the surface where an object leaves all images.
    clipped = np.pad(np.clip(inside / step, -CLIPPED_CELLS, CLIPPED_CELLS), 1, constant_values=-CLIPPED_CELLS)
    closed = gaussian_filter(clipped, SMOOTHING_CELLS, mode="nearest")
    from skimage.measure import marching_cubes  # Half a second to import; few captures need a hull.

    vertices, faces, _, _ = marching_cubes(closed, 0.0, spacing=(step, step, step), allow_degenerate=False)
    mesh = Mesh(vertices.astype(np.float64) + points[0, 0, 0] - step, faces.astype(np.int64))
    return mesh if _volume(mesh) > 0 else Mesh(mesh.vertices, mesh.faces[:, ::-1].copy())


def _first_box(
    views: Sequence[OutlineView],
) -> tuple[Float64[np.ndarray, " 3"], Float64[np.ndarray, " 3"]] | None:
    """Corners of a box around the object; None if the middles of the masks meet behind a camera."""
    middles, spreads = [], []
    for view in views:
        y, x = np.nonzero(view.mask >= HALF_COVERED)
        pixels = np.stack([x, y], 1) + PIXEL_CENTER
        middles.append(pixels.mean(0))
        spreads.append(np.linalg.norm(pixels - middles[-1], axis=1).max() / view.camera.K[0, 0])
    across = []
    for view, middle in zip(views, middles, strict=True):
        ray = view.camera.ray_directions(middle[None])[0]
        across.append(np.eye(3) - np.outer(ray, ray))
    # The point nearest to all rays, by least squares.
    toward = sum(matrix @ view.camera.center for matrix, view in zip(across, views, strict=True))
    center = np.linalg.solve(sum(across), toward)
    depths = np.array([view.camera.project(center)[1] for view in views])
    if (depths <= 0).any():
        return None
    half = MARGIN * float((np.array(spreads) * depths).max())
    return center - half, center + half


def _finest(views: Sequence[OutlineView], center: np.ndarray) -> float:
    """Side of the smallest cells that masks can tell apart, metres."""
    pixels = [float(view.camera.project(center)[1]) / view.camera.K[0, 0] for view in views]
    return PIXELS_PER_CELL * float(np.median(pixels))


def _grid(low: np.ndarray, high: np.ndarray, cells: int) -> tuple[Float64[np.ndarray, "x y z 3"], float]:
    """Corners of cubic cells that fill a box, and their side."""
    step = float((high - low).max()) / cells
    counts = np.ceil((high - low) / step).astype(int) + 1
    axes = [start + step * np.arange(count) for start, count in zip(low, counts, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1), step


def _inside(
    views: Sequence[OutlineView], distances: Sequence[np.ndarray], points: Float64[np.ndarray, "x y z 3"]
) -> Float64[np.ndarray, "x y z"]:
    """How far points lie inside the outline that is nearest, metres; negative outside of any."""
    least = np.full(points.shape[:3], np.inf)
    for view, distance in zip(views, distances, strict=True):
        pixels, depth = view.camera.project(points)
        edges = (distance[0], distance[-1], distance[:, 0], distance[:, -1])
        # Beside the image there is background, unless the object leaves it.
        beside = FARTHEST_PX if max(float(edge.max()) for edge in edges) > 0 else -FARTHEST_PX
        places = np.moveaxis(pixels - PIXEL_CENTER, -1, 0)[::-1]
        found = map_coordinates(distance, places, order=1, mode="constant", cval=beside, output=np.float64)
        found *= np.abs(depth) / view.camera.K[0, 0]
        least = np.minimum(least, np.where(depth > 0, found, -np.inf))
    return least


def _volume(mesh: Mesh) -> float:
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    return float(np.einsum("fa,fa->", a, np.cross(b, c)) / 6)
