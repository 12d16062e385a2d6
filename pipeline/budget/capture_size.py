"""Size of a capture, as far as it can be known before anything has run."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path

from pipeline.config.project import SubjectSettings
from pipeline.config.subjects import read_description


@dataclass(frozen=True)
class CaptureSize:
    """Numbers of cameras, frames and lights, pixels of an image, and avatars to train.

    Pixels are the mean over the cameras.
    """

    cameras: int
    frames: int
    pixels: int
    variants: int
    lights: int = 1

    @property
    def images(self) -> int:
        """Images of the whole capture."""
        return self.cameras * self.frames

    def over(self, other: CaptureSize, names: tuple[str, ...]) -> float:
        """Ratio of this capture's size to another's, in all of these together."""
        return math.prod(getattr(self, name) / getattr(other, name) for name in names)


def capture_size(settings: SubjectSettings, capture: Path, unknown: CaptureSize) -> CaptureSize:
    """Size of a synthetic subject from its settings, of a recorded one from its tables.

    What cannot be read has the size of `unknown`: index_capture says what is wrong with it.
    """
    variants, made = len(settings.variants), settings.synthesize_capture
    if settings.source == "synthetic":
        return CaptureSize(made.cameras, made.frames, made.width * made.height, variants, made.lights)
    described = read_description(capture / "capture.yaml")
    cameras, frames, lights = (_rows(capture / str(described.get(name))) for name in ("cameras", "frames", "lights"))
    try:
        pixels = [int(row["width"]) * int(row["height"]) for row in cameras]
    except (KeyError, TypeError, ValueError):
        pixels = []
    mean = round(sum(pixels) / len(pixels)) if pixels else unknown.pixels
    return CaptureSize(
        len(cameras) or unknown.cameras, len(frames) or unknown.frames, max(mean, 1), variants,
        len(lights) or unknown.lights,
    )  # fmt: skip


def _rows(path: Path) -> list[dict[str, str]]:
    try:
        with open(path, newline="") as file:
            return list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError, csv.Error):
        return []
