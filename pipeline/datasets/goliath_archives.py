"""Archives of Goliath: one of images and one of masks per camera."""

from __future__ import annotations

import logging
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.errors import InputError, listed
from pipeline.capture.archives import members, read_bytes
from pipeline.capture.images import decode_stored
from pipeline.datasets.imported_capture import Provenance

log = logging.getLogger(__name__)

PARTS = "segmentation_parts"
"""Folder of the archives of part labels."""

BACKGROUNDS = "per_view_background/per_view_background.zip"

IMAGE = ("image/cam{camera}.zip/cam{camera}/", ".avif")
MASK = ("{folder}/cam{camera}.zip/cam{camera}/", ".png")
"""Paths below the set's folder, before and after the six digits of the frame's number."""


@dataclass(frozen=True)
class Archives:
    """Frames of each camera's images and masks."""

    images: Mapping[str, frozenset[int]]
    masks: Mapping[str, frozenset[int]]


def find_archives(root: Path, wanted: Collection[str], mask_folder: str = PARTS) -> Archives:
    """Frames in the archives of images and masks, of all cameras or the `wanted` ones.

    Raises:
        InputError: if there is none, or not one of those that are wanted.
    """
    names = sorted(path.stem.removeprefix("cam") for path in (root / "image").glob("cam*.zip"))
    if absent := sorted(set(wanted) - set(names)):
        raise InputError(f"import_capture.cameras: expected some of {listed(names, 20)}, found {listed(absent)}")
    chosen = [name for name in names if not wanted or name in wanted]
    # Most cameras have the same frames, and share their set: a whole stage of them takes half a gigabyte.
    shared: dict[frozenset[int], frozenset[int]] = {}
    images = {name: _frames_in(root / f"image/cam{name}.zip", name, "avif", shared) for name in chosen}
    if not chosen or (empty := [name for name, frames in images.items() if not frames]):
        found = "no archive" if not chosen else f"no such member in that of {listed(empty)}"
        raise InputError(f"{root}/image: expected archives cam*.zip with members cam*/000000.avif, found {found}")
    masks = {}
    for name in chosen:
        archive = root / f"{mask_folder}/cam{name}.zip"
        masks[name] = _frames_in(archive, name, "png", shared) if archive.is_file() else frozenset()
    return Archives(images, masks)


def _frames_in(
    archive: Path, camera: str, suffix: str, shared: dict[frozenset[int], frozenset[int]]
) -> frozenset[int]:  # fmt: skip
    pattern = re.compile(rf"cam{re.escape(camera)}/(\d{{6}})\.{suffix}")
    frames = frozenset(int(match[1]) for match in map(pattern.fullmatch, members(archive)) if match)
    return shared.setdefault(frames, frames)


def find_plates(root: Path, sizes: Mapping[str, tuple[int, int]], provenance: Provenance) -> str:
    """Pattern, with {camera}, of images of the empty stage; empty if a camera lacks one.

    The set's loader drops a fourth channel and resizes plates of another size; here such a one counts as lacking.

    Args:
        root: folder of the capture.
        sizes: width and height of the images, by camera.
        provenance: gets the note.
    """
    archive = root / BACKGROUNDS
    if not archive.is_file():
        return ""
    there, unlike = members(archive), []
    for camera, (width, height) in sizes.items():
        plate = archive / f"{camera}.png"
        if plate.name not in there or decode_stored(read_bytes(plate), plate).shape != (height, width, 3):
            unlike.append(camera)
    if unlike:
        lacking = f"cameras without one of three channels, as large as their images: {listed(unlike)}"
        provenance.left_out[BACKGROUNDS] = lacking
        log.warning("%s: backgrounds are left out; %s", root, lacking)
        return ""
    return f"{BACKGROUNDS}/{{camera}}.png"


def image_size(root: Path, camera: str, frame: int) -> tuple[int, int]:
    """Width and height of an image, pixels."""
    path = root / image_path(camera, frame)
    height, width = decode_stored(read_bytes(path), path).shape[:2]
    return width, height


def image_path(camera: str, frame: int) -> str:
    """An image, below the set's folder."""
    return f"{IMAGE[0].format(camera=camera)}{frame:06d}{IMAGE[1]}"


def image_table(
    found: Archives, frames: Collection[int], root: Path, provenance: Provenance, mask_folder: str = PARTS
) -> pd.DataFrame:
    """camera, frame, path, mask_path of the frames' images; what is lacking is named."""
    numbers, parts, lacking = np.array(sorted(frames), np.int64), [], {}
    texts = pd.Series([f"{frame:06d}" for frame in numbers.tolist()], dtype="str")
    for camera, there in found.images.items():
        kept = np.isin(numbers, np.fromiter(there, np.int64, len(there)))
        if not kept.all():
            lacking[camera] = int((~kept).sum())
        masks, own = found.masks[camera], texts[kept]
        masked = np.isin(numbers[kept], np.fromiter(masks, np.int64, len(masks)))
        (before, after), (before_mask, after_mask) = IMAGE, MASK
        paths = before.format(camera=camera) + own + after
        mask_paths = (before_mask.format(folder=mask_folder, camera=camera) + own + after_mask).where(masked)
        parts.append(pd.DataFrame({"camera": camera, "frame": numbers[kept], "path": paths, "mask_path": mask_paths}))
    if lacking:
        log.warning("%s: cameras without some of %d images: %s", root, len(frames), lacking)
        provenance.left_out["images that are not there"] = listed([f"{n} of {camera}" for camera, n in lacking.items()])
    table = pd.concat(parts, ignore_index=True)
    return table.astype({"camera": "str", "frame": "int64", "path": "str", "mask_path": "str"})
