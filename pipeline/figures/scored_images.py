"""Pictures of the held-out images that an avatar renders worst, as usual and best.

And of what its light is made.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import pandas as pd

from pipeline.avatar.intrinsic_layers import IntrinsicLayers, as_pictures
from pipeline.avatar.training.checkpoint import camera_view
from pipeline.capture.images import write_png
from pipeline.capture.records import FrameRecord, ImageRecord
from pipeline.capture.shards import FrameShards, ImageShards
from pipeline.metrics.comparison import labelled_panels, side_by_side
from pipeline.metrics.evaluation import Render, scored_pair, worst_median_best

LAYERS = "layers"
"""End of the names of pictures of intrinsic layers."""


def write_pictures(
    folder: Path, variant: str, render: Render, per_image: pd.DataFrame, images: ImageShards, frames: FrameShards
) -> None:
    """Write VARIANT_worst.png, _median.png and _best.png by PSNR; nothing if no image has one."""
    for name, row in worst_median_best(per_image).items():
        image = images[int(row["index"])]
        captured, rendered = scored_pair(render, image, frames[image.frame])
        lit = "fully lit" if image.fully_lit else "partially lit"
        label = f"{variant}, {name}: {image.camera}, frame {image.frame}, {lit}, PSNR {row.psnr_db:.2f} dB"
        write_png(folder / f"{variant}_{name}.png", side_by_side(captured, rendered, label))


def write_layers(
    folder: Path, variant: str, layers_of: Callable[[FrameRecord, ImageRecord], IntrinsicLayers],
    per_image: pd.DataFrame, images: ImageShards, frames: FrameShards,
) -> None:  # fmt: skip
    """Write VARIANT_layers.png, the intrinsic layers of the median image, if there is one."""
    row = worst_median_best(per_image).get("median")
    if row is None:
        return
    image = images[int(row["index"])]
    layers = layers_of(frames[image.frame], image)
    label = f"{variant}: {image.camera}, frame {image.frame}"
    write_png(folder / f"{variant}_{LAYERS}.png", labelled_panels(as_pictures(layers, camera_view(image)), label))


def remove_pictures(folder: Path, names: Sequence[str]) -> None:
    """Delete pictures of all variants that end in these names, and the folder if that was all."""
    for path in [path for name in names for path in folder.glob(f"*_{name}.png")]:
        path.unlink()
    if folder.is_dir() and not any(folder.iterdir()):
        folder.rmdir()
