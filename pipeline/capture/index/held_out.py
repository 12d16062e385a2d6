"""Splits of a capture: what they name, checked, and the images that each holds out."""

from __future__ import annotations

import pandas as pd

from pipeline.base.errors import Complaints
from pipeline.base.splits import VALIDATION_FLAGS
from pipeline.capture.index.csv_tables import complain_unknown
from pipeline.capture.schema.capture_yaml import Splits
from pipeline.capture.schema.manifest import MANIFEST


def check_splits(
    splits: Splits | None, cameras: pd.DataFrame | None, frames: pd.DataFrame | None, complaints: Complaints
) -> None:
    """Complain about splits that name what no table lists, or that leave nothing to train on."""
    if splits is None or cameras is None or frames is None:
        return
    listed_in = {
        "test_cameras": (cameras["camera"], "the table of cameras"),
        "test_frames": (frames["frame"], "the table of frames"),
        "test_segments": (frames["segment"], "the table of frames"),
        "test_patterns": (frames["frame"], "the table of frames"),
        "validation_cameras": (cameras["camera"], "the table of cameras"),
        "validation_frames": (frames["frame"], "the table of frames"),
        "validation_patterns": (frames["frame"], "the table of frames"),
    }
    for key, (known, where) in listed_in.items():
        complain_unknown(complaints, MANIFEST, f"splits.{key}", getattr(splits, key) or [], list(known), where)
    held_out = [*splits.test_frames, *splits.test_patterns]
    held_out += [*(splits.validation_frames or []), *(splits.validation_patterns or [])]
    training_frames = ~(frames["frame"].isin(held_out) | frames["segment"].isin(splits.test_segments))
    held_out_cameras = [*splits.test_cameras, *(splits.validation_cameras or [])]
    if not training_frames.any() or cameras["camera"].isin(held_out_cameras).all():
        found = "every camera, or every frame, held out"
        complaints.add(MANIFEST, "splits", expected="some images that no split holds out, to train on", found=found)


def images_table(images: pd.DataFrame, digests: dict[str, str], frames: pd.DataFrame, splits: Splits) -> pd.DataFrame:
    """Table of the images found, with their digests and the splits that they belong to."""
    segments = images["frame"].map(frames.set_index("frame")["segment"])
    return images.assign(
        digest=images["path"].map(digests).astype("str"),
        mask_digest=images["mask_path"].map(digests).astype("str"),
        test_camera=images["camera"].isin(splits.test_cameras),
        test_frame=images["frame"].isin(splits.test_frames),
        test_segment=segments.isin(splits.test_segments),
        # Of the frames that the capture names; book_patterns finds all that show the same pattern.
        test_pattern=images["frame"].isin(splits.test_patterns),
        **_validation_columns(images, splits),
    )


def _validation_columns(images: pd.DataFrame, splits: Splits) -> dict[str, pd.Series]:
    """Flags of validation images. Those of frames are null where the capture names none: `book_patterns` chooses."""
    frames = (splits.validation_frames, splits.validation_patterns)
    by_frame = [images["frame"].isin(listed or []).astype("boolean") for listed in frames]
    if not splits.names_validation:
        by_frame = [pd.Series(pd.NA, images.index, "boolean")] * len(frames)
    flags = (images["camera"].isin(splits.validation_cameras or []), *by_frame)
    return dict(zip(VALIDATION_FLAGS, flags, strict=True))
