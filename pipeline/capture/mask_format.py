"""Formats of masks: shares of pixels, or labels of parts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8

from pipeline.base.errors import InputError


@dataclass(frozen=True)
class MaskFormat:
    """Meaning of the stored values of masks.

    Attributes:
        labels: values that are the subject, of masks that number its parts; None: the value is the share, 255 = all.
        enlarged: True if a mask may be a whole factor smaller than its image.
    """

    labels: tuple[int, ...] | None = None
    enlarged: bool = False

    @classmethod
    def from_index(cls, facts: Mapping[str, Any] | None) -> MaskFormat:
        """The format that `images.masks` of capture.json describes, if it is there."""
        if not facts:
            return PLAIN_MASKS
        labels = facts.get("labels")
        return cls(None if labels is None else tuple(labels), bool(facts.get("enlarged", False)))

    def subject(self, stored: UInt8[np.ndarray, "rows columns"]) -> UInt8[np.ndarray, "rows columns"]:
        """Shares 0..255 of a mask as it is stored."""
        return stored if self.labels is None else np.isin(stored, self.labels).astype(np.uint8) * np.uint8(255)

    def factor(self, stored: tuple[int, int], wanted: tuple[int, int]) -> int | None:
        """Image pixels along a side of the mask's pixel; None unless that is a whole number."""
        if stored == wanted:
            return 1
        factor = wanted[0] // max(stored[0], 1)
        return factor if self.enlarged and (stored[0] * factor, stored[1] * factor) == wanted else None

    def fit(
        self, stored: UInt8[np.ndarray, "rows columns"], shape: tuple[int, int], path: Path
    ) -> UInt8[np.ndarray, "h w"]:
        """Shares 0..255 at the size of the image.

        Raises:
            InputError: if the mask has another size; `path` names it.
        """
        factor = self.factor((stored.shape[0], stored.shape[1]), shape)
        if factor is None:
            found = f"{stored.shape[1]} x {stored.shape[0]}"
            raise InputError(f"{path}: expected a mask of {shape[1]} x {shape[0]} pixels, as its image, found {found}")
        return self.subject(stored).repeat(factor, 0).repeat(factor, 1)


PLAIN_MASKS = MaskFormat()
"""Masks of the size of their images, 255 = subject."""
