"""Images that cameras without boards are calibrated from.

They are those of fully lit frames, with their masks.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

from pipeline.base.errors import Complaints
from pipeline.capture.schema.capture_yaml import Calibration, MirrorBallLights
from pipeline.capture.schema.feature_schema import FeatureCameras
from pipeline.capture.schema.manifest import MANIFEST

HELD_OUT = ("test_frame", "test_segment", "test_pattern")
"""Flags of frames that show nothing to a calibration either."""


def fully_lit(patterns: pd.DataFrame, lights: int) -> list[int]:
    """Frames that list every light."""
    lit = patterns.groupby("frame")["light"].nunique()
    return [int(frame) for frame in lit.index[lit == lights]]


def check_features(section: Calibration, cameras: pd.DataFrame, complaints: Complaints) -> None:
    """Complain of a rig without boards that nothing gives a size.

    Or whose distance is of no two cameras.
    """
    mine = section.cameras
    if not isinstance(mine, FeatureCameras):
        return
    if mine.distance is None and not isinstance(section.lights, MirrorBallLights):
        complaints.add(
            MANIFEST, "calibration.cameras.distance", expected="a distance of two cameras, or mirror-ball images",
            found="neither", hint="measure how far two lenses are apart: first, second, metres",
        )  # fmt: skip
    if mine.distance is not None:
        pair, names = (mine.distance.first, mine.distance.second), list(cameras["camera"])
        if pair[0] == pair[1] or not set(pair) <= set(names):
            expected, found = "two cameras of the table of cameras", " and ".join(pair)
            complaints.add(MANIFEST, "calibration.cameras.distance", expected=expected, found=found)


def feature_content(
    images: pd.DataFrame, patterns: pd.DataFrame, lights: int, facts: Mapping[str, Any], balls: Mapping[str, Any]
) -> dict[str, Any]:
    """Content of calibration_cameras.json besides its section.

    Views, how images are stored, and the ball, if any.

    Args:
        images: of the index, with digests and splits.
        facts: `images` of capture.json.
        balls: calibration_lights.json.

    Raises:
        InputError: if no frame is fully lit.
    """
    shown = images[images.frame.isin(fully_lit(patterns, lights)) & ~images[list(HELD_OUT)].any(axis=1)]
    if shown.empty:
        complaints = Complaints(MANIFEST)
        hint = "photograph the subject under all lights at once, or calibrate with boards"
        complaints.add(
            "patterns", "light", expected="fully lit frames that are not held out, for method features", found="none",
            hint=hint,
        )  # fmt: skip
        complaints.raise_if_any()
    views = [
        {"camera": row.camera, "view": int(row.frame), "path": row.path, "digest": row.digest,
         **({"mask": row.mask_path, "mask_digest": row.mask_digest} if isinstance(row.mask_path, str) else {})}
        for row in shown.sort_values(["frame", "camera"]).itertuples()
    ]  # fmt: skip
    return {"views": views, "images": dict(facts), **{key: balls[key] for key in ("radius_m", "silhouettes")
                                                      if balls.get("silhouettes")}}  # fmt: skip
