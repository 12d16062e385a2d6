"""Grids of AprilTags or ArUco markers, each apart from the others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from pipeline.base.conventions import PIXEL_CENTER
from pipeline.calibration.cameras.boards import NOTHING, Board, BoardPhoto, Detection

TAG_CORNERS = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
"""Corners of a tag in the order in which OpenCV gives them, in units of its side."""


@dataclass(frozen=True)
class TagGrid(Board):
    """A grid of tags in rows from the top left; its points are the tags' corners, four each.

    Tags are numbered from `first_tag` on. They have to stand apart, as OpenCV's GridBoard has them: tags whose corners
    touch black squares, as in Kalibr's aprilgrid, are not read by OpenCV's detector.

    Attributes:
        tag_m: side of a tag's black square, metres.
        gap_m: white between two tags, metres.
    """

    tags_x: int
    tags_y: int
    tag_m: float
    gap_m: float
    dictionary: str = "DICT_APRILTAG_36H11"
    first_tag: int = 0

    def corners_m(self) -> Float64[np.ndarray, "corners 3"]:
        """Four corners of each tag, tag by tag."""
        y, x = np.divmod(np.arange(self.tags_x * self.tags_y), self.tags_x)
        first = np.stack([x, y], 1) * (self.tag_m + self.gap_m)
        corners = (first[:, None] + self.tag_m * TAG_CORNERS).reshape(-1, 2)
        return np.concatenate([corners, np.zeros((len(corners), 1))], 1)

    def detect(self, photo: BoardPhoto) -> Detection:
        """Find the corners of all tags that are read."""
        corners, ids = photo.markers(self.dictionary, self.inverted)
        tag = ids.astype(np.int64) - self.first_tag
        own = np.flatnonzero(np.isin(ids, self.markers))
        # A number that is read twice belongs to two things, one of which is no tag of this board.
        own = own[np.isin(tag[own], [n for n in tag[own] if (tag == n).sum() == 1])]
        if len(own) == 0:
            return NOTHING
        pixels = np.concatenate([corners[k].reshape(4, 2) for k in own]).astype(np.float64) + PIXEL_CENTER
        return Detection((4 * tag[own, None] + np.arange(4)).ravel(), pixels, len(own))

    def describe(self) -> str:
        """Tags, dictionary, first tag."""
        more = [f"tags from {self.first_tag}"] * (self.first_tag > 0) + ["inverted"] * self.inverted
        return ", ".join([f"{self.tags_x} x {self.tags_y} tags", self.dictionary, *more])

    @property
    def markers_of(self) -> str:
        """The dictionary."""
        return self.dictionary

    @property
    def markers(self) -> range:
        """One number for each tag."""
        return range(self.first_tag, self.first_tag + self.tags_x * self.tags_y)
