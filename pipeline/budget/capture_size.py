"""Size of a capture, as far as it can be known before anything has run."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

from pipeline.config.project import SubjectSettings
from pipeline.config.subjects import read_description
from pipeline.config.synthesize_capture import Material
from pipeline.config.trained_model import Kind


@dataclass(frozen=True)
class CaptureSize:
    """Numbers of cameras, frames and lights, pixels of an image, and avatars to train.

    Pixels are the mean over the cameras; the kind of what is captured is body or head. Its material is opaque, as
    people in clothes are to the plan of effects, unless settings say else.
    """

    cameras: int
    frames: int
    pixels: int
    variants: int
    lights: int = 1
    kind: Kind = "body"
    material: Material = "opaque"

    @property
    def images(self) -> int:
        """Images of the whole capture."""
        return self.cameras * self.frames


UNKNOWN = CaptureSize(cameras=8, frames=24, pixels=19_200, variants=1, lights=24)
"""Size of a capture that is not there yet, as before import_capture: that of subjectA. When it is there, what follows
asks anew."""


def capture_size(settings: SubjectSettings, capture: Path, unknown: CaptureSize) -> CaptureSize:
    """Size of a synthetic subject from its settings, of a recorded one from its tables.

    What cannot be read has the size of `unknown`: index_capture says what is wrong with it.
    """
    variants, made = len(settings.variants), settings.synthesize_capture
    if settings.source == "synthetic":
        pixels = made.width * made.height
        return CaptureSize(made.cameras, made.frames, pixels, variants, made.lights, made.figure, made.material)
    described = read_description(capture / "capture.yaml")
    kind: Kind = "head" if described.get("kind") == "head" else "body"
    cameras, frames, lights = (_rows(capture / str(described.get(name))) for name in ("cameras", "frames", "lights"))
    try:
        pixels = [int(row["width"]) * int(row["height"]) for row in cameras]
    except (KeyError, TypeError, ValueError):
        pixels = []
    mean = round(sum(pixels) / len(pixels)) if pixels else unknown.pixels
    return CaptureSize(
        len(cameras) or unknown.cameras, len(frames) or unknown.frames, max(mean, 1), variants,
        len(lights) or unknown.lights, kind, material_said(settings),
    )  # fmt: skip


def material_said(settings: SubjectSettings) -> Material:
    """Material of a recorded subject.

    It is translucent if settings ask for light below the surface, else opaque.
    """
    asked = settings.plan_effects.learned_transport == "on" or settings.train_avatar.shading == "subsurface"
    return "translucent" if asked else "opaque"


def _rows(path: Path) -> list[dict[str, str]]:
    try:
        with open(path, newline="") as file:
            return list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError, csv.Error):
        return []
