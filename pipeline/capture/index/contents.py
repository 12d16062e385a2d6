"""Contents of the index that follow from a capture that is valid: the table of images, and capture.json."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import pandas as pd

from pipeline.base.files import digest_file
from pipeline.capture.images import ImageSource
from pipeline.capture.mask_format import PLAIN_MASKS
from pipeline.capture.schema.capture_yaml import Capture


def capture_content(root: Path, manifest: Capture, eyes: pd.DataFrame, source: ImageSource) -> dict[str, Any]:
    """Content of `capture.json`.

    No splits and no calibration, so that a change there reruns only what reads it.
    """
    template, images, given = manifest.template, manifest.images, {}
    facts = images.model_dump(include={"transfer", "black_level", "downsample_from_sensor"})
    if source.masks != PLAIN_MASKS:
        facts["masks"] = asdict(source.masks)
    if source.mask_folder is not None:
        facts["mask_folder"] = str(source.mask_folder)
    if manifest.meshes is not None:
        given["meshes"] = manifest.meshes.model_dump(include={"motion", "scale_to_m"})
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
        },
        **given,
    }
