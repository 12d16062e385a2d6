"""Score avatars on images that training never saw; show the worst, median and best.

In: shards and one folder per avatar (its name is the variant). Each held-out image is rendered with its own camera,
pose and light and compared with what was captured; `pipeline.metrics.evaluation` states the protocol, which also
stands in the table. Out: metrics.csv (variant x split x lighting), metrics_per_image.parquet, ablations.csv (a row per
variant: its scores on all test images, on validation images, on new segments and on new light), avatar_times.csv and
images/VARIANT_{worst,median,best}.png of test images; images/VARIANT_layers.png shows albedo, normal, roughness,
visibility, diffuse and specular light and shadow of the median one (RGCA Figure 3).
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.avatar.intrinsic_layers import IntrinsicLayers, as_pictures
from pipeline.avatar.training.checkpoint import camera_view, load_avatar
from pipeline.base.command import run_as_command
from pipeline.base.errors import InputError
from pipeline.base.files import read_json, read_table, write_table
from pipeline.base.splits import VALIDATION
from pipeline.capture.images import write_png
from pipeline.capture.records import FrameRecord, ImageRecord
from pipeline.capture.shards import FrameShards, ImageShards, read_frame_shards, read_image_shards
from pipeline.config.evaluate_avatar import EvaluateAvatar
from pipeline.metrics.comparison import labelled_panels, side_by_side
from pipeline.metrics.evaluation import (
    COLOR_SPACE,
    LIT,
    SHOWN,
    TABLES,
    Render,
    evaluate,
    region,
    scored_pair,
    summarize,
    worst_median_best,
)
from pipeline.metrics.image_metrics import asked_metrics, metrics_in
from pipeline.metrics.lpips import open_lpips

log = logging.getLogger("evaluate_avatar")

LAYERS = "layers"
"""End of the names of pictures of intrinsic layers."""

TIMED_IMAGES = 5
"""Pictures whose time is taken, spread over the held-out ones: enough for a median that one slow moment cannot move."""


def run(
    *,
    atlas: Path,
    shards: Path,
    effects: Path,
    avatars: tuple[Path, ...],
    out: Path,
    subject: str,
    frames: tuple[Path, ...] = (),
    settings: EvaluateAvatar = EvaluateAvatar(),
) -> None:
    """Score avatars on held-out images.

    Args:
        atlas: atlas.safetensors of unwrap_atlas.
        shards: folder with test/, validation/ and frames/ of pack_shards.
        effects: effects.json of plan_effects; what is on is logged beside the scores.
        avatars: folders of train_avatar; each folder's name is the variant.
        out: folder for metrics.csv, metrics_per_image.parquet, ablations.csv, avatar_times.csv and images/.
        subject: name of the subject, for the table.
        frames: folder of frame shards of each avatar, if they are not all lit as in SHARDS/frames.
        settings: see the flags below.
    """
    variants = [folder.name for folder in avatars]
    if len(set(variants)) < len(variants) or not variants:
        raise InputError(
            f"--avatars: expected folders of different names, found {variants}; a variant is its folder's name"
        )
    lpips, weights = open_lpips(settings.lpips_net, settings.lpips_backbone)
    if lpips is None:
        log.warning("LPIPS stays empty: %s", weights)
    frames = frames or (shards / "frames",) * len(avatars)
    if len(frames) != len(avatars):
        raise InputError(f"--frames: expected a folder for each of {len(avatars)} avatars, found {len(frames)}")
    images = read_image_shards([shards / "test", shards / VALIDATION])
    lit = {path: read_frame_shards([path]) for path in frames}
    log.info("effects on: %s", [name for name, effect in read_json(effects).items() if effect["on"]])
    metrics = asked_metrics(settings.metrics)
    network = {"lpips_net": settings.lpips_net, "lpips_weights": weights}
    protocol = {"color_space": COLOR_SPACE, "region": region(metrics), **network}

    means, singles, ablations, times = [], [], [], []
    # Those of an earlier run would stand beside scores that are not theirs.
    if not settings.pictures:
        remove_pictures(out / "images", SHOWN)
    if not (settings.pictures and settings.intrinsic_layers):
        remove_pictures(out / "images", (LAYERS,))
    for folder, path in zip(avatars, frames, strict=True):
        avatar = load_avatar(folder, atlas)
        render = avatar.render
        per_image = evaluate(render, images, lit[path], lpips, metrics, avatar.trace)
        names = {"subject": subject, "variant": folder.name}
        config = read_json(folder / "config.json")
        built = {name: config.get(name, "") for name in ("built", "why")}
        means.append(summarize(per_image).assign(**names, **built, **protocol))
        singles.append(per_image.assign(**names, **network))
        ablations.append(names | {"parameters": config["parameters"]} | scores_in_a_row(means[-1]))
        trained = float(read_table(folder / "log.parquet").seconds.iloc[-1])
        rendered = measure_milliseconds(render, images, lit[path])
        times.append(names | {"training_seconds": trained, "render_milliseconds": rendered})
        log.info("%s: %s", folder.name, means[-1].iloc[0][["images", *(metric.name for metric in metrics)]].to_dict())
        if settings.pictures:
            write_pictures(out / "images", folder.name, render, per_image, images, lit[path])
        if settings.pictures and settings.intrinsic_layers:
            write_layers(out / "images", folder.name, avatar.intrinsic_layers, per_image, images, lit[path])
    write_table(out / "metrics_per_image.parquet", names_first(pd.concat(singles, ignore_index=True)))
    write_table(out / "metrics.csv", names_first(pd.concat(means, ignore_index=True)))
    write_table(out / "ablations.csv", pd.DataFrame(ablations))
    write_table(out / "avatar_times.csv", pd.DataFrame(times))


def scores_in_a_row(means: pd.DataFrame) -> dict[str, float]:
    """METRIC_LIT of all test images; METRIC_SPLIT of validation and of `TABLES`, all light."""
    rows, metrics = means[means.split == "test"].set_index("lit"), [metric.name for metric in metrics_in(means)]
    scores = {f"{metric}_{lit}": rows.loc[lit, metric] for metric in metrics for lit in LIT}
    rows = means[means.lit == "all"].set_index("split")
    return scores | {
        f"{metric}_{split}": rows.loc[split, metric] for split in (VALIDATION, *TABLES) for metric in metrics
    }


def measure_milliseconds(render: Render, images: ImageShards, frames: FrameShards) -> float:
    """Measure the median time from a new pose and light to a picture; NaN without images."""
    taken = []
    for index in range(0, len(images), max(1, len(images) // TIMED_IMAGES)):
        image = images[index]
        frame = frames[image.frame]  # a record of its own each time: nothing of an earlier picture is used again
        started = time.perf_counter()
        render(frame, image)
        taken.append(1e3 * (time.perf_counter() - started))
    return float(np.median(taken)) if taken else math.nan


def names_first(table: pd.DataFrame) -> pd.DataFrame:
    """The same table, subject and variant leading."""
    leading = ["subject", "variant"]
    return table[leading + [column for column in table.columns if column not in leading]]


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


def main() -> None:
    """Command line of this stage."""
    run_as_command(run)


if __name__ == "__main__":
    main()
