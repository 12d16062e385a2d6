"""Changes to images: of frames, masks, boards, mirror balls and the colour chart."""

from __future__ import annotations

import random
import struct
import zlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
import OpenEXR

from tests.support.chaos.mutations.mutation import Meaning, Mutation, remove, replace

BROKEN, SAME, OTHER = Meaning.BROKEN, Meaning.SAME, Meaning.OTHER

Change = Callable[[np.ndarray], np.ndarray]

SHAPES: dict[str, Change] = {
    "half its size": lambda image: np.ascontiguousarray(image[::2, ::2]),
    "a row less": lambda image: image[:-1],
    "transposed": lambda image: np.ascontiguousarray(image.swapaxes(0, 1)),
    "one pixel": lambda image: image[:1, :1],
}
CONTENTS: dict[str, Change] = {
    "mirrored": lambda image: np.ascontiguousarray(image[:, ::-1]),
    "upside down": lambda image: np.ascontiguousarray(image[::-1]),
    "black": np.zeros_like,
    "white": lambda image: np.full_like(image, 255 if image.dtype == np.uint8 else 1),
    "inverted": lambda image: (255 - image) if image.dtype == np.uint8 else (image.max() - image),
    "moved by a quarter": lambda image: np.roll(image, image.shape[1] // 4, 1),
}
FLOATS: dict[str, Change] = {
    "with one NaN": lambda image: _with_pixel(image, np.nan),
    "with an infinity": lambda image: _with_pixel(image, np.inf),
    "all NaN": lambda image: np.full_like(image, np.nan),
    "with a pixel of -60000": lambda image: _with_pixel(image, -60000.0),
    "with a pixel of 65504": lambda image: _with_pixel(image, 65504.0),
}


def of_one(name: str, rng: random.Random) -> Iterator[Mutation]:
    """Changes to one image that its decoder or its table of cameras tells."""
    for what, change in SHAPES.items():
        yield _images([name], f"is {what}", BROKEN, change)
    for what, change in CONTENTS.items():
        # Of one image among many, nobody can tell what it should show; what stands on it holds all the same.
        yield _images([name], f"is {what}", OTHER, change)
    if name.endswith(".exr"):
        for what, change in FLOATS.items():
            yield _images([name], what, OTHER if "pixel" in what else BROKEN, change)
        yield Mutation(
            name, "with channels X, Y, Z", BROKEN, lambda root: _write_exr(root / name, _read(root / name), "XYZ")
        )
        yield Mutation(name, "a PNG of its name", BROKEN, lambda root: replace(root / name, _png(8, 8)))
    else:
        yield Mutation(name, "a PNG of 60000 x 60000", BROKEN, lambda root: replace(root / name, _png(60_000, 60_000)))
        yield Mutation(name, "a PNG of no pixel", BROKEN, lambda root: replace(root / name, _png(0, 0)))
        yield _images(
            [name],
            "of four channels",
            BROKEN,
            lambda image: np.dstack([_three(image), image if image.ndim == 2 else image[..., 0]]),
        )
        yield _images(
            [name],
            "of 16 bits",
            BROKEN if name.startswith("masks") else OTHER,
            lambda image: image.astype(np.uint16) * 257,
        )
    position = rng.random()
    yield Mutation(name, "with a wrong byte", OTHER, lambda root: _flip_byte(root / name, position))


def of_many(kind: str, names: Sequence[str]) -> Iterator[Mutation]:
    """The same change to all images of a kind: everything that stands on them is wrong."""
    for what, change in CONTENTS.items():
        yield _images(names, what, BROKEN, change, kind)


def exchanged(kind: str, first: str, second: str, names: Sequence[str]) -> Mutation:
    """All images of two folders in each other's place."""

    def apply(root: Path) -> None:
        for name in (name for name in names if f"/{first}/" in name):
            one, two = root / name, root / name.replace(f"/{first}/", f"/{second}/")
            aside = root / "aside"
            if not two.exists():
                continue
            one.rename(aside)
            two.rename(one)
            aside.rename(two)

    return Mutation(kind, f"{first} and {second} exchanged", BROKEN, apply)


def _images(names: Sequence[str], what: str, meaning: Meaning, change: Change, kind: str = "") -> Mutation:
    def apply(root: Path) -> None:
        for path in (root / name for name in names):
            changed = change(_read(path))
            if path.suffix == ".exr":
                _write_exr(path, changed)
            else:
                encoded = cv2.imencode(
                    ".png" if path.suffix == ".png" or changed.dtype != np.uint8 else path.suffix, changed
                )[1]
                replace(path, encoded.tobytes())

    return Mutation(kind or names[0], what, meaning, apply)


def _read(path: Path) -> np.ndarray:
    if path.suffix != ".exr":
        return cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    with OpenEXR.File(str(path), separate_channels=True) as file:
        channels = file.channels()
        return np.stack([channels[name].pixels for name in "RGB"], -1)


def _write_exr(path: Path, image: np.ndarray, names: str = "RGB") -> None:
    planes = {name: np.ascontiguousarray(image[..., place]) for place, name in enumerate(names)}
    remove(path)
    OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}, planes).write(str(path))


def _with_pixel(image: np.ndarray, value: float) -> np.ndarray:
    image = image.copy()
    image[image.shape[0] // 2, image.shape[1] // 2] = value
    return image


def _three(image: np.ndarray) -> np.ndarray:
    return np.dstack([image] * 3) if image.ndim == 2 else image


def _png(width: int, height: int) -> bytes:
    """A PNG that says so of itself, with hardly any data."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(bytes(72))) + chunk(b"IEND", b"")


def _flip_byte(path: Path, position: float) -> None:
    content = bytearray(path.read_bytes())
    content[int(position * len(content))] ^= 0xFF
    replace(path, bytes(content))
