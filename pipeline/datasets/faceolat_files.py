"""Files of FaceOLAT: images of a capture, and calibrations beside the set's programs."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.errors import Complaints, InputError, listed
from pipeline.base.spread import evenly
from pipeline.capture.archives import read_bytes
from pipeline.capture.images import decode_image, decode_stored
from pipeline.datasets.imported_capture import ImageStore
from pipeline.datasets.layout import require
from pipeline.geometry.cameras import Camera

TRANSFER = "gamma_2.2"

PROGRAMS = "it comes with the set's programs, prraoo/FaceOLAT: copy {} beside the folders of cameras"

LIGHTS = "relighting/lights"
PATTERN_FILE, FRAME_FILE = f"{LIGHTS}/light_pattern_metadata.json", f"{LIGHTS}/light_pattern_per_frame.json"

REEXPOSED, REEXPOSURE = ("2", range(88, 117)), 2.0
"""Expression and subjects that were recorded darker, and the factor on their light in the set's own program."""


@dataclass(frozen=True)
class CaptureName:
    """Name of a capture.

    Attributes:
        text: as its folders are called, ID20003.
        expression: the first digit of its number.
        subject: the last three.
    """

    text: str
    expression: str
    subject: int

    @property
    def calibration(self) -> str:
        """The file of its cameras, below that of the set's programs."""
        return f"calibration/cameras/{self.subject:03d}.xml"

    @property
    def exposure(self) -> float:
        """Factor on its light that makes it as bright as other captures."""
        expression, subjects = REEXPOSED
        return REEXPOSURE if self.expression == expression and self.subject in subjects else 1.0


def choose_capture(root: Path, segments: Collection[str]) -> CaptureName:
    """The one capture that is read.

    Raises:
        InputError: if there are several and none, or more than one, is chosen.
    """
    there = sorted({path.name for path in root.glob("Cam*/ID*") if re.fullmatch(r"ID\d{5}", path.name)})
    if not there:
        raise InputError(f"{root}: expected folders Cam01/ID20003 and so on, found none; is it the set's OutputAVIF?")
    chosen = list(segments) or there
    if len(chosen) != 1 or chosen[0] not in there:
        expected = f"one capture of {listed(there, 20)}, as each is of another expression or person"
        raise InputError(f"import_capture.segments: expected {expected}, found {listed(chosen)}")
    text = chosen[0]
    return CaptureName(text, text[2], int(text[-3:]))


def find_programs(root: Path, capture: CaptureName) -> Path:
    """The folder that holds calibrations and lights: that of the images, or one above it.

    Raises:
        InputError: naming what is not there.
    """
    names = {name: PROGRAMS.format(name.split("/")[0]) for name in (capture.calibration, PATTERN_FILE, FRAME_FILE)}
    places = [root, root.parent, root.parent.parent]
    best = max(places, key=lambda place: sum((place / name).is_file() for name in names))
    complaints = Complaints(best)
    require(best, names, complaints)
    complaints.raise_if_any()
    return best


def find_images(root: Path, capture: CaptureName, wanted: Collection[str]) -> dict[str, dict[int, str]]:
    """Path of each image by camera and number.

    Raises:
        InputError: if one of the `wanted` cameras has none.
    """
    found: dict[str, dict[int, str]] = {}
    for path in sorted(root.glob(f"Cam*/{capture.text}/*.avif")):
        if match := re.fullmatch(rf"{capture.text}\.(\d{{6}})\.avif", path.name):
            found.setdefault(path.parent.parent.name, {})[int(match[1])] = str(path.relative_to(root))
    if absent := sorted(set(wanted) - set(found)):
        known = listed(sorted(found), 20)
        raise InputError(f"import_capture.cameras: expected some of {known}, found {listed(absent)}")
    if not found:
        raise InputError(f"{root}: expected images {capture.text}.000001.avif and so on, found none")
    return {name: images for name, images in found.items() if not wanted or name in wanted}


def image_store(
    root: Path, images: Mapping[str, Mapping[int, str]], cameras: Mapping[str, Camera], frames: Collection[int]
) -> ImageStore:
    """The images of the frames; there are no masks.

    Raises:
        InputError: if images are not the sensor's size over one whole number.
    """
    rows, sizes, factors = [], {}, {}
    for name, camera in cameras.items():
        rows += [(name, number, images[name][number], None) for number in frames if number in images[name]]
        path = root / next(iter(images[name].values()))
        height, width = decode_stored(read_bytes(path), path).shape[:2]
        sizes[name], factors[name] = (width, height), camera.width / width
        if camera.width != factors[name] * width or camera.height != factors[name] * height or factors[name] % 1:
            expected = f"{camera.width} x {camera.height} pixels, as the camera was calibrated, or a whole part of it"
            raise InputError(f"{path}: expected {expected}, found {width} x {height}")
    if len(set(factors.values())) > 1:
        raise InputError(f"{root}: expected images of one size, found {sorted(set(sizes.values()))}")
    table = pd.DataFrame(rows, columns=["camera", "frame", "path", "mask_path"])
    table = table.astype({"camera": "str", "frame": "int64", "path": "str", "mask_path": "str"})
    return ImageStore(table, sizes, TRANSFER, 0.0, int(next(iter(factors.values()))))


def brightness(root: Path, images: Mapping[str, Mapping[int, str]], numbers: Collection[int]) -> dict[int, float]:
    """Mean light of some images of the middle camera, by number."""
    own = images[evenly(sorted(images), 3)[len(images) > 1]]
    paths = {number: root / own[number] for number in sorted(numbers) if number in own}
    return {number: float(np.mean(decode_image(read_bytes(path), path, TRANSFER))) for number, path in paths.items()}
