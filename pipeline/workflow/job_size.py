"""Sizes of a job: what its threads, memory and time are asked for by.

They are known before any stage has run: from the settings of a synthetic subject, from the tables that capture.yaml
names, and from the atlas as soon as there is one. The index is not needed, and nothing numerical is imported.
"""

from __future__ import annotations

import functools
import json
import math
import os
import struct
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from pipeline.budget.capture_size import CaptureSize, capture_size
from pipeline.config.project import SubjectSettings
from pipeline.config.sections import section_for
from pipeline.workflow.job_files import JobFiles

UNKNOWN = CaptureSize(cameras=8, frames=24, pixels=19_200, variants=1, lights=24)
"""Size of a capture that is not there yet, as before import_capture: that of subjectA. When it is there, what follows
asks anew."""

COVERED = 0.6
"""Share of an atlas that carries texels, before the atlas is made: subjectA's covers 0.41, a head's of 60 lights 0.45,
that of a recorded body 0.58."""

KEPT_BYTES = 217
"""Bytes per texel that training keeps of a frame, as docs/where_time_goes.md counts them."""

HEADER = struct.Struct("<Q")
"""Start of a safetensors file: bytes of the JSON that follows."""

LONGEST_HEADER = 1 << 20
"""Bytes of JSON that are read, a thousand times what an atlas has: another file may say anything in its first bytes."""


@dataclass(frozen=True)
class JobSize:
    """Sizes that the cost of a job grows with.

    Attributes:
        cameras, lights: of the capture.
        frames: that the job handles, a chunk's or all.
        pixels: of an image, the mean over the cameras.
        texels: of the atlas.
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
    sync_cameras: int = 16
    tracking_cameras: int = 24

    @property
    def kept_texels(self) -> float:
        """Texels of all frames that training keeps at a time."""
        return min(float(self.frames * self.texels), 1e6 * self.cache_mb / KEPT_BYTES)

    def product(self, names: Iterable[str]) -> float:
        """Product of these sizes; 1 for none."""
        return math.prod((getattr(self, name) for name in names), start=1.0)


def job_size(files: JobFiles) -> JobSize:
    """Size of a job of a subject, as far as it is known now."""
    settings = files.settings
    capture = _capture_size(settings, Path(files.capture))
    trained = [section_for(settings, "train_avatar", variant) for variant in files.variants]
    step_images = max(section.cameras_per_step * section.frames_per_step for section in trained)
    return JobSize(
        cameras=capture.cameras,
        lights=capture.lights,
        frames=capture.frames if files.chunk is None else min(capture.frames, settings.chunk_frames),
        pixels=capture.pixels,
        texels=_texels(Path(files.path("atlas.safetensors"))) or _expected_texels(settings),
        steps=max(section.steps for section in trained),
        step_pixels=step_images * capture.pixels,
        avatars=len(trained),
        processes=files.project.settings.training_processes or max(section.steps_together for section in trained),
        decode_threads=settings.index_capture.decode_threads,
        cache_mb=files.project.settings.training_cache_mb,
        listed=0 if files.chunk is not None else capture.images,
        sync_cameras=settings.book_patterns.sync_cameras,
        tracking_cameras=max(settings.track_mesh.outline_cameras, settings.track_mesh.image_cameras),
    )


def unknown_size() -> JobSize:
    """Size of a job that belongs to no subject."""
    return JobSize(
        UNKNOWN.cameras, UNKNOWN.lights, UNKNOWN.frames, UNKNOWN.pixels, texels=0, steps=0, step_pixels=0, avatars=1
    )


def _capture_size(settings: SubjectSettings, capture: Path) -> CaptureSize:
    if settings.source == "synthetic":
        return capture_size(settings, capture, UNKNOWN)
    counted = _counted(capture, _changed(capture / "capture.yaml"))
    return CaptureSize(counted.cameras, counted.frames, counted.pixels, len(settings.variants), counted.lights)


@functools.cache
def _counted(capture: Path, changed: int) -> CaptureSize:
    """Size by the tables, which are read once for all jobs of a capture.

    Args:
        changed: time of capture.yaml, which imported captures write last.
    """
    return capture_size(SubjectSettings(), capture, UNKNOWN)


def _changed(path: Path) -> int:
    try:
        return os.stat(path).st_mtime_ns
    except OSError:
        return 0


def _texels(atlas: Path) -> int:
    """Texels by the header of the atlas; 0 if there is none yet, or none that can be read."""
    try:
        with open(atlas, "rb") as file:
            (size,) = HEADER.unpack(file.read(HEADER.size))
            return int(json.loads(file.read(min(size, LONGEST_HEADER)))["texel"]["shape"][0])
    except (OSError, ValueError, LookupError, TypeError, struct.error):
        return 0


def _expected_texels(settings: SubjectSettings) -> int:
    side = settings.unwrap_atlas.size or settings.unwrap_atlas.most
    return round(COVERED * side**2)
