"""Images of a subject that stands still: numbered by light, with one mask per camera."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from pathlib import Path

import pandas as pd

from pipeline.base.errors import InputError, listed
from pipeline.capture.archives import read_bytes
from pipeline.capture.images import decode_stored
from pipeline.capture.mask_format import PLAIN_MASKS, MaskFormat
from pipeline.datasets.imported_capture import ImageStore
from pipeline.datasets.set_masks import read_set_mask


def find_images(root: Path, folder: str, wanted: Collection[str]) -> dict[str, dict[int, str]]:
    """Path of each image `<folder>/Cam01/<capture>.000014.avif` by camera and number.

    Raises:
        InputError: if there is none, or not one of the `wanted` cameras.
    """
    found: dict[str, dict[int, str]] = {}
    for path in sorted((root / folder).glob("Cam*/*.avif")):
        if match := re.fullmatch(r".*\.(\d{6})\.avif", path.name):
            found.setdefault(path.parent.name, {})[int(match[1])] = str(path.relative_to(root))
    if not found:
        raise InputError(f"{root}/{folder}: expected images Cam01/<capture>.000014.avif and so on, found none")
    return wanted_cameras(found, wanted)


def wanted_cameras(found: Mapping[str, dict[int, str]], wanted: Collection[str]) -> dict[str, dict[int, str]]:
    """The images of the `wanted` cameras; of all, if none is named.

    Raises:
        InputError: if one of these is not there.
    """
    if absent := sorted(set(wanted) - set(found)):
        known = listed(sorted(found), 20)
        raise InputError(f"import_capture.cameras: expected some of {known}, found {listed(absent)}")
    return {name: images for name, images in found.items() if not wanted or name in wanted}


def image_store(
    root: Path, names: Collection[str], images: Mapping[str, Mapping[int, str]], frames: Collection[int], masks: str
) -> ImageStore:
    """The images of the frames; all of one camera share its mask.

    Args:
        masks: path of a camera's mask, {} for its name; their subject is 255, or 1 where no value is larger.
    """
    rows, sizes, highest = [], {}, set()
    for name in names:
        mask = masks.format(name)
        has_mask = (root / mask).is_file()
        rows += [(name, n, images[name][n], mask if has_mask else None) for n in frames if n in images[name]]
        path = root / next(iter(images[name].values()))
        height, width = decode_stored(read_bytes(path), path).shape[:2]
        sizes[name] = (width, height)
        if has_mask:
            highest.add(int(read_set_mask(root / mask).max()))
    table = pd.DataFrame(rows, columns=["camera", "frame", "path", "mask_path"])
    table = table.astype({"camera": "str", "frame": "int64", "path": "str", "mask_path": "str"})
    labels = tuple(sorted(highest - {0}))
    return ImageStore(table, sizes, "srgb", 0.0, 1, MaskFormat(labels) if 1 in labels else PLAIN_MASKS)
