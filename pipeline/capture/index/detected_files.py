"""Keypoints and masks that were found in a capture's images, in place of its own."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from pipeline.base.errors import InputError
from pipeline.base.files import read_table

MASK_FOLDER = "masks"
"""Of detected masks, beside their table."""


@dataclass(frozen=True)
class DetectedFiles:
    """Tables of what detectors found; None where the capture has its own.

    Attributes:
        keypoints: keypoints_2d.parquet of detect_landmarks.
        masks: masks.parquet of segment_subject: camera, frame, mask_path, digest.
    """

    keypoints: Path | None = None
    masks: Path | None = None

    @property
    def mask_folder(self) -> Path | None:
        """The folder that paths of the masks are relative to."""
        return None if self.masks is None else self.masks.parent / MASK_FOLDER

    def masked(self, images: pd.DataFrame) -> tuple[pd.DataFrame, dict[str, str]]:
        """The table of images with the detected masks, and the masks' digests by path.

        Raises:
            InputError: if the table of masks is not there.
        """
        if self.masks is None:
            return images, {}
        found = read_table(self.masks)
        if missing := sorted({"camera", "frame", "mask_path", "digest"} - set(found.columns)):
            raise InputError(f"{self.masks}: expected the table of segment_subject, found no {', '.join(missing)}")
        merged = images.drop(columns="mask_path").merge(
            found[["camera", "frame", "mask_path"]].astype({"camera": "str", "mask_path": "str"}),
            on=["camera", "frame"], how="left",
        )  # fmt: skip
        return merged, dict(zip(found["mask_path"], found["digest"], strict=True))


NOTHING_DETECTED = DetectedFiles()
"""Of captures with keypoints and masks of their own, and of those that do without."""
