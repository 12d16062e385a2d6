"""Dials of pack_shards."""

from __future__ import annotations

import numpy as np

from pipeline.capture.shards import read_image_shards
from pipeline.dials.dial import CostedStage, Dial, Files, Metric
from pipeline.dials.subject import Subject

TOLERANCE = 0.001
"""RMS of what storing changes, full scale being 1: a tenth of a capture's noise of 40 dB."""


def _pixels(subject: Subject, output: Files, expected: Files) -> float:
    """Over all channels of all training crops."""
    found, wanted = (read_image_shards([files["train"]]) for files in (output, expected))
    squares = count = 0.0
    for ours, theirs in zip(found, wanted, strict=True):
        squares += float(np.square(ours.image - theirs.image, dtype=np.float64).sum())
        count += ours.image.size
    return float(np.sqrt(squares / count))


PACKING = CostedStage(
    name="pack_shards",
    files={"shards": "{out}", "irradiance": None, "textures": None},
    inputs=(
        "index/capture.json", "atlas.safetensors", "tracking/0000.safetensors", "calibration/color.json",
        "calibration/lights.parquet", "effects.json", "patterns.parquet", "frames.parquet",
    ),
    outputs={"train": ("train/0000.arrow", None)},
    metrics=(Metric("stored pixel, RMS", _pixels, lambda subject: TOLERANCE),),
    unit="bytes",
    work=lambda output: output["train"].stat().st_size,
)  # fmt: skip

PACKING_DIALS = [
    # Nothing to choose by time: they differ by less than its noise. What they save is disk.
    Dial("shard_codec", PACKING, "codec", lambda subject: ("float16_zstd", "float16_lz4", "float16", "float32")),
]  # fmt: skip
