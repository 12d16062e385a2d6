"""Tables of keypoints that a detector found, in whatever order it numbers them."""

from __future__ import annotations

import logging
from collections.abc import Collection, Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.errors import Complaints, listed
from pipeline.base.files import read_table
from pipeline.capture.index.csv_tables import DTYPES, Kind, complain_repeats, complain_unknown, read_csv
from pipeline.capture.index.parquet_tables import read_parquet
from pipeline.capture.keypoint_orders import (
    EYE_COLUMNS,
    EYE_POINTS,
    NOTHING_GIVEN,
    as_template_keypoints,
    points_of_eyes,
    points_of_template,
    read_orders,
)
from pipeline.capture.schema.manifest import MANIFEST

log = logging.getLogger(__name__)

KEYPOINT_COLUMNS: Mapping[str, Kind] = {
    "frame": "whole", "camera": "name", "keypoint": "text", "x": "number", "y": "number", "confidence": "number",
}  # fmt: skip

MOST_CONFIDENCE = 1000.0
"""Largest weight of a detection: detectors say 0 to 1, percent or a logit. One row of more would outweigh all."""


def read_keypoints_parquet(
    root: Path, path: str | None, known: Mapping[str, Collection[object] | None], complaints: Complaints,
    order: str | None = None, points: Mapping[str, str] = NOTHING_GIVEN,
) -> pd.DataFrame:  # fmt: skip
    """Detections in image pixels, by frame and camera; an empty table if the capture has none.

    Args:
        known: for frame, camera and keypoint the values that other tables list; None where those are in doubt.
        order: how the file numbers or labels its keypoints; None: by the template's names.
        points: the template's keypoint by point, which an order needs.
    """
    empty = pd.DataFrame({column: pd.Series(dtype=DTYPES[kind]) for column, kind in KEYPOINT_COLUMNS.items()})
    if path is None:
        return empty
    table = read_parquet(root, path, KEYPOINT_COLUMNS, complaints)
    if table is None:
        return empty
    for column in ("camera", "keypoint"):
        if count := int(table[column].isna().sum()):
            complaints.add(path, column, expected="a name in each row", found=f"{count} rows without any")
            table = table[table[column].notna()]
    for column in ("x", "y", "confidence"):
        if count := int((~np.isfinite(table[column])).sum()):
            hint = "leave out rows that the detector did not find"
            complaints.add(path, column, expected="finite numbers", found=f"{count} rows of NaN or infinity", hint=hint)
    if count := int((table["confidence"] < 0).sum()):
        complaints.add(path, "confidence", expected="0 or more", found=f"{count} negative rows")
    if count := int((table["confidence"] > MOST_CONFIDENCE).sum()):
        found = f"{count} rows up to {table['confidence'].max():g}"
        complaints.add(path, "confidence", expected=f"weights of at most {MOST_CONFIDENCE:g}", found=found)
    complain_repeats(complaints, path, table, ["frame", "camera", "keypoint"])
    if order is not None:
        table = _from_order(path, table, order, points, complaints)
    for column, values in known.items():
        if values is not None:
            complain_unknown(complaints, path, column, table[column], values, f"the table of {column}s")
    return table.sort_values(["frame", "camera", "keypoint"], kind="stable", ignore_index=True)


def read_eye_points(
    root: Path, path: str | None, order: str | None, detected: Path | None, given: str | None = None
) -> pd.DataFrame:
    """Detected irises and contours of eyes, `EYE_COLUMNS`; empty where there are none.

    Args:
        path, order: keypoints_2d and its order, of the capture; without one, keypoints are the template's names.
        given: template.points of the capture, which says what these are.
        detected: keypoints_2d.parquet of detect_landmarks, beside which it wrote its own.
    """
    if detected is not None and detected.with_name("eye_points.parquet").is_file():
        return read_table(detected.with_name("eye_points.parquet"))[list(EYE_COLUMNS)]
    empty = pd.DataFrame({name: pd.Series(dtype=DTYPES[KEYPOINT_COLUMNS.get(name, "text")]) for name in EYE_COLUMNS})
    if detected is not None or path is None:
        return empty
    table = read_table(root / path)
    if order is None:
        names = sorted({str(name) for name in table["keypoint"]})
        points = {keypoint: point for point, keypoint in read_points_csv(root, given, names, Complaints(root)).items()}
        eyes = table.assign(point=table["keypoint"].astype(str).map(points))
        eyes = eyes[eyes["point"].isin(EYE_POINTS)].astype({"point": "str", "camera": "str"})
        return eyes.sort_values(["frame", "camera", "point"], ignore_index=True)[list(EYE_COLUMNS)]
    known = table[table["keypoint"].map(lambda key: read_orders()[order].point(str(key)) is not None)]
    return points_of_eyes(known, [order] * len(known)) if len(known) else empty


def _from_order(
    path: str, table: pd.DataFrame, order: str, points: Mapping[str, str], complaints: Complaints
) -> pd.DataFrame:
    """The table by the template's names; complains of keypoints that the order, or all that the template, lacks."""
    known = read_orders()[order]
    unknown = sorted({str(key) for key in table["keypoint"] if known.point(str(key)) is None})
    if unknown:
        expected = f"numbers 0 to {len(known.points) - 1} or labels of {order}"
        complaints.add(path, "keypoint", expected=expected, found=listed(unknown))
    shared = [keypoint for point, keypoint in points.items() if point in known.points]
    if not shared:
        complaints.add(
            MANIFEST, "template.keypoints", expected=f"points of {order}, such as {', '.join(known.points[:3])}",
            found="none of them", hint="name keypoints so, or say in template.points which points they are",
        )  # fmt: skip
    log.info("%s: %s has %d of the template's keypoints", path, order, len(shared))
    return as_template_keypoints(table, [order] * len(table), points)


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
