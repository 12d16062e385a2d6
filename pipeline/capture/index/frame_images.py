"""The images of the moving subject, and their masks: one per camera and frame."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import pandas as pd

from pipeline.base.errors import Complaints, listed
from pipeline.capture.archives import is_there
from pipeline.capture.index.csv_tables import DTYPES, Kind, complain_repeats, complain_unknown
from pipeline.capture.index.exchanged_images import Compared
from pipeline.capture.index.image_checks import ExpectedImage
from pipeline.capture.index.parquet_tables import read_parquet
from pipeline.capture.mask_format import MaskFormat
from pipeline.capture.paths import check_relative, fill
from pipeline.capture.schema.capture_yaml import Capture
from pipeline.capture.schema.manifest import MANIFEST

IMAGE_COLUMNS: Mapping[str, Kind] = {"camera": "name", "frame": "whole", "path": "text", "mask_path": "text"}


def find_frame_images(
    root: Path, manifest: Capture, cameras: pd.DataFrame | None, frames: pd.DataFrame | None, complaints: Complaints
) -> pd.DataFrame:
    """Table of the images that are there, by camera and frame.

    Columns are camera, frame, path, mask_path (null without masks). Complains, in one line per camera, about those that
    are not. Empty if a table is in doubt.
    """
    columns = {"camera": [], "frame": [], "path": [], "mask_path": []}
    if manifest.images is not None and cameras is not None and frames is not None:
        if manifest.images.table is not None:
            return read_images_table(root, manifest, cameras, frames, complaints)
        masks = manifest.masks
        if masks is not None and (masks.path is None) == (masks.clean_plates is None):
            found = "neither" if masks.path is None else "both"
            complaints.add(MANIFEST, "masks.path", expected="this pattern, or else masks.clean_plates", found=found)
        _check_distinct(manifest.images.path, cameras, frames, complaints)
        for camera in dict.fromkeys(cameras["camera"]):
            numbers = list(dict.fromkeys(frames["frame"]))
            paths = _present(root, manifest.images.path, "images", camera, numbers, complaints)
            masks = {}
            if manifest.masks is not None and manifest.masks.path is not None:
                masks = _present(root, manifest.masks.path, "masks", camera, numbers, complaints)
            columns["camera"] += [camera] * len(paths)
            columns["frame"] += paths.keys()
            columns["path"] += paths.values()
            columns["mask_path"] += [masks.get(frame) for frame in paths]
    return pd.DataFrame(columns).astype({"camera": "str", "frame": "int64", "path": "str", "mask_path": "str"})


def _present(
    root: Path, pattern: str, what: str, camera: str, frames: list[int], complaints: Complaints
) -> dict[int, str]:
    """Frame to path, where there is such a file."""
    paths = {frame: fill(pattern, camera=camera, frame=frame) for frame in frames}
    missing = {frame for frame, path in paths.items() if not is_there(root / path)}
    if missing and len(missing) == len(frames):
        found = f"none at all; the first would be {paths[frames[0]]}"
        complaints.add(what, camera, expected=f"one for each of {len(frames)} frames", found=found)
    elif missing:
        found = f"{len(missing)} of {len(frames)} {what} missing: {listed(sorted(missing))}"
        complaints.add(what, camera, expected="one for each frame", found=found)
    return {frame: path for frame, path in paths.items() if frame not in missing}


def mask_format(manifest: Capture) -> MaskFormat:
    """Format of the capture's masks."""
    section = manifest.masks
    reduced = 1 if manifest.images is None else manifest.images.reduced
    if section is None:
        return MaskFormat(reduced=reduced)
    return MaskFormat(None if section.labels is None else tuple(section.labels), section.enlarged, reduced)


def _check_distinct(pattern: str, cameras: pd.DataFrame, frames: pd.DataFrame, complaints: Complaints) -> None:
    """`{camera}{frame}` gives one path for camera c1, frame 1 and for camera c, frame 11."""
    names, numbers = set(cameras["camera"]), set(frames["frame"])
    if len({fill(pattern, camera=c, frame=f) for c in names for f in numbers}) < len(names) * len(numbers):
        found = f"{pattern}, the same path for two of them"
        complaints.add("images", "path", expected="a path of its own for each camera and frame", found=found)


def read_images_table(
    root: Path, manifest: Capture, cameras: pd.DataFrame, frames: pd.DataFrame, complaints: Complaints
) -> pd.DataFrame:
    """Table of the images that a capture lists one by one; columns as of `find_frame_images`."""
    path, section = manifest.images.table, manifest.masks
    if section is not None and section.path is not None:
        hint = "name the masks there, in the column mask_path"
        complaints.add(MANIFEST, "masks.path", expected="none, as images.table lists masks", found="one", hint=hint)
    table = read_parquet(root, path, IMAGE_COLUMNS, complaints)
    if table is None:
        return pd.DataFrame({name: pd.Series(dtype=DTYPES[kind]) for name, kind in IMAGE_COLUMNS.items()})
    complain_repeats(complaints, path, table, ["camera", "frame"])
    complain_unknown(complaints, path, "camera", table["camera"], list(cameras["camera"]), "the table of cameras")
    complain_unknown(complaints, path, "frame", table["frame"], list(frames["frame"]), "the table of frames")
    if blind := sorted(set(cameras["camera"]) - set(table["camera"])):
        complaints.add(path, "camera", expected="images of every camera", found=f"none of {listed(blind)}")
    if dark := sorted(set(frames["frame"]) - set(table["frame"])):
        complaints.add(path, "frame", expected="images of every frame", found=f"none of {listed(dark)}")
    for column in ("path", "mask_path"):
        outside = [value for value in table[column].dropna().unique() if not _is_relative(value)]
        if outside:
            expected, found = "paths relative to the capture, without ..", listed(outside)
            complaints.add(path, column, expected=expected, found=found)
    missing = table["path"].isna() | ~table["path"].isin([p for p in table["path"].dropna() if is_there(root / p)])
    if missing.any():
        found = f"{int(missing.sum())} that are not there: {listed(list(table['path'][missing].astype(str)))}"
        complaints.add(path, "path", expected="images", found=found)
    known = table["camera"].isin(cameras["camera"]) & table["frame"].isin(frames["frame"])
    return table[known & ~missing].sort_values(["camera", "frame"], kind="stable", ignore_index=True)


def _is_relative(path: str) -> bool:
    try:
        check_relative(path)
    except ValueError:
        return False
    return True


def expected_images(
    images: pd.DataFrame, cameras: pd.DataFrame | None, manifest: Capture, compared: Compared | None = None
) -> Iterator[ExpectedImage]:
    """Expectations of the images and masks found, one after the other.

    A mask that all images of a camera share, one after the other, is expected once.

    Args:
        images: camera, frame, path, mask_path.
        cameras: camera, width, height.
        manifest: the capture's description.
        compared: those that are reduced as they are inspected; None: none.
    """
    masks, imported = mask_format(manifest), manifest.imported is not None
    sizes = {} if cameras is None else {row.camera: (row.width, row.height) for row in cameras.itertuples()}
    before = None
    for row in images.itertuples():
        size, given = sizes[row.camera], {"masks": masks, "imported": imported, "frame": row.frame}
        given["compared"] = compared.source if compared and (row.camera, row.frame) in compared.keys else None
        yield ExpectedImage(row.path, "color", row.camera, size, **given)
        if isinstance(row.mask_path, str) and (row.camera, row.mask_path) != before:
            before = row.camera, row.mask_path
            yield ExpectedImage(row.mask_path, "mask", row.camera, size, **given)
