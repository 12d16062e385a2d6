"""Numbers of an avatar for the page's textures: 16 bits each, in blocks of compressed text.

A Gaussian has tables of eight columns of 16 bits, which the page uploads as one texel of four 32-bit integers. In the
file, each column is stored as differences from texel to texel, low bytes before high bytes: neighbours on the surface
are alike, so that zlib halves it. `viewer/src/blocks.js` reads what is written here.
"""

from __future__ import annotations

import base64
import zlib

import numpy as np
from jaxtyping import Bool, Float, Int32, UInt8, UInt16

COLUMNS = 8
"""Of a table: 16 bytes a Gaussian, one texel of a 32-bit RGBA texture."""

LEVELS = 65535
"""Of 16 bits: over the 3 m of a figure with its arms spread, 0.05 mm."""

WORD = 32
"""Bits of visibility in a texel."""


def quantized(
    values: Float[np.ndarray, "*shape"], low: Float[np.ndarray, "..."] | float, high: Float[np.ndarray, "..."] | float
) -> UInt16[np.ndarray, "*shape"]:
    """Nearest of 65,536 levels from `low` to `high`, both included; the rest is clipped."""
    span = np.maximum(np.asarray(high, np.float64) - low, np.finfo(np.float32).tiny)
    return np.round(np.clip((values - low) / span, 0, 1) * LEVELS).astype(np.uint16)


def octahedral(normals: Float[np.ndarray, "n 3"]) -> UInt16[np.ndarray, "n 2"]:
    """Unit vectors as points of an unfolded octahedron, at worst 0.004 degrees off.

    Half a level in both coordinates is 2.2e-5, and where a face is nearest to the middle, angles are three times as
    large.
    """
    x, y, z = (normals / np.abs(normals).sum(1, keepdims=True).clip(np.finfo(np.float32).tiny)).T
    folded = (1 - np.abs(np.stack([y, x]))) * np.where(np.stack([x, y]) >= 0, 1.0, -1.0)
    return quantized(np.where(z >= 0, np.stack([x, y]), folded).T, -1.0, 1.0)


def half_floats(values: Float[np.ndarray, "*shape"]) -> UInt16[np.ndarray, "*shape"]:
    """Bits of the nearest float16."""
    return values.astype(np.float16).view(np.uint16)


def table(*columns: UInt16[np.ndarray, "n _"]) -> UInt16[np.ndarray, "n 8"]:
    """Columns beside each other, filled up with zeros."""
    beside = np.concatenate([column.reshape(len(column), -1) for column in columns], 1)
    return np.pad(beside, ((0, 0), (0, COLUMNS - beside.shape[1])))


def differences_down(rows: Int32[np.ndarray, "n columns"]) -> bytes:
    """32-bit differences from row to row, column after column.

    Of indices of neighbours nearly all are 1.
    """
    return np.diff(rows.T, axis=1, prepend=np.zeros((rows.shape[1], 1), np.int32)).astype("<i4").tobytes()


def agree(one: UInt16[np.ndarray, "n columns"], other: UInt16[np.ndarray, "n columns"]) -> bool:
    """Tables differ by no more than the rounding of what they were made from."""
    return bool((np.abs(one.astype(np.int64) - other) <= 1).all())


def table_bytes(columns: UInt16[np.ndarray, "n columns"]) -> bytes:
    """A table as differences down each column, low bytes of all columns before high bytes."""
    steps = np.diff(columns.T, axis=1, prepend=np.uint16(0))
    return np.stack([steps & 255, steps >> 8]).astype(np.uint8).tobytes()


def visibility_words(bits: UInt8[np.ndarray, "lights bytes"], count: int) -> bytes:
    """Rows of 32-bit words: bit j of word k of a Gaussian says that it sees light 32 k + j.

    Args:
        bits: rows of lights, packed as np.packbits does.
        count: of Gaussians.
    """
    seen: Bool[np.ndarray, "lights n"] = np.unpackbits(bits, axis=1, count=count).astype(bool)
    seen = np.pad(seen, ((0, -len(seen) % WORD), (0, 0)))
    words = np.packbits(seen.reshape(-1, WORD, count), axis=1, bitorder="little")
    return np.ascontiguousarray(words.swapaxes(1, 2)).tobytes()


def block(content: bytes) -> str:
    """Compressed content as text: zlib, base64."""
    return base64.b64encode(zlib.compress(content, 9)).decode("ascii")
