"""Contents of a valid capture's index: the table of images, capture.json, exposures."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import pandas as pd

from pipeline.base.files import digest_file
from pipeline.capture.images import ImageSource
from pipeline.capture.index.detected_files import NOTHING_DETECTED, DetectedFiles
from pipeline.capture.index.frame_images import mask_format
from pipeline.capture.index.tables import EXPOSURE_COLUMNS
from pipeline.capture.mask_format import PLAIN_MASKS
from pipeline.capture.schema.capture_yaml import Capture


def relative_exposures(frames: pd.DataFrame) -> dict[int, float]:
    """Exposure time times gain of frames that differ from most, relative to those.

    Most frames stay as they are stored; of two exposures as frequent, the longer one's do.
    """
    given = [frames[column] for column in EXPOSURE_COLUMNS if column in frames]
    if not given:
        return {}
    exposure = given[0] if len(given) == 1 else given[0] * given[1]
    counts = exposure.value_counts()
    usual = max(counts.index[counts == counts.max()])
    return {int(f): float(e / usual) for f, e in zip(frames["frame"], exposure, strict=True) if e != usual}


def image_source(
    root: Path, manifest: Capture, frames: pd.DataFrame | None, detected: DetectedFiles = NOTHING_DETECTED
) -> ImageSource | None:
    """The source of a capture's images; None if description or frames are in doubt."""
    facts, exposures = manifest.images, {} if frames is None else relative_exposures(frames)
    if facts is None or frames is None or min(exposures.values(), default=1.0) <= 0:
        return None
    masks = mask_format(manifest) if detected.masks is None else PLAIN_MASKS
    return ImageSource(
        root, facts.transfer, facts.black_level, masks, detected.mask_folder, exposures, facts.reduced
    )  # fmt: skip


def capture_content(root: Path, manifest: Capture, eyes: pd.DataFrame, source: ImageSource) -> dict[str, Any]:
    """Content of `capture.json`.

    No splits and no calibration, so that a change there reruns only what reads it.
    """
    template, images, given = manifest.template, manifest.images, {}
    facts = images.model_dump(include={"transfer", "black_level", "downsample_from_sensor"})
    if images.reduced > 1:
        facts["reduced"] = images.reduced
    if source.masks != PLAIN_MASKS:
        facts["masks"] = {
            name: value for name, value in asdict(source.masks).items() if (name, value) != ("reduced", 1)
        }
    if source.mask_folder is not None:
        facts["mask_folder"] = str(source.mask_folder)
    if source.exposures:
        facts["exposures"] = {str(frame): factor for frame, factor in source.exposures.items()}
    if manifest.meshes is not None:
        given["meshes"] = manifest.meshes.model_dump(include={"motion", "scale_to_m"})
    labelled = {}
    if template.regions:
        labelled = {"regions": template.regions, "regions_digest": digest_file(root / template.regions)}
    if template.eyes and not manifest.gaze:
        given["gaze"] = False
    if manifest.constant_light:
        given["constant_light"] = True
    if manifest.imported is not None:
        given["imported"] = manifest.imported.model_dump(exclude={"digest"})
    return {
        "subject": manifest.subject,
        "kind": manifest.kind,
        "fps": manifest.fps,
        "images": facts,
        "template": {
            "mesh": template.mesh,
            "mesh_digest": digest_file(root / template.mesh),
            "keypoints": template.keypoints,
            "keypoints_digest": digest_file(root / template.keypoints) if template.keypoints else None,
            "scale_to_m": template.scale_to_m,
            "eyes": sorted(set(eyes["eye"])),
            **labelled,
        },
        **given,
    }
