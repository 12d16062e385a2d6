"""Small motions of cameras from their calibrated poses, and images seen from there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pandas as pd
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

from pipeline.capture.records import ImageRecord
from pipeline.capture.shards import ImageShards


@dataclass(frozen=True, eq=False)
class CameraOffsets:
    """Motions of cameras: what was at x in a camera's frame is at turn(x) + shift.

    Attributes:
        names: of the cameras.
        motions: rotation vector, radians, and shift, metres, in each camera's frame.
    """

    names: Sequence[str]
    motions: Float64[np.ndarray, "cameras 6"]

    @cached_property
    def _by_name(self) -> dict[str, np.ndarray]:
        return dict(zip(self.names, self.motions, strict=True))

    def moved(self, image: ImageRecord) -> ImageRecord:
        """An image with the camera where it stands.

        As it was, if the camera is none of the known ones.
        """
        motion = self._by_name.get(image.camera)
        if motion is None:
            return image
        turn = Rotation.from_rotvec(motion[:3]).as_matrix()
        return replace(image, R=turn @ image.R, t=turn @ image.t + motion[3:])

    def as_json(self) -> dict[str, list[float]]:
        """Motion by name of the camera."""
        return {name: motion.tolist() for name, motion in self._by_name.items()}

    @staticmethod
    def from_json(motions: Mapping[str, Sequence[float]]) -> CameraOffsets:
        """Read what `as_json` wrote."""
        return CameraOffsets(list(motions), np.array(list(motions.values()), np.float64).reshape(-1, 6))


CAMERAS_AS_CALIBRATED = CameraOffsets((), np.zeros((0, 6)))
"""No camera stands elsewhere than its calibration says."""


class MovedImages:
    """Images of shards, each seen by its camera where that is known to stand by now.

    Args:
        images: as the shards have them.
    """

    def __init__(self, images: ImageShards) -> None:
        self.images, self._offsets = images, CAMERAS_AS_CALIBRATED

    @property
    def table(self) -> pd.DataFrame:
        """Every column but the pixels; cameras as calibrated."""
        return self.images.table

    def move(self, offsets: CameraOffsets) -> None:
        """See all images from other places; no other thread may ask for one meanwhile."""
        self._offsets = offsets

    def __len__(self) -> int:
        return len(self.images)

    def __getitem__(self, index: int) -> ImageRecord:
        return self._offsets.moved(self.images[index])
