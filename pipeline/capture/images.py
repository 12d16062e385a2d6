"""Reading and writing images: OpenEXR and PNG as linear RGB, masks, single channels.

Reading decodes the whole file: one that is truncated or of another kind is an error that names it, never a partly grey
image. Every reader has a twin that works on bytes already in memory, so that a file's digest and its pixels can come
from one read.
"""

from __future__ import annotations

import io
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import OpenEXR
from jaxtyping import Float32, Shaped, UInt8

from pipeline.base.color import DECODERS, srgb_from_linear
from pipeline.base.errors import InputError
from pipeline.base.files import written_whole
from pipeline.capture.archives import read_bytes
from pipeline.capture.mask_format import PLAIN_MASKS, MaskFormat, whole_blocks

log = logging.getLogger(__name__)

Transfer = Literal["linear", "srgb", "gamma_2.2"]

BlackLevel = float | Sequence[float]
"""Stored value of no light, of all channels or of R, G and B each."""


def read_image(
    path: Path, transfer: Transfer = "linear", black_level: BlackLevel = 0.0
) -> Float32[np.ndarray, "h w 3"]:
    """A colour image as linear RGB: `decode_image` of a file.

    Raises:
        InputError: if the file cannot be read or is not a colour image.
    """
    return decode_image(read_bytes(path), path, transfer, black_level)


@dataclass(frozen=True)
class ImageSource:
    """The images of a capture: their folder and how they store light.

    Attributes:
        folder: of the capture, which the paths of its images are relative to.
        transfer: how stored values relate to light.
        black_level: stored value of no light at all.
        masks: how the masks store which pixels are the subject.
        mask_folder: that the paths of its masks are relative to; None: that of the capture.
        exposures: exposure times gain of frames, relative to that of all others.
        reduced: stored pixels along a side of an image's pixel, which is their mean.
    """

    folder: Path
    transfer: Transfer
    black_level: BlackLevel
    masks: MaskFormat = PLAIN_MASKS
    mask_folder: Path | None = None
    exposures: Mapping[int, float] = field(default_factory=dict)
    reduced: int = 1

    @classmethod
    def from_index(cls, folder: Path, facts: Mapping[str, Any]) -> ImageSource:
        """The source that `images` of capture.json describes."""
        masks, elsewhere = MaskFormat.from_index(facts.get("masks")), facts.get("mask_folder")
        exposures = {int(frame): float(factor) for frame, factor in facts.get("exposures", {}).items()}
        return cls(
            folder, facts["transfer"], facts["black_level"], masks, Path(elsewhere) if elsewhere else None, exposures,
            facts.get("reduced", 1),
        )  # fmt: skip

    def read(self, path: str, frame: int | None) -> Float32[np.ndarray, "h w 3"]:
        """A colour image as linear RGB, as bright as if all frames were exposed alike.

        Args:
            path: of the index.
            frame: that the image belongs to; None: to none, and it is exposed as most frames are.
        """
        file = self.folder / path
        return self.linear(decode_color(read_bytes(file), file), frame)

    def linear(self, stored: Shaped[np.ndarray, "rows columns 3"], frame: int | None) -> Float32[np.ndarray, "h w 3"]:
        """Linear RGB of an image's stored values, as `read` has it."""
        image = linear_from_stored(stored, self.transfer, self.black_level)
        if self.reduced > 1:
            image = whole_blocks(image, self.reduced).mean((1, 3), dtype=np.float32)
        factor = 1.0 if frame is None else self.exposures.get(int(frame), 1.0)
        return image if factor == 1.0 else image / np.float32(factor)

    def read_mask(self, path: str, shape: tuple[int, ...]) -> UInt8[np.ndarray, "h w"]:
        """A mask, 0..255, of the rows and columns that an image's `shape` begins with.

        Raises:
            InputError: if it cannot be read, or is not of that size.
        """
        file = self.mask_file(path)
        return self.masks.fit(read_mask(file), (shape[0], shape[1]), file)

    def mask_file(self, path: str) -> Path:
        """The file of a mask, by its path of the index."""
        return (self.mask_folder or self.folder) / path


def decode_image(
    content: bytes, path: Path, transfer: Transfer = "linear", black_level: BlackLevel = 0.0
) -> Float32[np.ndarray, "h w 3"]:
    """Linear RGB of an image file's bytes.

    It is an .exr (R, G, B, half or float) or a .png, .jpg or .avif of 8 or 16 bits.

    The black level is subtracted in the units that the file stores (counts, but for .exr), then counts are divided by
    their maximum, then the transfer function is undone. Noise below the black level stays negative.

    Args:
        content: the file's bytes.
        path: names the file in messages; its suffix says the format.
        transfer: how stored values relate to light.
        black_level: stored value of no light at all.
    """
    return linear_from_stored(decode_color(content, path), transfer, black_level)


def decode_color(content: bytes, path: Path) -> Shaped[np.ndarray, "h w 3"]:
    """Stored values of a colour image, in the order R, G, B, of its own dtype.

    Raises:
        InputError: if the bytes are no image, or one of other channels.
    """
    stored = decode_stored(content, path)
    if stored.ndim != 3 or stored.shape[2] != 3:
        raise InputError(f"{path}: expected an image of the three channels R, G, B, found {_channels(stored)}")
    return stored


def linear_from_stored(
    stored: Shaped[np.ndarray, "h w 3"], transfer: Transfer, black_level: BlackLevel
) -> Float32[np.ndarray, "h w 3"]:
    """Linear RGB of stored values, as `decode_image` has it."""
    scale = np.iinfo(stored.dtype).max if stored.dtype.kind == "u" else 1
    image = (stored.astype(np.float32) - np.asarray(black_level, np.float32)) / np.float32(scale)
    return DECODERS[transfer](image) if transfer in DECODERS else image


def read_mask(path: Path) -> UInt8[np.ndarray, "h w"]:
    """A mask, 0..255, 255 being the subject.

    Raises:
        InputError: if the file cannot be read or is not one channel of 8 bits.
    """
    return decode_mask(read_bytes(path), path)


def decode_mask(content: bytes, path: Path) -> UInt8[np.ndarray, "h w"]:
    """A mask from its file's bytes."""
    stored = decode_stored(content, path)
    if stored.ndim != 2 or stored.dtype != np.uint8:
        raise InputError(f"{path}: expected a mask of one 8-bit channel, found {_channels(stored)} of {stored.dtype}")
    return stored


def read_stored(path: Path) -> np.ndarray:
    """Stored values of a file, in RGB order: [h, w] or [h, w, channels] of its own dtype."""
    return decode_stored(read_bytes(path), path)


def decode_stored(content: bytes, path: Path) -> np.ndarray:
    """Stored values from a file's bytes, as `read_stored`.

    An .exr must have the channels R, G, B or one channel of any name. The log of `DEBUG` has a line of every file.
    """
    log.debug("decode %s", path)
    if Path(path).suffix.lower() == ".exr":
        channels = _decode_exr(content, path)
        if len(channels) == 1:
            return next(iter(channels.values()))
        if set(channels) != {"R", "G", "B"}:
            raise InputError(f"{path}: expected the channels R, G, B, found {', '.join(sorted(channels)) or 'none'}")
        return np.stack([channels[name] for name in "RGB"], -1)
    # OpenCV answers None for anything it cannot decode to the end, and crashes on an empty buffer.
    try:
        stored = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED) if content else None
    except cv2.error as error:  # A header that asks for more pixels than OpenCV reads.
        raise InputError(f"{path}: expected an image that can be read, found: {error.err}") from error
    if stored is None:
        raise InputError(
            f"{path}: expected a whole image, found {len(content)} bytes that end early or are of another kind"
        )
    if stored.ndim == 3:
        stored = np.ascontiguousarray(stored[..., [2, 1, 0, *range(3, stored.shape[2])]])
    return stored


def read_exr_channel(path: Path, channel: str = "Y") -> Float32[np.ndarray, "h w"]:
    """One named channel of an OpenEXR file.

    Raises:
        InputError: if the file cannot be read or has no such channel.
    """
    channels = _decode_exr(read_bytes(path), path)
    if channel not in channels:
        raise InputError(f"{path}: expected a channel {channel}, found {', '.join(sorted(channels)) or 'none'}")
    return channels[channel].astype(np.float32)


def write_png(path: Path, image: np.ndarray) -> None:
    """Write a .png of unsigned integers, or of linear light in 8-bit sRGB.

    Integers, [h, w] or RGB [h, w, 3], are written as they are; floats are taken for linear light.
    """
    if image.dtype.kind == "f":
        image = np.round(np.clip(srgb_from_linear(image), 0, 1) * 255).astype(np.uint8)
    encoded, content = cv2.imencode(".png", np.ascontiguousarray(image[..., ::-1]) if image.ndim == 3 else image)
    if not encoded:
        raise ValueError(
            f"write_png: expected 8 or 16 bits and 1 or 3 channels, found {image.dtype} {list(image.shape)}"
        )
    with written_whole(path) as temporary:
        temporary.write_bytes(content.tobytes())


def _decode_exr(content: bytes, path: Path) -> dict[str, np.ndarray]:
    """Channel name to pixels [h, w]."""
    try:
        # No threads of its own: callers read many small images at once.
        channels = OpenEXR.File(io.BytesIO(content), separate_channels=True, num_threads=0).channels()
    except (RuntimeError, ValueError) as error:
        raise InputError(f"{path}: expected a whole OpenEXR image, found one that does not decode: {error}") from error
    return {name: channel.pixels for name, channel in channels.items()}


def _channels(stored: np.ndarray) -> str:
    count = 1 if stored.ndim == 2 else stored.shape[2]
    return f"{count} channel{'s' if count > 1 else ''}"
