"""Gaussians as .spz, Niantic's compressed splats: a tenth of a .ply.

Source: github.com/nianticlabs/spz, versions 3 and 4 of the format. Both have a header, then of all Gaussians together
positions, opacities, colours, scales and rotations. Version 3, which every reader opens, is one gzip stream of it all;
version 4 has the header in plain, a table of sizes, and a Zstandard stream for each of these five.

Axes are right, up, back: x right, y up, z towards the viewer, as this project's. Rounded: positions to 0.12 mm, scales
by 3 %, colours and opacities by less than 1 %, rotations by 0.3 degrees.
"""

from __future__ import annotations

import gzip
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
import pyarrow
from jaxtyping import Float, UInt8

from pipeline.base.files import written_whole
from pipeline.rendering.splat_ply import Splats, stored_splats

MAGIC = 0x5053474E

ZSTD_LEVEL = 12
"""That of Niantic's own writer."""

FRACTION_BITS = 12
"""Positions in steps of 0.24 mm."""

POSITION_BYTES, HEADER_BYTES = 3, 32

COLOR_SCALE = 0.15
"""Of coefficients of degree 0: 8 bits reach from -3.3 to 3.3, beyond what lies in [0, 1], which ends at 1.8."""

LOWEST_LOG_SCALE, LOG_SCALE_STEPS = -10.0, 16.0
"""Scales from e^-10 m, 0.05 mm, in steps of e^(1/16)."""

ROTATION_BITS = 9
"""Of the size of a quaternion's component, beside its sign."""


def write_spz(path: Path, splats: Splats, version: Literal[3, 4] = 3) -> None:
    """Write a .spz.

    Raises:
        ValueError: if a position lies beyond the 2 km that the format holds.
    """
    stored = stored_splats(splats)
    parts = [
        fixed_point(stored.means), to_bytes(255 * stored.opacities),
        to_bytes(255 * (COLOR_SCALE * stored.coefficients + 0.5)),
        to_bytes(LOG_SCALE_STEPS * (stored.log_scales - LOWEST_LOG_SCALE)), smallest_three(stored.quaternions),
    ]  # fmt: skip
    streams = [part.tobytes() for part in parts]
    content = gzipped(len(stored.means), streams) if version == 3 else in_streams(len(stored.means), streams)
    with written_whole(path) as temporary:
        temporary.write_bytes(content)


def gzipped(count: int, streams: Sequence[bytes]) -> bytes:
    """Version 3: 16 bytes of a header, then everything, in one."""
    header = struct.pack("<IIIBBBB", MAGIC, 3, count, 0, FRACTION_BITS, 0, 0)
    return gzip.compress(header + b"".join(streams), mtime=0)


def in_streams(count: int, streams: Sequence[bytes]) -> bytes:
    """Version 4: 32 bytes of a header, compressed and full size of each stream, and the streams."""
    codec = pyarrow.Codec("zstd", compression_level=ZSTD_LEVEL)
    packed = [codec.compress(stream, asbytes=True) for stream in streams]
    header = struct.pack("<IIIBBBBI12x", MAGIC, 4, count, 0, FRACTION_BITS, 0, len(packed), HEADER_BYTES)
    sizes = [struct.pack("<QQ", len(one), len(stream)) for one, stream in zip(packed, streams, strict=True)]
    return b"".join([header, *sizes, *packed])


def to_bytes(values: Float[np.ndarray, "*shape"]) -> UInt8[np.ndarray, "*shape"]:
    """Nearest of 0 to 255."""
    return np.round(values).clip(0, 255).astype(np.uint8)


def fixed_point(positions: Float[np.ndarray, "n 3"]) -> UInt8[np.ndarray, "n 9"]:
    """Signed numbers of three bytes, the lowest first.

    Raises:
        ValueError: if one does not fit.
    """
    steps = np.round(positions.astype(np.float64) * 2**FRACTION_BITS)
    if not (np.abs(steps) < 2 ** (8 * POSITION_BYTES - 1)).all():
        raise ValueError(f"positions: expected less than 2048 m, found {np.abs(positions).max()}")
    words = np.ascontiguousarray(steps.astype("<i4"))
    return words.view(np.uint8).reshape(*words.shape, 4)[..., :POSITION_BYTES].reshape(len(words), -1)


def smallest_three(quaternions: Float[np.ndarray, "n 4"]) -> np.ndarray:
    """All but the largest component, and which it is, in 32 bits.

    From the highest bit down: the largest one's place among x, y, z, w; of the others in this order, a sign and nine
    bits of their size, of which 511 is sqrt(1/2).

    Args:
        quaternions: w, x, y, z, of unit length.
    """
    xyzw = np.roll(quaternions, -1, axis=1)
    rows, largest = np.arange(len(xyzw)), np.abs(xyzw).argmax(1)
    xyzw = xyzw * np.where(xyzw[rows, largest] < 0, -1.0, 1.0)[:, None]
    sizes = np.floor((2**ROTATION_BITS - 1) * np.sqrt(2) * np.abs(xyzw) + 0.5).astype(np.uint32)
    packed = largest.astype(np.uint32)
    for component in range(4):
        sign = (xyzw[:, component] < 0).astype(np.uint32)
        longer = packed << (ROTATION_BITS + 1) | sign << ROTATION_BITS | sizes[:, component]
        packed = np.where(largest == component, packed, longer)
    return packed.astype("<u4")
