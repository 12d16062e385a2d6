"""Images of a chunk of frames, and a share of the calibration's, inspected by a job.

It writes a table, from which the index is then made.
Such a job complains about nothing. It looks at what is there and decodes it; whoever makes the index says all that is
wrong at once, as if it had inspected every image itself, and inspects those of which no table says anything.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import astuple
from itertools import chain
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.errors import Complaints, InputError
from pipeline.base.files import read_table, write_table
from pipeline.capture.archives import is_there
from pipeline.capture.index import tables
from pipeline.capture.index.calibration_sections import find_calibration
from pipeline.capture.index.contents import image_source
from pipeline.capture.index.exchanged_images import Compared
from pipeline.capture.index.frame_images import IMAGE_COLUMNS, expected_images
from pipeline.capture.index.image_checks import ExpectedImage, Flaw, Inspection, inspections
from pipeline.capture.index.parquet_tables import read_parquet
from pipeline.capture.paths import fill
from pipeline.capture.schema.capture_yaml import Capture
from pipeline.capture.schema.manifest import read_manifest

COLUMNS = ("what", "camera", "path", "digest", "black", "unreadable", "flaws", "reduced")
"""Of the table. `flaws` is a JSON list of [camera, key, expected, found], empty for none; `reduced` is null but for the
few images that are compared with other cameras' masks, 4 kB each."""


class InspectedImages:
    """Inspections by image, of tables of them: about 300 bytes each.

    Args:
        paths: the tables.

    Raises:
        InputError: if a file is no such table.
    """

    def __init__(self, paths: Iterable[Path]) -> None:
        # By purpose and camera first: one file may be named for two of them, and need not be right for both.
        self._found: dict[tuple[str, str], dict[str, Inspection]] = {}
        for path in paths:
            table = read_table(path)
            if tuple(table.columns) != COLUMNS:
                raise InputError(f"{path}: expected columns {', '.join(COLUMNS)}, found {', '.join(table.columns)}")
            for what, camera, name, *rest in zip(*(table[column].tolist() for column in COLUMNS), strict=True):
                self._found.setdefault((what, camera), {})[name] = _inspection(*rest)

    def __call__(self, image: ExpectedImage) -> Inspection | None:
        """Inspection of an image; None if no table has it."""
        return self._found.get((image.what, image.camera), {}).get(image.path)


def _inspection(digest: str, black: bool, unreadable: str, flaws: str, reduced: bytes | None) -> Inspection:
    small = None if reduced is None else np.frombuffer(reduced, np.float32)
    known = tuple(Flaw(*each) for each in json.loads(flaws)) if flaws else ()
    return Inspection(digest, known, unreadable, black, small)


def inspect_frames(root: Path, out: Path, first: int, count: int, threads: int) -> int:
    """Inspect the images and masks of some frames and write their table; returns their number.

    Photographs of the calibration are shared by the jobs as the frames are, in their order. What is in doubt is left
    out: a table that cannot be read, a camera that none lists, a file that is missing.

    Args:
        root: folder of the capture.
        out: table to write.
        first, count: of the sorted frames, the position of the first and their number.
        threads: that decode.
    """
    rows = []
    for image, found in inspections(root, _images(root, first, count), threads):
        flaws = json.dumps([astuple(flaw) for flaw in found.flaws]) if found.flaws else ""
        reduced = None if found.reduced is None else found.reduced.tobytes()
        rows.append((image.what, image.camera, image.path, found.digest, found.black, found.unreadable, flaws, reduced))
    write_table(out, pd.DataFrame(rows, columns=list(COLUMNS)).astype({"black": bool, "reduced": object}))
    return len(rows)


def _images(root: Path, first: int, count: int) -> Iterable[ExpectedImage]:
    ignored = Complaints(root)
    try:
        manifest = read_manifest(root, ignored)
    except InputError:
        return []
    if not manifest.images or not manifest.cameras or not manifest.frames:
        return []
    cameras = tables.read_cameras_csv(root, manifest.cameras, manifest.images.downsample_from_sensor, ignored)
    frames = tables.read_frames_csv(root, manifest.frames, ignored)
    if cameras is None or frames is None:
        return []
    lights = tables.read_lights_csv(root, manifest.lights, ignored) if manifest.lights else None
    photographs = find_calibration(root, manifest, cameras, lights, ignored)[1]
    place = np.arange(len(photographs)) * len(frames) // max(len(photographs), 1)
    shared = [photographs[n] for n in np.flatnonzero((place >= first) & (place < first + count))]
    there = [image for image in shared if is_there(root / image.path)]
    numbers, pattern = np.sort(frames["frame"].to_numpy()), manifest.images.table is None
    listed = _listed(root, manifest, cameras["camera"].tolist(), numbers.tolist(), ignored)
    compared = Compared.among(listed, cameras, image_source(root, manifest, frames))
    known = listed["camera"].isin(cameras["camera"]) & listed["frame"].isin(numbers[first : first + count])
    listed = listed[known].copy()
    keys = list(zip(listed["camera"], listed["frame"], strict=True))
    for column in ("path", "mask_path"):
        paths = [path if isinstance(path, str) else None for path in listed[column]]
        if pattern:
            paths = [p and fill(p, camera=c, frame=n) for p, (c, n) in zip(paths, keys, strict=True)]
        listed[column] = [path if path and is_there(root / path) else None for path in paths]
    return chain(there, expected_images(listed[listed["path"].notna()], cameras, manifest, compared))


def _listed(
    root: Path, manifest: Capture, cameras: list[str], numbers: list[int], complaints: Complaints
) -> pd.DataFrame:
    """Images that a capture names, whether or not they are there; columns of `IMAGE_COLUMNS`.

    Of captures that name them by patterns, paths are the patterns: filled in for all frames they take seconds.
    """
    images, masks = manifest.images, manifest.masks
    if images.table is not None:
        table = read_parquet(root, images.table, IMAGE_COLUMNS, complaints)
        return pd.DataFrame(columns=list(IMAGE_COLUMNS)) if table is None else table
    keys = pd.MultiIndex.from_product([cameras, numbers], names=["camera", "frame"]).to_frame(index=False)
    return keys.assign(path=images.path, mask_path=None if masks is None else masks.path)
