"""Reading where a colour chart lies in the images, for cameras in which it is not found automatically."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path

import numpy as np

from pipeline.base.errors import Complaints, listed
from pipeline.capture.index.csv_tables import Kind, complain_repeats, complain_rows, complain_unknown, read_csv

CORNER_COLUMNS: Mapping[str, Kind] = {"camera": "name", "corner": "whole", "x": "number", "y": "number"}

CORNERS = 4


def read_corners_csv(
    root: Path, path: str, cameras: Collection[str], complaints: Complaints
) -> dict[str, list[list[float]]]:
    """Corners 0..3 of each camera's chart, pixels (first centre at (0.5, 0.5)); a camera may be left out.

    Corner 0 is the outermost corner of patch 1, corner 1 that of patch 6, corner 2 that of patch 24, corner 3 that of
    patch 19: they go around the block of patches, without the chart's frame.
    """
    table = read_csv(root, path, CORNER_COLUMNS, complaints)
    if table is None:
        return {}
    complain_unknown(complaints, path, "camera", table["camera"], cameras, "the table of cameras")
    if (bad := ~table["corner"].isin(range(CORNERS))).any():
        complain_rows(complaints, path, "corner", bad, "0, 1, 2 or 3", table["corner"])
    complain_repeats(complaints, path, table, ["camera", "corner"])
    found = {}
    for camera, rows in table.groupby("camera", sort=False):
        if missing := [corner for corner in range(CORNERS) if corner not in set(rows["corner"])]:
            complaints.add(path, f"{camera}: corner", expected="all of 0 to 3", found=f"no {listed(missing)}")
            continue
        corners = rows.sort_values("corner")[["x", "y"]].to_numpy()
        if np.isfinite(corners).all() and not _is_convex(corners):
            expected = "corners 0 to 3 that go around the chart: outside of patches 1, 6, 24 and 19"
            complaints.add(path, f"{camera}: x and y", expected=expected, found="sides that cross or lie in one line")
        found[camera] = corners.tolist()
    return found


def _is_convex(corners: np.ndarray) -> bool:
    side = np.roll(corners, -1, 0) - corners
    following = np.roll(side, -1, 0)
    turn = np.sign(side[:, 0] * following[:, 1] - side[:, 1] * following[:, 0])
    return bool(abs(turn.sum()) == CORNERS)
