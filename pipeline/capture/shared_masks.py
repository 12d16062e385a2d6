"""Masks that several images share, decoded once."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

import numpy as np
from jaxtyping import UInt8

from pipeline.capture.images import ImageSource


class SharedMasks:
    """Masks of some images, of which none is decoded twice.

    A mask is kept from the first of its images to the last: at most one for each camera, where all images of a camera
    share theirs as those of a still subject do, and none where each image has its own.

    Args:
        source: of the images.
        paths: of the mask of each image that will be read, as often as images share it; what is no text is no mask.
    """

    def __init__(self, source: ImageSource, paths: Iterable[object]) -> None:
        self._source = source
        self._left = Counter(path for path in paths if isinstance(path, str))
        self._kept: dict[str, UInt8[np.ndarray, "h w"]] = {}

    def read(self, path: str, shape: tuple[int, ...]) -> UInt8[np.ndarray, "h w"]:
        """The mask of the next image, as `ImageSource.read_mask`. It may be read again: do not write into it.

        Raises:
            InputError: if it cannot be read, or is not of that size.
        """
        mask = self._kept.pop(path, None)
        if mask is None or mask.shape != tuple(shape[:2]):
            mask = self._source.read_mask(path, shape)
        self._left[path] -= 1
        if self._left[path] > 0:
            self._kept[path] = mask
        return mask
