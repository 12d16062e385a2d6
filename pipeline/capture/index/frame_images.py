"""The images of the moving subject, and their masks: one per camera and frame."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from pipeline.base.errors import Complaints, listed
from pipeline.capture.index.image_checks import ExpectedImage
from pipeline.capture.paths import fill
from pipeline.capture.schema.capture_yaml import Capture


def find_frame_images(
    root: Path, manifest: Capture, cameras: pd.DataFrame | None, frames: pd.DataFrame | None, complaints: Complaints
) -> pd.DataFrame:
    """Table of the images that are there, by camera and frame.

    Columns are camera, frame, path, mask_path (null without masks). Complains, in one line per camera, about those that
    are not. Empty if a table is in doubt.
    """
    columns = {"camera": [], "frame": [], "path": [], "mask_path": []}
    if manifest.images is not None and cameras is not None and frames is not None:
        _check_distinct(manifest.images.path, cameras, frames, complaints)
        for camera in dict.fromkeys(cameras["camera"]):
            numbers = list(dict.fromkeys(frames["frame"]))
            paths = _present(root, manifest.images.path, "images", camera, numbers, complaints)
            masks = {}
            if manifest.masks is not None:
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
    missing = {frame for frame, path in paths.items() if not (root / path).is_file()}
    if missing and len(missing) == len(frames):
        found = f"none at all; the first would be {paths[frames[0]]}"
        complaints.add(what, camera, expected=f"one for each of {len(frames)} frames", found=found)
    elif missing:
        found = f"{len(missing)} of {len(frames)} {what} missing: {listed(sorted(missing))}"
        complaints.add(what, camera, expected="one for each frame", found=found)
    return {frame: path for frame, path in paths.items() if frame not in missing}


def _check_distinct(pattern: str, cameras: pd.DataFrame, frames: pd.DataFrame, complaints: Complaints) -> None:
    """`{camera}{frame}` gives one path for camera c1, frame 1 and for camera c, frame 11."""
    names, numbers = set(cameras["camera"]), set(frames["frame"])
    if len({fill(pattern, camera=c, frame=f) for c in names for f in numbers}) < len(names) * len(numbers):
        found = f"{pattern}, the same path for two of them"
        complaints.add("images", "path", expected="a path of its own for each camera and frame", found=found)


def expected_images(images: pd.DataFrame, cameras: pd.DataFrame | None) -> list[ExpectedImage]:
    """Expectations of the images and masks found."""
    sizes = {} if cameras is None else {row.camera: (row.width, row.height) for row in cameras.itertuples()}
    expected = []
    for row in images.itertuples():
        expected.append(ExpectedImage(row.path, "color", row.camera, sizes[row.camera]))
        if isinstance(row.mask_path, str):
            expected.append(ExpectedImage(row.mask_path, "mask", row.camera, sizes[row.camera]))
    return expected
