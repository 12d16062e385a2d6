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
        reduced: stored pixels along a side of the image's pixel, which is their mean; what is left over is cut off.
    """

    labels: tuple[int, ...] | None = None
    enlarged: bool = False
    reduced: int = 1

    @classmethod
    def from_index(cls, facts: Mapping[str, Any] | None) -> MaskFormat:
        """The format that `images.masks` of capture.json describes, if it is there."""
        if not facts:
            return PLAIN_MASKS
        labels = facts.get("labels")
        return cls(
            None if labels is None else tuple(labels), bool(facts.get("enlarged", False)), facts.get("reduced", 1)
        )

    def subject(self, stored: UInt8[np.ndarray, "rows columns"]) -> UInt8[np.ndarray, "rows columns"]:
        """Shares 0..255 of a mask as it is stored."""
        return stored if self.labels is None else np.isin(stored, self.labels).astype(np.uint8) * np.uint8(255)

    def factor(self, stored: tuple[int, int], wanted: tuple[int, int]) -> int | None:
        """Stored image pixels along a side of the mask's pixel; None unless that is a whole number."""
        most = self.reduced * (wanted[0] + 1) // max(stored[0], 1) if self.enlarged else 1
        return next((k for k in range(1, most + 1) if reduced_size(stored, self.reduced, k) == wanted), None)

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
        whole = self.subject(stored).repeat(factor, 0).repeat(factor, 1)
        return whole if self.reduced == 1 else np.round(whole_blocks(whole, self.reduced).mean((1, 3))).astype(np.uint8)


def reduced_size(stored: tuple[int, int], reduced: int, enlarged: int = 1) -> tuple[int, int]:
    """Rows and columns of whole blocks of `reduced` pixels a side.

    Each stored pixel stands for `enlarged` pixels a side.
    """
    return stored[0] * enlarged // reduced, stored[1] * enlarged // reduced


def whole_blocks(pixels: np.ndarray, side: int) -> np.ndarray:
    """Pixels as rows, side, columns, side, and channels if there are any.

    What fills no block is cut off.
    """
    rows, columns = reduced_size((pixels.shape[0], pixels.shape[1]), side)
    return pixels[: rows * side, : columns * side].reshape(rows, side, columns, side, *pixels.shape[2:])


PLAIN_MASKS = MaskFormat()
"""Masks of the size of their images, 255 = subject."""
