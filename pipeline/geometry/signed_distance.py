"""Masks as signed distances to their outline, and the same from a mesh drawn into a view.

Drawn and given masks go through one distance transform, so that its half-pixel biases cancel when they are compared.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64, UInt8

from pipeline.geometry.cameras import Camera
from pipeline.geometry.outline_kernels import give_sign, mark_edge
from pipeline.geometry.raster_kernels import drawn_window, fill_coverage

SMOOTHING_PX = 0.7
"""Blur of the signed distance, about the staircase of a binary mask: its gradient then points across the outline."""

FARTHEST_PX = 30.0
"""Signed distances are clipped here: an outline further away is another limb's."""

HALF_COVERED = 128
"""Mask values from here on count as subject: coverage is rounded to 0..255."""

MARGIN_PX = 8
"""Empty pixels kept around a drawn mesh: at their rim, outlines are beyond doubt further than any cue compares."""


@dataclass(frozen=True)
class View:
    """One camera's masks of all frames, as signed distances.

    Attributes:
        camera: at the masks' resolution.
        mask: at least half covered.
        distance: to the mask's outline, pixels, positive inside.
        usable: frames that have a mask with something in it.
        binary: whether no pixel of the masks is partly covered; what is compared with them has to be rounded, too.
    """

    camera: Camera
    mask: Bool[np.ndarray, "frames height width"]
    distance: Float32[np.ndarray, "frames height width"]
    usable: Bool[np.ndarray, " frames"]
    binary: bool

    def at(self, frames: np.ndarray) -> View:
        """The view in some of the frames; the same one in all of them."""
        if np.array_equal(frames, np.arange(len(self.usable))):
            return self
        return replace(self, mask=self.mask[frames], distance=self.distance[frames], usable=self.usable[frames])

    def drawn(
        self, pixels: Float64[np.ndarray, "vertices 2"], depth: Float64[np.ndarray, " vertices"],
        faces: Int64[np.ndarray, "faces 3"],
    ) -> Drawing:  # fmt: skip
        """The mask that this view would have of a mesh, as `draw_around` draws it.

        Args:
            pixels, depth: of the vertices, as `Camera.project` has them.
        """
        drawing = draw_around(self.camera, pixels, depth, faces)
        if not self.binary:
            return drawing
        return replace(drawing, mask=np.where(drawing.mask >= HALF_COVERED, 255, 0).astype(np.uint8))


def signed_distance(mask: UInt8[np.ndarray, "height width"]) -> Float32[np.ndarray, "height width"]:
    """Distance to the outline of `mask` in pixels, positive inside, clipped to `FARTHEST_PX`.

    Coverage places the outline within a pixel: one of coverage c, 0..1, is c - 1/2 from it, as for an edge along rows
    or columns (Gustavson and Strand, "Anti-aliased Euclidean distance transform", 2011). Counting pixels of at least
    half coverage instead would count all ties as inside: a fifth of a pixel too much where masks were halved in size.
    """
    off_edge = np.empty_like(mask)
    if not mark_edge(mask, off_edge):
        return np.full(mask.shape, FARTHEST_PX if mask[0, 0] >= HALF_COVERED else -FARTHEST_PX, np.float32)
    away, nearest = cv2.distanceTransformWithLabels(
        off_edge, cv2.DIST_L2, cv2.DIST_MASK_PRECISE, labelType=cv2.DIST_LABEL_PIXEL
    )
    give_sign(mask, off_edge, nearest, HALF_COVERED, FARTHEST_PX, away)
    return cv2.GaussianBlur(away, (0, 0), SMOOTHING_PX)


def view_from_masks(camera: Camera, masks: Sequence[UInt8[np.ndarray, "height width"] | None]) -> View:
    """Signed distances of one camera's masks; None where a frame has none. One that follows itself is measured once."""
    distance = np.zeros((len(masks), camera.height, camera.width), np.float32)
    usable = np.array([mask is not None and bool((mask >= HALF_COVERED).any()) for mask in masks])
    inside = np.zeros(distance.shape, bool)
    for frame in np.flatnonzero(usable):
        if frame and masks[frame] is masks[frame - 1]:
            distance[frame], inside[frame] = distance[frame - 1], inside[frame - 1]
        else:
            distance[frame], inside[frame] = signed_distance(masks[frame]), masks[frame] >= HALF_COVERED
    binary = all(np.isin(masks[frame], (0, 255)).all() for frame in np.flatnonzero(usable))
    return View(camera, inside, distance, usable, binary)


@dataclass(frozen=True)
class Drawing:
    """A mesh drawn into a part of an image, outside of which there is nothing.

    Attributes:
        mask: coverage of each pixel of that part, 0..255.
        corner: its first row and column.
    """

    mask: UInt8[np.ndarray, "rows columns"]
    corner: tuple[int, int]


def draw_silhouette(
    camera: Camera, vertices: Float64[np.ndarray, "vertices 3"], faces: Int64[np.ndarray, "faces 3"]
) -> UInt8[np.ndarray, "height width"]:
    """Coverage of each pixel by the mesh, 0..255. Triangles that reach behind the camera are left out."""
    return fill_coverage(*camera.project(vertices), faces, (0, 0, camera.height, camera.width))


def draw_around(
    camera: Camera, pixels: Float64[np.ndarray, "vertices 2"], depth: Float64[np.ndarray, " vertices"],
    faces: Int64[np.ndarray, "faces 3"],
) -> Drawing:  # fmt: skip
    """The part of `draw_silhouette` that has something in it, and `MARGIN_PX` around it.

    Args:
        pixels, depth: of the vertices, as `Camera.project` has them.
    """
    window = drawn_window(pixels, depth, faces, camera.height, camera.width, MARGIN_PX)
    return Drawing(fill_coverage(pixels, depth, faces, window), window[:2])


def silhouette_overlap(
    views: Sequence[View], vertices: Float64[np.ndarray, "frames vertices 3"], faces: Int64[np.ndarray, "faces 3"]
) -> Float64[np.ndarray, " frames"]:
    """Intersection over union of drawn and given masks per frame, all views pooled.

    NaN for a frame without masks.
    """
    common, either = np.zeros(len(vertices)), np.zeros(len(vertices))
    for view in views:
        for frame in np.flatnonzero(view.usable):
            drawing, given = view.drawn(*view.camera.project(vertices[frame]), faces), view.mask[frame]
            drawn = drawing.mask >= HALF_COVERED
            (top, left), (rows, columns) = drawing.corner, drawn.shape
            both = np.count_nonzero(drawn & given[top : top + rows, left : left + columns])
            common[frame] += both
            either[frame] += np.count_nonzero(drawn) + np.count_nonzero(given) - both
    return np.where(either > 0, common / np.maximum(either, 1), np.nan)
