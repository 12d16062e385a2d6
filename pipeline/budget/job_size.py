"""Sizes that the cost of a job grows with."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from pipeline.budget.capture_size import CaptureSize
from pipeline.config.project import SubjectSettings
from pipeline.config.sections import section_for

KEPT_BYTES = 217
"""Bytes per texel that training keeps of a frame, as docs/where_time_goes.md counts them."""


@dataclass(frozen=True)
class JobSize:
    """Sizes that the cost of a job grows with.

    Attributes:
        cameras, lights: of the capture.
        frames: that the job handles, a chunk's or all.
        pixels: of an image, the mean over the cameras.
        texels: of the atlas.
        head_texels: the same of a head, whose Gaussians take longer than a body's; 0 of a body.
        steps: of training the avatar that takes most.
        step_pixels: pixels of the images of one step.
        avatars: that the job trains or scores.
        processes: that train one avatar together on a CPU.
        decode_threads: that index_capture decodes images with, a setting.
        threads: that the job works with.
        cache_mb: megabytes that training keeps frames in.
        listed: images that the job reads of in tables; it need not read them.
        sync_cameras, tracking_cameras: whose images book_patterns and track_mesh look at, at most; settings.
    """

    cameras: int
    lights: int
    frames: int
    pixels: int
    texels: int
    steps: int
    step_pixels: int
    avatars: int
    processes: int = 1
    decode_threads: int = 1
    threads: int = 1
    cache_mb: int = 16_000
    listed: int = 0
    head_texels: int = 0
    sync_cameras: int = 16
    tracking_cameras: int = 24

    @property
    def kept_texels(self) -> float:
        """Texels of all frames that training keeps at a time."""
        return min(float(self.frames * self.texels), 1e6 * self.cache_mb / KEPT_BYTES)

    def product(self, names: Iterable[str]) -> float:
        """Product of these sizes; 1 for none."""
        return math.prod((getattr(self, name) for name in names), start=1.0)


def size_of_whole(settings: SubjectSettings, capture: CaptureSize, texels: int, variants: Sequence[str]) -> JobSize:
    """Size of a job that handles all frames of a capture, and these avatars."""
    trained = [section_for(settings, "train_avatar", variant) for variant in variants]
    step_images = max(section.cameras_per_step * section.frames_per_step for section in trained)
    return JobSize(
        cameras=capture.cameras,
        lights=capture.lights,
        frames=capture.frames,
        pixels=capture.pixels,
        texels=texels,
        steps=max(section.steps for section in trained),
        step_pixels=step_images * capture.pixels,
        avatars=len(trained),
        processes=max(section.steps_together for section in trained),
        decode_threads=settings.index_capture.decode_threads,
        listed=capture.images,
        head_texels=texels if capture.kind == "head" else 0,
        sync_cameras=settings.book_patterns.sync_cameras,
        tracking_cameras=max(settings.track_mesh.outline_cameras, settings.track_mesh.image_cameras),
    )
