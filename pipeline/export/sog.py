"""Gaussians as .sog, PlayCanvas's splats in pictures: meta.json and lossless WebP in a .zip.

Source: developer.playcanvas.com, "The SOG Format", version 2. Numbers are looked up in tables of 256 levels, or lie
between two bounds in 16 bits; positions after sign(x) ln(|x| + 1). Axes are those of a .ply: viewers made for COLMAP's
scenes, y down, may show the subject on its head.
"""

from __future__ import annotations

import io
import json
import math
import zipfile
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image

from pipeline.base.files import written_whole
from pipeline.rendering.splat_ply import Splats, stored_splats

LEVELS, FINE_LEVELS = 256, 65536

LARGEST_TAG = 252
"""Fourth byte of a rotation: this, plus the place of the largest component, which is left out."""


def write_sog(path: Path, splats: Splats) -> None:
    """Write a .sog."""
    stored = stored_splats(splats)
    logs = np.sign(stored.means) * np.log1p(np.abs(stored.means))
    low, high = logs.min(0), logs.max(0)
    fine = np.round((FINE_LEVELS - 1) * (logs - low) / np.where(high > low, high - low, 1)).astype(np.uint16)
    scales, scale_levels = looked_up(stored.log_scales)
    colors, color_levels = looked_up(stored.coefficients)
    opacities = np.round(255 * stored.opacities).astype(np.uint8)[:, None]
    opaque = np.full_like(opacities, 255)
    pictures = {
        "means_l": with_last(fine & 255, opaque), "means_u": with_last(fine >> 8, opaque),
        "scales": with_last(scales, opaque), "quats": packed_rotations(stored.quaternions),
        "sh0": with_last(colors, opacities),
    }  # fmt: skip
    meta = {
        "version": 2, "asset": {"generator": "lightstage-avatars"}, "count": len(logs), "antialias": False,
        "means": {"mins": low.tolist(), "maxs": high.tolist(), "files": ["means_l.webp", "means_u.webp"]},
        "scales": {"codebook": scale_levels.tolist(), "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {"codebook": color_levels.tolist(), "files": ["sh0.webp"]},
    }  # fmt: skip
    with written_whole(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        archive.writestr("meta.json", json.dumps(meta))
        for name, texels in pictures.items():
            archive.writestr(f"{name}.webp", webp(texels))


def looked_up(values: Float[np.ndarray, "n 3"]) -> tuple[UInt8[np.ndarray, "n 3"], Float[np.ndarray, " levels"]]:
    """Places in a table of even levels, and the table."""
    levels = np.linspace(values.min(), values.max(), LEVELS)
    step = (levels[-1] - levels[0]) / (LEVELS - 1) or 1.0
    return np.round((values - levels[0]) / step).astype(np.uint8), levels


def with_last(rgb: np.ndarray, last: UInt8[np.ndarray, "n 1"]) -> UInt8[np.ndarray, "n 4"]:
    """RGBA of three channels and a fourth."""
    return np.concatenate([rgb.astype(np.uint8), last], 1)


def packed_rotations(quaternions: Float[np.ndarray, "n 4"]) -> UInt8[np.ndarray, "n 4"]:
    """Three components in [-sqrt(1/2), sqrt(1/2)], and the place of the fourth among w, x, y, z."""
    rows, largest = np.arange(len(quaternions)), np.abs(quaternions).argmax(1)
    turned = quaternions * np.where(quaternions[rows, largest] < 0, -1.0, 1.0)[:, None]
    others = turned[np.arange(4) != largest[:, None]].reshape(-1, 3)
    levels = np.round((LEVELS - 1) * (0.5 * math.sqrt(2) * others + 0.5)).clip(0, LEVELS - 1)
    return with_last(levels, (LARGEST_TAG + largest).astype(np.uint8)[:, None])


def webp(texels: UInt8[np.ndarray, "n 4"]) -> bytes:
    """A lossless picture with these texels row by row, filled up with zeros."""
    width = 4 * math.ceil(math.sqrt(len(texels)) / 4)
    height = math.ceil(len(texels) / width)
    picture = np.zeros((height * width, 4), np.uint8)
    picture[: len(texels)] = texels
    stored = io.BytesIO()
    Image.fromarray(picture.reshape(height, width, 4)).save(stored, "WEBP", lossless=True, exact=True)
    return stored.getvalue()
