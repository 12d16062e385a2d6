"""Tables of keypoints that a detector found, in whatever order it numbers them.

They have a row for each keypoint of each image: more than memory holds. So they are checked and copied piece by piece.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq

from pipeline.base import large_tables
from pipeline.base.errors import Complaints
from pipeline.base.large_tables import PieceWriter, RangedRows, range_starts, written_pieces
from pipeline.capture.index.csv_tables import DTYPES, Kind, complain_repeats, complain_unknown, read_csv
from pipeline.capture.index.keypoint_checks import KEYS, KeypointChecks
from pipeline.capture.index.parquet_tables import UNREADABLE, read_pieces
from pipeline.capture.keypoint_orders import (
    EYE_COLUMNS,
    EYE_POINTS,
    NOTHING_GIVEN,
    as_template_keypoints,
    points_of_eyes,
    points_of_template,
    read_orders,
)
from pipeline.capture.paths import locate

log = logging.getLogger(__name__)

KEYPOINT_COLUMNS: Mapping[str, Kind] = {
    "frame": "whole", "camera": "name", "keypoint": "text", "x": "number", "y": "number", "confidence": "number",
}  # fmt: skip

EYE_KINDS: Mapping[str, Kind] = {column: KEYPOINT_COLUMNS.get(column, "text") for column in EYE_COLUMNS}

KEYPOINT_FILES = ("keypoints_2d.parquet", "eye_points.parquet")
"""Tables of the index that are copied from a table of keypoints."""


@dataclass(frozen=True)
class KeypointSource:
    """Table of detections in image pixels, and what its keypoints mean.

    Attributes:
        root, path: of the table; None if the capture has none.
        order: how it numbers or labels keypoints; None: by the template's names.
        points: the template's keypoint by point, which an order needs.
        given: template.points of the capture, which says what points the template's names are.
        detected: True for a table of detect_landmarks, which wrote a table of the points of eyes beside it, or none.
    """

    root: Path
    path: str | None
    order: str | None = None
    points: Mapping[str, str] = field(default_factory=lambda: NOTHING_GIVEN)
    given: str | None = None
    detected: bool = False

    def named(self, rows: pd.DataFrame) -> pd.DataFrame:
        """The rows by the template's names; what an order has beyond the template is left out."""
        if self.order is None:
            return rows
        return as_template_keypoints(rows, [self.order] * len(rows), self.points).astype({"keypoint": "str"})

    def eye_points(self, rows: pd.DataFrame, names: Mapping[str, str]) -> pd.DataFrame:
        """Irises and contours of eyes among the rows, `EYE_COLUMNS`.

        Args:
            names: points by the names that the whole table has; not needed with an order.
        """
        if self.order is not None:
            known = rows[rows["keypoint"].map(lambda key: read_orders()[self.order].point(str(key)) is not None)]
            return points_of_eyes(known, [self.order] * len(known))
        eyes = rows.assign(point=rows["keypoint"].map(names))
        eyes = eyes[eyes["point"].isin(EYE_POINTS)].astype({"point": "str"})
        return eyes.sort_values(["frame", "camera", "point"], ignore_index=True)[list(EYE_COLUMNS)]


def copy_keypoints(
    source: KeypointSource, known: Mapping[str, Collection[object] | None], folder: Path, complaints: Complaints
) -> int:
    """Check detections, and write `KEYPOINT_FILES` by frame and camera.

    They have no rows if the capture has none. Rows are read once, and wait on the disk by ranges of frames; a range at
    a time is brought into order.

    Args:
        known: for frame, camera and keypoint the values that other tables list; None where those are in doubt.
        folder: of the files; without use if there are complaints. What waits is there too.

    Returns:
        Number of keypoints.
    """
    keypoints_file, eyes_file = (folder / name for name in KEYPOINT_FILES)
    with written_pieces(keypoints_file) as keypoints, written_pieces(eyes_file) as eyes:
        keypoints.add(_no_rows(KEYPOINT_COLUMNS))
        eyes.add(_no_rows(EYE_KINDS))
        if source.detected and (source.root / eyes_file.name).is_file():
            for piece in read_pieces(source.root, eyes_file.name, EYE_KINDS, complaints):
                if piece is not None:
                    eyes.add(piece)
        if source.path is not None:
            eyes_too = None if source.detected else eyes
            _copy_rows(source, known, folder / "ranges", complaints, keypoints, eyes_too)
        return keypoints.rows


def _copy_rows(
    source: KeypointSource, known: Mapping[str, Collection[object] | None], folder: Path, complaints: Complaints,
    keypoints: PieceWriter, eyes: PieceWriter | None,
) -> None:  # fmt: skip
    """As `copy_keypoints`, of a table that there is."""
    path = str(source.path)
    checks = KeypointChecks(known)
    rows = RangedRows(folder, "frame", _frame_ranges(source))
    for piece in read_pieces(source.root, path, KEYPOINT_COLUMNS, complaints):
        if piece is None:
            return
        piece = checks.with_names(piece)
        checks.note_values(piece)
        if source.order is None:
            checks.note_unknown(piece)
        rows.add(piece)
    points = {}
    if eyes is not None and source.order is None:
        names = read_points_csv(source.root, source.given, sorted(checks.labels), Complaints(source.root))
        points = {keypoint: point for point, keypoint in names.items()}
    for part in rows.ranges():
        checks.note_repeats(part)
        named = source.named(part)
        if source.order is not None:
            checks.note_unknown(named)
        keypoints.add(named.sort_values(KEYS, kind="stable"))
        if eyes is not None:
            eyes.add(source.eye_points(part, points))
    checks.complain(complaints, path, source.order, source.points)
    if source.order is not None:
        shared = sum(point in read_orders()[source.order].points for point in source.points)
        log.info("%s: %s has %d of the template's keypoints", path, source.order, shared)


def _frame_ranges(source: KeypointSource) -> list[int]:
    """First frames of ranges of few rows each; none if the table is small, or is none, which reading it says."""
    counts: Counter[int] = Counter()
    with suppress(TypeError, *UNREADABLE):
        file = locate(source.root, str(source.path))
        if pq.read_metadata(file).num_rows > large_tables.MOST_ROWS:
            for piece in large_tables.read_pieces(file, ["frame"]):
                frames, rows = np.unique(piece["frame"].astype("int64"), return_counts=True)
                counts.update(dict(zip(frames.tolist(), rows.tolist(), strict=True)))
    return range_starts(counts, large_tables.MOST_ROWS)


def _no_rows(columns: Mapping[str, Kind]) -> pd.DataFrame:
    return pd.DataFrame({column: pd.Series(dtype=DTYPES[kind]) for column, kind in columns.items()})


def read_points_csv(root: Path, path: str | None, names: Collection[str], complaints: Complaints) -> dict[str, str]:
    """The template's keypoint by the point that it is: by name, or as template.points says.

    Args:
        path: csv of keypoint and point; None if the capture has none.
        names: keypoints of the template.
    """
    given: dict[str, str] = {}
    table = None if path is None else read_csv(root, path, {"keypoint": "text", "point": "text"}, complaints)
    if table is not None:
        complain_repeats(complaints, path, table, ["keypoint"])
        complain_repeats(complaints, path, table, ["point"])
        complain_unknown(complaints, path, "keypoint", table["keypoint"], list(names), "template.keypoints")
        every = {point for order in read_orders().values() for point in order.points}
        complain_unknown(complaints, path, "point", table["point"], sorted(every), "docs/detection.md")
        given = dict(zip(table["keypoint"], table["point"], strict=True))
    return points_of_template(list(names), given)
