"""Choice of the captures that get keypoints and masks from their photographs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pipeline.config.subjects import read_description
from pipeline.workflow.job_files import JobFiles

READY = Path(".venv-detect/.ready")
"""There once `make detect` has set up MediaPipe's environment, below the project's folder."""


def detected_keypoints(job: JobFiles) -> list[str]:
    """The table of detect_landmarks, if keypoints are to come from there; else nothing.

    Of a recorded capture without keypoints and meshes, if a detector is there; or of any, if they are asked for.
    """
    settings = job.settings.detect_landmarks
    capture = _recorded(job)
    lacking = bool(capture) and not capture.get("keypoints_2d") and not capture.get("meshes")
    wanted = settings.use == "always" or (settings.use == "missing" and lacking and _has_detector(settings.detector))
    return [job.path("detected", "keypoints_2d.parquet")] if wanted else []


def detected_masks(job: JobFiles) -> list[str]:
    """The table of segment_subject, if the subject's masks are to come from there; else nothing.

    Of a recorded capture with clean plates; of one without masks and meshes, if a detector is there; or of any, if
    they are asked for.
    """
    settings = job.settings.segment_subject
    capture = _recorded(job)
    masks, images = capture.get("masks"), capture.get("images")
    listed = isinstance(images, dict) and bool(images.get("table"))
    lacking = bool(capture) and not masks and not listed and not capture.get("meshes")
    by_plates = isinstance(masks, dict) and bool(masks.get("clean_plates"))
    missing = by_plates or (lacking and _has_detector(settings.detector))
    wanted = settings.use == "always" or (settings.use == "missing" and missing)
    return [job.path("detected", "masks.parquet")] if wanted else []


def _recorded(job: JobFiles) -> dict[str, Any]:
    """The description of a recorded capture; empty for those that a stage makes, which have what they can have."""
    if job.settings.source != "native":
        return {}
    return read_description(Path(job.capture) / "capture.yaml")


def _has_detector(given: str) -> bool:
    return bool(given) or READY.is_file()
