"""Colour calibration of a capture: images of a chart, or matrices that were found elsewhere."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd

from pipeline.base.color import POLYNOMIALS
from pipeline.base.errors import Complaints, listed
from pipeline.base.files import digest_file, read_json
from pipeline.capture.index.csv_tables import Kind, complain_repeats, complain_rows, complain_unknown, read_csv
from pipeline.capture.index.image_checks import ExpectedImage, IndexSection
from pipeline.capture.index.patch_tables import read_patches_csv
from pipeline.capture.paths import fill, locate
from pipeline.capture.schema.capture_yaml import ChartColor, KnownColor, NoColor
from pipeline.capture.schema.manifest import MANIFEST

CORNER_COLUMNS: Mapping[str, Kind] = {"camera": "name", "corner": "whole", "x": "number", "y": "number"}

EXPOSURE_COLUMNS: Mapping[str, Kind] = {"camera": "name", "path": "text", "exposure_s": "number"}

CORNERS = 4

FEWEST_EXPOSURES = 2
"""One exposure predicts another."""


def find_color_calibration(
    root: Path, section: ChartColor | KnownColor | NoColor, cameras: pd.DataFrame, complaints: Complaints
) -> IndexSection:
    """`calibration_color.json`, and one image of the chart per camera, of any size."""
    if isinstance(section, NoColor):
        nothing = {"method": "none", "transfer": None, "patches_digest": None}
        return {**nothing, "images": [], "patches": [], "corners": {}}, []
    if isinstance(section, KnownColor):
        matrices = read_color_matrices(root, section.path, list(cameras["camera"]), complaints)
        return {"method": "known", "images": [], "cameras": matrices}, []
    images = [{"camera": camera, "path": fill(section.path, camera=camera)} for camera in cameras["camera"]]
    if missing := [image["camera"] for image in images if not (root / image["path"]).is_file()]:
        complaints.add(
            section.path, "camera", expected="an image of the chart per camera", found=f"none for {listed(missing)}"
        )
    images = [image for image in images if image["camera"] not in missing]
    patches = read_patches_csv(root, section.patches, section.illuminant, complaints)
    digest = digest_file(root / section.patches) if patches is not None else None
    corners = read_corners_csv(root, section.corners, list(cameras["camera"]), complaints) if section.corners else {}
    content = {"method": section.method, "transfer": section.transfer, "images": images, "corners": corners}
    if patches is not None and patches.places is not None:
        content["places"] = patches.places
        if missing := [camera for camera in cameras["camera"] if camera not in corners]:
            hint = "only the classic chart of 24 patches is found by itself"
            expected, found = "where the chart lies, for every camera", f"none for {listed(missing)}"
            complaints.add(MANIFEST, "calibration.color.corners", expected=expected, found=found, hint=hint)
    values = None if patches is None else patches.values
    content |= {"patches": values, "patches_digest": digest, "mosaic": section.mosaic}
    content |= {"black_level": section.black_level, "exposures": []}
    if section.exposures is not None:
        content["exposures"] = read_exposures_csv(root, section.exposures, list(cameras["camera"]), complaints)
    kind: Literal["color", "pattern"] = "color" if section.mosaic is None else "pattern"
    shown = images + content["exposures"]
    return content, [ExpectedImage(image["path"], kind, image["camera"], None) for image in shown]


def read_exposures_csv(root: Path, path: str, cameras: Collection[str], complaints: Complaints) -> list[dict[str, Any]]:
    """Camera, path and exposure_s of each image of a series of exposures.

    A camera may have none.
    """
    table = read_csv(root, path, EXPOSURE_COLUMNS, complaints)
    if table is None:
        return []
    complain_unknown(complaints, path, "camera", table["camera"], cameras, "the table of cameras")
    complain_repeats(complaints, path, table, ["path"])
    if (bad := ~(table["exposure_s"] > 0)).any():
        complain_rows(complaints, path, "exposure_s", bad, "more than 0 seconds", table["exposure_s"])
    for camera, rows in table.groupby("camera"):
        if (count := rows["exposure_s"].nunique()) < FEWEST_EXPOSURES:
            expected = f"at least {FEWEST_EXPOSURES} exposure times"
            complaints.add(path, f"{camera}: exposure_s", expected=expected, found=str(count))
    return [{"camera": row.camera, "path": row.path, "exposure_s": float(row.exposure_s)} for row in table.itertuples()]


def read_color_matrices(
    root: Path, path: str, cameras: Collection[str], complaints: Complaints
) -> dict[str, list[list[float]]]:
    """Corrected-from-raw matrix of each camera.

    Complains about cameras without 3 x 3 finite numbers that can be inverted, or those and a polynomial's.
    """
    content: Any = {}
    with complaints.collecting():
        content = read_json(locate(root, path))
    matrices = content.get("cameras") if isinstance(content, dict) else None
    if not isinstance(matrices, dict):
        if content != {}:
            complaints.add(path, "cameras", expected="a matrix for each camera", found="no such key")
        return {}
    found = {}
    for camera in cameras:
        try:
            matrix = np.asarray(matrices.get(camera), np.float64)
        except (TypeError, ValueError):
            matrix = np.zeros(0)
        sized = matrix.shape in [(3, columns) for columns in POLYNOMIALS] and bool(np.isfinite(matrix).all())
        if sized and np.linalg.matrix_rank(matrix[:, :3]) == 3:
            found[camera] = matrix.tolist()
        else:
            columns = ", ".join(map(str, POLYNOMIALS))
            expected = f"3 rows of finite numbers, as many as {columns}, whose first 3 columns can be inverted"
            complaints.add(path, f"camera {camera}", expected=expected, found=repr(matrices.get(camera)))
    return found


def read_corners_csv(
    root: Path, path: str, cameras: Collection[str], complaints: Complaints
) -> dict[str, list[list[float]]]:
    """Corners 0..3 of each camera's chart, pixels; a camera may be left out.

    They are for cameras in whose images the chart is not found automatically; the first pixel's centre is at (0.5,
    0.5). Corner 0 is the outermost corner of patch 1, corner 1 that of patch 6, corner 2 that of patch 24, corner 3
    that of patch 19: they go around the block of patches, without the chart's frame.
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
