"""Sizes of a job: what its threads, memory and time are asked for by.

They are known before any stage has run: from the settings of a synthetic subject, from the tables that capture.yaml
names, and from the atlas as soon as there is one. The index is not needed, and nothing numerical is imported.
"""

from __future__ import annotations

import functools
import json
import os
import struct
from dataclasses import replace
from pathlib import Path

from pipeline.budget.capture_size import UNKNOWN, CaptureSize, capture_size
from pipeline.budget.job_size import JobSize, size_of_whole
from pipeline.config.project import SubjectSettings
from pipeline.workflow.job_files import JobFiles

MOST_COVERED = 0.6
"""Share of an atlas that carries texels at most, before the atlas is made: subjectA's covers 0.41, a head's of 60
lights 0.45, that of a recorded body 0.58."""

HEADER = struct.Struct("<Q")
"""Start of a safetensors file: bytes of the JSON that follows."""

LONGEST_HEADER = 1 << 20
"""Bytes of JSON that are read, a thousand times what an atlas has: another file may say anything in its first bytes."""


def job_size(files: JobFiles) -> JobSize:
    """Size of a job of a subject, as far as it is known now."""
    settings = files.settings
    capture = _capture_size(settings, Path(files.capture))
    texels = _texels(Path(files.path("atlas.safetensors"))) or _most_texels(settings)
    size = size_of_whole(settings, capture, texels, files.variants)
    asked = files.project.settings
    size = replace(size, processes=asked.training_processes or size.processes, cache_mb=asked.training_cache_mb)
    if files.chunk is None:
        return size
    return replace(size, frames=min(capture.frames, settings.chunk_frames), listed=0)


def unknown_size() -> JobSize:
    """Size of a job that belongs to no subject."""
    return JobSize(
        UNKNOWN.cameras, UNKNOWN.lights, UNKNOWN.frames, UNKNOWN.pixels, texels=0, steps=0, step_pixels=0, avatars=1
    )


def _capture_size(settings: SubjectSettings, capture: Path) -> CaptureSize:
    if settings.source == "synthetic":
        return capture_size(settings, capture, UNKNOWN)
    counted = _counted(capture, _changed(capture / "capture.yaml"))
    return replace(counted, variants=len(settings.variants))


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


def _most_texels(settings: SubjectSettings) -> int:
    side = settings.unwrap_atlas.size or settings.unwrap_atlas.most
    return round(MOST_COVERED * side**2)
