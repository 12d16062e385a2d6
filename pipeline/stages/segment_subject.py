"""Photographs in, masks of the subject out, by clean plates or else by a network.

For captures without masks. Only fully lit frames get one. A clean plate is the camera's image of the empty, fully lit
stage (`masks.clean_plates` of capture.yaml); the network is a program of another environment, see
`pipeline.detection.detector`.
"""

from __future__ import annotations

import logging
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.command import run_as_command
from pipeline.base.errors import InputError
from pipeline.base.files import digest_file, write_table
from pipeline.base.progress import progress
from pipeline.capture.images import read_mask, read_stored, write_png
from pipeline.capture.paths import fill
from pipeline.config.segment_subject import SegmentSubject
from pipeline.detection.clean_plates import mask_by_plate, measure_noise
from pipeline.detection.detector import run_detector
from pipeline.detection.photographs import Photographs, read_photographs, write_pictures
from pipeline.figures.detected_sheet import draw_masks

log = logging.getLogger("segment_subject")

HALF_PRECISION = 2.0**-11
"""Relative step of half floats, which .exr files store."""


def run(*, capture: Path, out: Path, settings: SegmentSubject = SegmentSubject()) -> None:
    """Mask the subject in fully lit photographs.

    Args:
        capture: the capture folder; capture.yaml lies at its root.
        out: folder for masks/, masks.parquet and masks.png.
        settings: see the flags below.
    """
    photographs = read_photographs(capture, settings.frames == "all")
    section = photographs.manifest.masks
    plates = None if section is None else section.clean_plates
    if plates is not None and settings.frames == "all":
        raise InputError("segment_subject: frames: expected fully_lit, as clean plates are, found all")
    log.info("masks by %s for %s", "clean plates" if plates else "a network", photographs.said)
    masks = by_plates(photographs, plates) if plates else by_network(photographs, settings.detector)
    rows = []
    for row, mask in zip(photographs.images.itertuples(), masks, strict=True):
        path = f"{row.camera}/{row.frame:06d}.png"
        if mask.any():
            write_png(out / "masks" / path, mask)
            rows.append((row.camera, row.frame, path, digest_file(out / "masks" / path), mask.mean() / 255))
    table = pd.DataFrame(rows, columns=["camera", "frame", "mask_path", "digest", "share"])
    if len(table) < len(photographs.images):
        log.warning("no subject in %d of %d images", len(photographs.images) - len(table), len(photographs.images))
    write_table(out / "masks.parquet", table)
    draw_masks(out / "masks.png", photographs, table, out / "masks")


def by_plates(photographs: Photographs, pattern: str) -> Iterator[np.ndarray]:
    """Masks of the images, in their order, by what differs from the camera's plate.

    Raises:
        InputError: if a plate cannot be read, or is of another size than the camera's images.
    """
    source, camera = photographs.source, None
    for row in progress(list(photographs.images.itertuples()), "masks"):
        if row.camera != camera:
            camera, path = row.camera, fill(pattern, camera=row.camera)
            plate = source.read(path, None)
            width, height = photographs.sizes[camera]
            if plate.shape[:2] != (height, width):
                found = f"{plate.shape[1]} x {plate.shape[0]}"
                raise InputError(f"{path}: expected {width} x {height} pixels, as the camera's images, found {found}")
            noise, step = measure_noise(plate), stored_step(source.folder / path, plate)
        yield mask_by_plate(source.read(row.path, row.frame), plate, noise, step)


def stored_step(path: Path, image: np.ndarray) -> float:
    """Smallest difference of brightness that a file stores, relative to its white."""
    dtype = read_stored(path).dtype
    return 1 / np.iinfo(dtype).max if dtype.kind == "u" else float(np.median(np.abs(image))) * HALF_PRECISION + 1e-7


def by_network(photographs: Photographs, detector: str) -> list[np.ndarray]:
    """Masks of the images, in their order, by a detector.

    Raises:
        InputError: if it fails, or a mask is not there or of another size than its image.
    """
    with tempfile.TemporaryDirectory() as folder:
        pictures, masks = write_pictures(photographs, Path(folder)), Path(folder) / "masks"
        run_detector(detector, ["masks", "--images", str(pictures), "--out", str(masks)])
        found = []
        for number, row in enumerate(photographs.images.itertuples()):
            mask = read_mask(masks / f"{number:06d}.png")
            if mask.shape[::-1] != photographs.sizes[row.camera]:
                raise InputError(
                    f"detector: expected a mask of the size of {row.path}, found {mask.shape[1]} x {mask.shape[0]}"
                )
            found.append(mask)
    return found


def main() -> None:
    """Command line of this stage."""
    run_as_command(run)


if __name__ == "__main__":
    main()
