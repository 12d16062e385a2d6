"""Frames of a Goliath capture, and its split."""

from __future__ import annotations

import logging
from collections.abc import Collection
from pathlib import Path

import pandas as pd

from pipeline.base.errors import InputError, listed
from pipeline.datasets.goliath_archives import Archives
from pipeline.datasets.imported_capture import HeldOut, Provenance
from pipeline.datasets.kept_frames import shown
from pipeline.datasets.layout import csv_columns

log = logging.getLogger(__name__)

TEST_CAMERAS = ("401645", "401964", "402501", "402597", "402801", "402871", "402873", "402956", "402969", "402978",
                "402982", "403066")  # fmt: skip
"""Cameras of the example split of the set's loader."""

ALL_SEGMENTS = "all"


def read_frames(
    root: Path, wanted: Collection[str], lit: Collection[int] | None, found: Archives, provenance: Provenance
) -> pd.DataFrame:
    """Frames whose light and images are there, in order; the others are named.

    Columns are frame, split and segment.

    Args:
        root: folder of the capture.
        wanted: segments; none: all.
        lit: frames whose light pattern is known; None: of all.
        found: archives of the images.
        provenance: gets notes.

    Raises:
        InputError: if no frame is left, or a wanted segment is not there.
    """
    frames = csv_columns(root / "frame_splits_list.csv", ("frame", "split")).drop_duplicates().sort_values("frame")
    if (root / "frame_segments_list.csv").is_file():
        segments = csv_columns(root / "frame_segments_list.csv", ("segment_name", "frame")).drop_duplicates("frame")
        frames["segment"] = frames.frame.map(segments.set_index("frame").segment_name).fillna(ALL_SEGMENTS).astype(str)
    else:
        frames["segment"] = ALL_SEGMENTS
    if absent := sorted(set(wanted) - set(frames.segment)):
        known = listed(list(dict.fromkeys(frames.segment)), 20)
        raise InputError(f"import_capture.segments: expected some of {known}, found {listed(absent)}")
    if wanted:
        frames = frames[frames.segment.isin(list(wanted))]
    seen = frozenset().union(*found.images.values())
    for why, known in (("frames without a light pattern", lit), ("frames without images", seen)):
        missing = ~frames.frame.isin(list(known)) if known is not None else pd.Series(False, frames.index)
        if missing.any():
            numbers = frames.frame[missing].tolist()
            log.warning("%d %s; left out: %s", len(numbers), why, numbers)
            provenance.left_out[why] = shown(numbers)
            frames = frames[~missing]
    if frames.empty:
        also = "" if lit is None else " and a light pattern"
        raise InputError(f"{root}: expected frames with a split, images{also}, found none")
    return frames.reset_index(drop=True)


def frame_step(frames: pd.DataFrame) -> int:
    """The usual distance of frame numbers within a segment."""
    steps = frames.groupby("segment").frame.diff().dropna()
    return int(steps.mode().iloc[0]) if len(steps) else 1


def held_out(frames: pd.DataFrame, cameras: Collection[str], test_cameras: Collection[str]) -> HeldOut:
    """The set's split.

    Segments that are for testing as a whole, single frames of others, and the cameras that test.
    """
    test = frames.split == "test"
    whole = test.groupby(frames.segment).all()
    segments = whole.index[whole].tolist()
    tested = [camera for camera in cameras if camera in test_cameras]
    if len(tested) in (0, len(cameras)) and test_cameras:
        log.warning("none of the cameras, or all, are of the set's example split: no camera is held out")
        tested = []
    return HeldOut(tested, frames.frame[test & ~frames.segment.isin(segments)].tolist(), segments)
