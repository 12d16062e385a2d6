"""Images of cameras that were exchanged, on discs that each camera sees elsewhere."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest

from pipeline.base.errors import Complaints
from pipeline.base.exr import write_exr
from pipeline.capture.images import ImageSource
from pipeline.capture.index.exchanged_images import complain_of_exchanged

SIZE = (64, 48)
PLACES = {"a": (16, 20), "b": (30, 24), "c": (46, 28)}


def disc(center: tuple[int, int], radius: int = 9) -> np.ndarray:
    x, y = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    return (x - center[0]) ** 2 + (y - center[1]) ** 2 < radius**2


@pytest.fixture
def capture(tmp_path: Path) -> tuple[Path, pd.DataFrame]:
    """Three frames; the disc moves, is textured and lit from the left in one camera and the right in another."""
    rng, rows = np.random.default_rng(3), []
    for frame in range(3):
        for number, (camera, (x, y)) in enumerate(PLACES.items()):
            inside = disc((x + frame, y - frame))
            shade = np.linspace(0.2, 1, SIZE[0])[:: 1 - 2 * (number % 2)]
            image = np.where(inside, shade * rng.uniform(0.3, 1, inside.shape), 0.01)
            paths = f"{camera}_{frame}.exr", f"{camera}_{frame}.png"
            write_exr(tmp_path / paths[0], np.repeat(image[..., None], 3, 2))
            cv2.imwrite(str(tmp_path / paths[1]), 255 * inside.astype(np.uint8))
            rows.append((camera, frame, *paths))
    return tmp_path, pd.DataFrame(rows, columns=["camera", "frame", "path", "mask_path"])


def complaints_about(folder: Path, images: pd.DataFrame, heights: tuple[int, int, int] = (48, 48, 48)) -> list[str]:
    sizes = pd.DataFrame({"camera": list(PLACES), "width": 64, "height": heights})
    complaints = Complaints("capture")
    complain_of_exchanged(images, sizes, ImageSource(folder, "linear", 0.0), complaints)
    return complaints.messages


def swapped(images: pd.DataFrame, first: str, second: str, column: str = "path") -> pd.DataFrame:
    images = images.copy()
    one, other = images.camera == first, images.camera == second
    values = images[column].copy()
    images.loc[one, column], images.loc[other, column] = values[other].to_numpy(), values[one].to_numpy()
    return images


def test_images_as_they_should_be_are_no_complaint(capture) -> None:
    assert complaints_about(*capture) == []


@pytest.mark.parametrize("column", ["path", "mask_path"])
@pytest.mark.parametrize("pair", [("a", "b"), ("a", "c"), ("b", "c")])
def test_exchanged_images_or_masks_name_the_two_cameras(capture, pair, column) -> None:
    folder, images = capture
    (message,) = complaints_about(folder, swapped(images, *pair, column))
    assert message.startswith(f"images: {', '.join(pair)}: expected the subject where the camera's own masks are")


@pytest.mark.parametrize(
    ("turn", "how"),
    [((slice(None), slice(None, None, -1)), "mirrored"), ((slice(None, None, -1), slice(None)), "upside down")],
)
def test_turned_images_of_a_camera_are_named(capture, turn, how) -> None:
    folder, images = capture
    source = ImageSource(folder, "linear", 0.0)
    for path in images.path[images.camera == "c"]:
        write_exr(folder / path, np.ascontiguousarray(source.read(path, None)[turn]))
    (message,) = complaints_about(folder, images)
    assert message.startswith("images: c: expected the subject where the camera's own masks are")
    assert f"found images that fit these masks {how}" in message


@pytest.mark.parametrize(("quarters", "how"), [(1, "to the left"), (-1, "to the right")])
def test_square_images_a_quarter_turn_round_are_named(tmp_path: Path, quarters: int, how: str) -> None:
    """Those of other shapes have another size then, which the table of cameras tells."""
    rng, rows = np.random.default_rng(4), []
    for camera, center in {"a": (20, 12), "b": (40, 30)}.items():
        for frame in range(2):
            inside = disc((center[0] + frame, center[1]))
            square = np.zeros((64, 64), bool)
            square[:48] = inside
            image = np.where(square, rng.uniform(0.3, 1, square.shape), 0.01)
            image = np.rot90(image, quarters) if camera == "b" else image
            paths = f"{camera}_{frame}.exr", f"{camera}_{frame}.png"
            write_exr(tmp_path / paths[0], np.ascontiguousarray(np.repeat(image[..., None], 3, 2)))
            cv2.imwrite(str(tmp_path / paths[1]), 255 * square.astype(np.uint8))
            rows.append((camera, frame, *paths))
    images = pd.DataFrame(rows, columns=["camera", "frame", "path", "mask_path"])
    (message,) = complaints_about(tmp_path, images, (64, 64, 64))
    assert message.startswith("images: b:") and f"fit these masks a quarter turn {how}" in message


def test_cameras_of_other_sizes_cannot_have_been_exchanged(capture) -> None:
    folder, images = capture
    assert complaints_about(folder, swapped(images, "a", "b"), heights=(48, 40, 48)) == []


def test_without_masks_or_with_black_images_nothing_is_said(capture) -> None:
    folder, images = capture
    assert complaints_about(folder, images.assign(mask_path=None)) == []
    for path in images.path:
        write_exr(folder / path, np.zeros((48, 64, 3)))
    assert complaints_about(folder, swapped(images, "a", "b")) == []


def test_images_that_show_no_subject_say_nothing(capture) -> None:
    folder, images = capture
    rng = np.random.default_rng(5)
    for path in images.path:
        write_exr(folder / path, rng.uniform(size=(48, 64, 3)))
    assert complaints_about(folder, images) == []
