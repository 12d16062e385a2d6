"""A tiny capture whose images or masks are broken one way at a time: each break must be named."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.support.captures.broken import Break, check_break, read_complaints, read_shared_complaints
from tests.support.captures.builder import (
    HEIGHT,
    WIDTH,
    save,
    save_exr,
    truncate,
)


def link_outside(root: Path) -> None:
    outside = root.parent / "elsewhere.exr"
    (root / "images/left/000001.exr").rename(outside)
    (root / "images/left/000001.exr").symlink_to(outside)


def nan_pixels(root: Path) -> None:
    image = np.full((HEIGHT, WIDTH, 3), 0.5)
    image[0, 0, 1], image[2, 3, 0] = np.nan, np.inf
    save_exr(root / "images/left/000002.exr", image)


IMAGE_BREAKS: dict[str, tuple[Break, list[str]]] = {
    "no image of a camera": (
        lambda root: shutil.rmtree(root / "images/right"),
        ["images: right: expected one for each of 3 frames, found none at all"],
    ),
    "an image missing": (
        lambda root: (root / "images/left/000001.exr").unlink(),
        ["images: left: expected one for each frame, found 1 of 3 images missing: 1"],
    ),
    "a mask missing": (
        lambda root: (root / "masks/left/000001.png").unlink(),
        ["masks: left", "1 of 3 masks missing: 1"],
    ),
    "truncated image": (
        lambda root: truncate(root / "images/left/000001.exr"),
        ["images/left/000001.exr: expected a whole OpenEXR image"],
    ),
    "empty image": (
        lambda root: truncate(root / "images/left/000001.exr", 0),
        ["images/left/000001.exr: expected a whole OpenEXR"],
    ),
    "truncated mask": (
        lambda root: truncate(root / "masks/left/000001.png"),
        ["masks/left/000001.png: expected a whole image"],
    ),
    "image size": (
        lambda root: save_exr(root / "images/left/000001.exr", np.zeros((3, 4, 3))),
        ["images/left/000001.exr: left: size: expected 8 x 6 pixels", "found 4 x 3"],
    ),
    "all masks black": (
        lambda root: [save(path, np.zeros((HEIGHT, WIDTH), np.uint8)) for path in root.glob("masks/*/*.png")],
        ["masks: pixels: expected the subject in some, found none above 0 in all 6 masks"],
    ),
    "mask size": (
        lambda root: save(root / "masks/left/000001.png", np.zeros((3, 4), np.uint8)),
        ["masks/left/000001.png: left: size", "found 4 x 3"],
    ),
    "channel names": (
        lambda root: save_exr(root / "images/left/000001.exr", np.zeros((6, 8, 3)), "XYZ"),
        ["channels R, G, B, found X, Y, Z"],
    ),
    "one channel": (
        lambda root: save_exr(root / "images/left/000001.exr", np.zeros((6, 8, 1)), "Y"),
        ["three channels R, G, B, found 1 channel"],
    ),
    "mask of 16 bit": (
        lambda root: save(root / "masks/left/000001.png", np.zeros((6, 8), np.uint16)),
        ["expected a mask of one 8-bit channel", "uint16"],
    ),
    "mask in colour": (
        lambda root: save(root / "masks/left/000001.png", np.zeros((6, 8, 3), np.uint8)),
        ["found 3 channels"],
    ),
    "mask of zero and one": (
        lambda root: save(root / "masks/left/000001.png", np.eye(6, 8, dtype=np.uint8)),
        ["expected 0 to 255, 255 = subject"],
    ),
    "nan and inf": (
        nan_pixels,
        ["images/left/000002.exr: left: pixels: expected finite numbers, found 2 of 48 pixels"],
    ),
    "link that leaves": (link_outside, ["images/left/000001.exr: expected a file inside the capture", "elsewhere.exr"]),
}


@pytest.mark.parametrize("name", IMAGE_BREAKS)
def test_image_complaint(name: str, known: Path, tmp_path: Path) -> None:
    check_break(known, tmp_path, *IMAGE_BREAKS[name])


@pytest.mark.parametrize("name", IMAGE_BREAKS)
def test_image_that_another_job_inspected_is_complained_of_in_the_same_words(name: str, known: Path, tmp_path: Path):
    broken = shutil.copytree(known, tmp_path / "capture", symlinks=True)
    IMAGE_BREAKS[name][0](broken)
    assert read_shared_complaints(broken, tmp_path) == read_complaints(broken)
