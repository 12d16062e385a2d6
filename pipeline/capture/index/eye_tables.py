"""Tables of a capture's eyes: their vertices in the template, and their gaze in each frame."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float64, Int64

from pipeline.base.errors import Complaints, listed
from pipeline.capture.index.csv_tables import (
    DTYPES,
    Kind,
    complain_repeats,
    complain_rows,
    complain_unknown,
    read_csv,
)
from pipeline.capture.schema.capture_yaml import NAME_PATTERN
from pipeline.geometry.pose_interpolation import neighbours

log = logging.getLogger(__name__)

EYE_COLUMNS: Mapping[str, Kind] = {"eye": "name", "vertex": "whole"}
GAZE_COLUMNS: Mapping[str, Kind] = {"frame": "whole", "eye": "name", "x": "number", "y": "number", "z": "number"}

UNIT_TOLERANCE = 0.01
"""By how much the length of a direction may differ from 1: two digits after the point are off by up to 0.005 per
component, 0.009 in all. What is further off is no direction but a point, an angle or a mistake."""

OPPOSITE = 1e-6
"""Sine of the angle between directions below which they are one or opposite: rounding decides the way between."""


def read_eyes_csv(
    root: Path, path: str | None, faces: Int64[np.ndarray, "f 3"] | None, vertices: int, complaints: Complaints
) -> pd.DataFrame:
    """Table of all vertices of each eye part, `eye` and `vertex`, sorted by both.

    Empty if the capture declares no eyes.

    Args:
        faces: of the template; None if it could not be read, which is a complaint of its own.
        vertices: number of vertices of the template.
    """
    empty = pd.DataFrame({column: pd.Series(dtype=DTYPES[kind]) for column, kind in EYE_COLUMNS.items()})
    table = None if path is None else read_csv(root, path, EYE_COLUMNS, complaints)
    if table is None:
        return empty
    if table.empty:
        hint = "leave the key out if there are no eyes"
        complaints.add(path, "eye", expected="at least one row", found="none", hint=hint)
    _complain_names(complaints, path, table)
    complain_repeats(complaints, path, table, ["vertex"])
    if faces is not None:
        if (bad := ~table["vertex"].between(0, vertices - 1)).any():
            expected = f"a vertex of the template, 0 to {vertices - 1}"
            complain_rows(complaints, path, "vertex", bad, expected, table["vertex"])
        else:
            _complain_torn(complaints, path, table, faces, vertices)
    return table.sort_values(["eye", "vertex"], kind="stable", ignore_index=True)


def _complain_names(complaints: Complaints, path: str, table: pd.DataFrame) -> None:
    if (bad := ~table["eye"].str.fullmatch(NAME_PATTERN)).any():
        complain_rows(complaints, path, "eye", bad, "letters, digits, _ and -", table["eye"])


def _complain_torn(
    complaints: Complaints, path: str, table: pd.DataFrame, faces: Int64[np.ndarray, "f 3"], vertices: int
) -> None:
    """An eye is a part of the mesh: no face is half in it."""
    names, number = np.unique(table["eye"], return_inverse=True)
    eye_of = np.full(vertices, -1)
    eye_of[table["vertex"]] = number
    corners = eye_of[faces]
    for index, name in enumerate(names):
        inside = corners == index
        torn = np.flatnonzero(inside.any(1) & ~inside.all(1))
        if len(torn):
            outside = sorted({int(v) for v in faces[torn][~inside[torn]]})
            complaints.add(
                path, str(name), expected="every vertex of the faces of a separate part",
                found=f"{len(torn)} faces half in it; not listed: vertices {listed(outside)}",
            )  # fmt: skip
        if not inside.any():
            complaints.add(path, str(name), expected="vertices of at least one face", found="none")


def read_gaze_csv(
    root: Path, path: str | None, frames: pd.DataFrame | None, eyes: pd.DataFrame, complaints: Complaints
) -> pd.DataFrame:
    """Table of the unit direction of every eye in every frame, in the head's frame.

    Columns are frame, eye, x, y, z, interpolated. The head's frame is that of the template at rest. Frames without a
    row get a direction on the way between their neighbours' in the same segment, the nearest one before the first and
    after the last (`interpolated`); they are counted in the log. Empty if the capture declares no gaze.
    """
    columns = {**{column: DTYPES[kind] for column, kind in GAZE_COLUMNS.items()}, "interpolated": "bool"}
    empty = pd.DataFrame({column: pd.Series(dtype=dtype) for column, dtype in columns.items()})
    table = None if path is None else read_csv(root, path, GAZE_COLUMNS, complaints)
    if table is None:
        return empty
    before = len(complaints.messages)
    length = np.linalg.norm(table[["x", "y", "z"]], axis=1)
    if (bad := pd.Series(np.abs(length - 1) > UNIT_TOLERANCE)).any():
        complain_rows(
            complaints, path, "x, y, z", bad, "a unit direction", pd.Series(length).map("length {:.3g}".format)
        )
    complain_repeats(complaints, path, table, ["frame", "eye"])
    names = list(dict.fromkeys(eyes["eye"]))
    if names:  # none: the table of eyes is in doubt, which was said
        complain_unknown(complaints, path, "eye", table["eye"], names, "template.eyes")
    if missing := [name for name in names if name not in set(table["eye"])]:
        complaints.add(
            path, "eye", expected="a direction of each eye of template.eyes", found=f"none of {listed(missing)}"
        )
    if frames is None:
        return empty
    complain_unknown(complaints, path, "frame", table["frame"], frames["frame"], "the table of frames")
    if len(complaints.messages) > before or not names or not np.isfinite(length).all():
        return empty
    full = gaze_of_all_frames(table, frames)
    if count := int(full["interpolated"].sum()):
        log.warning("%s: %d of %d directions interpolated between neighbouring frames", path, count, len(full))
    return full[list(empty)]


def gaze_of_all_frames(table: pd.DataFrame, frames: pd.DataFrame) -> pd.DataFrame:
    """Directions of eyes in all frames from those in some, with `interpolated` for all others.

    These lie between their neighbours in the same segment.

    Args:
        table: frame, eye, x, y, z; at least one row of each eye.
        frames: frame, timestamp_s and segment of all frames, in order.
    """
    names = dict.fromkeys(table["eye"])
    full = pd.concat([_in_all_frames(table[table["eye"] == name], frames) for name in names], ignore_index=True)
    return full.sort_values(["frame", "eye"], kind="stable", ignore_index=True)


def _in_all_frames(table: pd.DataFrame, frames: pd.DataFrame) -> pd.DataFrame:
    """The directions of one eye in all frames; at least one is known."""
    table = table.sort_values("frame")
    known = np.searchsorted(frames["frame"], table["frame"]).astype(np.int64)
    takes, times = pd.factorize(frames["segment"])[0].astype(np.int64), frames["timestamp_s"].to_numpy()
    before, after, _ = neighbours(known, len(frames), takes)
    start, end = times[known[before]], times[known[after]]
    share = np.clip((times - start) / np.where(end > start, end - start, 1.0), 0.0, 1.0)
    given = table[["x", "y", "z"]].to_numpy()
    given = given / np.linalg.norm(given, axis=1, keepdims=True)
    found = between_directions(given[before], given[after], share)
    return pd.DataFrame(
        {
            "frame": frames["frame"], "eye": table["eye"].iloc[0], **dict(zip("xyz", found.T, strict=True)),
            "interpolated": ~np.isin(np.arange(len(frames)), known),
        }
    )  # fmt: skip


def between_directions(
    start: Float64[np.ndarray, "n 3"], end: Float64[np.ndarray, "n 3"], share: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, "n 3"]:
    """Unit directions at a share of the great circle from `start` to `end`.

    The nearer one of both where they are opposite.
    """
    sine = np.linalg.norm(np.cross(start, end), axis=1)
    angle = np.arctan2(sine, (start * end).sum(1))
    clear, whole = sine > OPPOSITE, np.where(sine > OPPOSITE, sine, 1.0)
    first = np.where(clear, np.sin((1 - share) * angle) / whole, share < 0.5)
    second = np.where(clear, np.sin(share * angle) / whole, share >= 0.5)
    return first[:, None] * start + second[:, None] * end
