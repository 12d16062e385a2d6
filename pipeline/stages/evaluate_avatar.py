"""Score avatars on images that training never saw; show the worst, median and best.

In: shards and one folder per avatar (its name is the variant). Each held-out image is rendered with its own camera,
pose and light and compared with what was captured; `pipeline.metrics.evaluation` states the protocol, which also
stands in the table. Out: metrics.csv (variant x split x lighting), metrics_per_image.parquet, ablations.csv (a row per
variant: its scores on all test images, on validation images, on new segments and on new light), avatar_times.csv and
images/VARIANT_{worst,median,best}.png of test images; images/VARIANT_layers.png shows albedo, normal, roughness,
visibility, diffuse and specular light and shadow of the median one (RGCA Figure 3).

Images of a large capture are scored by jobs of their own, each those of an avatar in some chunks of frames; the tables
that are made of theirs are the same.
"""

from __future__ import annotations

import logging
import math
import time
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.avatar.training.checkpoint import load_avatar
from pipeline.base.command import run_as_command
from pipeline.base.errors import InputError
from pipeline.base.files import read_json, read_table, write_table
from pipeline.base.splits import VALIDATION
from pipeline.capture.shards import FrameShards, ImageShards, read_frame_shards, read_image_shards
from pipeline.config.evaluate_avatar import EvaluateAvatar
from pipeline.figures.scored_images import LAYERS, remove_pictures, write_layers, write_pictures
from pipeline.geometry.texels import Atlas, read_atlas
from pipeline.metrics.evaluation import (
    COLOR_SPACE,
    LIT,
    SHOWN,
    SPLITS,
    TABLES,
    Render,
    capped,
    evaluate,
    region,
    summarize,
)
from pipeline.metrics.face_region import ShownFace, known_face, shown_face
from pipeline.metrics.image_metrics import asked_metrics, metrics_in
from pipeline.metrics.joined_scores import joined_scores
from pipeline.metrics.lpips import open_lpips
from pipeline.metrics.significance import Estimate, mean_over_images

log = logging.getLogger("evaluate_avatar")

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
    index: Path | None = None,
    frames: tuple[Path, ...] = (),
    scores: Path | None = None,
    chunk: int | None = None,
    chunks: int = 1,
    settings: EvaluateAvatar = EvaluateAvatar(),
) -> None:
    """Score avatars on held-out images.

    Args:
        atlas: atlas.safetensors of unwrap_atlas.
        shards: folder with test/, validation/ and frames/ of pack_shards.
        effects: effects.json of plan_effects; what is on is logged beside the scores.
        avatars: folders of train_avatar; each folder's name is the variant.
        out: folder for metrics.csv, metrics_per_image.parquet, ablations.csv, avatar_times.csv and images/; with
            `chunk`, for CHUNK.parquet.
        subject: name of the subject, for the table.
        index: folder of index_capture, for the sizes of whole images, without which psnr_image stays empty, and for
            the vertices of eyes.
        frames: folder of frame shards of each avatar, if they are not all lit as in SHARDS/frames.
        scores: folder of a folder VARIANT for each avatar, written with `chunk`: no image is scored again.
        chunk: score only the images of this chunk, of the one avatar that is given, and write a table of them.
        chunks: number of chunks that are scored from there, if any.
        settings: see the flags below.
    """
    variants = [folder.name for folder in avatars]
    if len(set(variants)) < len(variants) or not variants:
        raise InputError(
            f"--avatars: expected folders of different names, found {variants}; a variant is its folder's name"
        )
    if chunk is not None and len(avatars) > 1:
        raise InputError(f"--avatars: expected one folder, as a chunk is scored for each alone, found {len(avatars)}")
    lpips, weights = open_lpips(settings.lpips_net, settings.lpips_backbone)
    if lpips is None:
        log.warning("LPIPS stays empty: %s", weights)
    frames = frames or (shards / "frames",) * len(avatars)
    if len(frames) != len(avatars):
        raise InputError(f"--frames: expected a folder for each of {len(avatars)} avatars, found {len(frames)}")
    parts = [""] if chunk is None else [f"{chunk + each:04d}.arrow" for each in range(chunks)]
    images = read_image_shards([shards / split / part for split in settings.splits for part in parts])
    lit = {path: read_frame_shards([path / part for part in parts]) for path in frames}
    log.info("effects on: %s", [name for name, effect in read_json(effects).items() if effect["on"]])
    metrics = asked_metrics(settings.metrics)
    pixels = {} if index is None else whole_pixels(index)
    face = find_face(read_atlas(atlas), index) if "psnr_face" in settings.metrics else None
    if chunk is not None:
        avatar = load_avatar(avatars[0], atlas)
        scored = evaluate(avatar.render, images, lit[frames[0]], lpips, metrics, avatar.trace, pixels, face)
        write_table(out / f"{chunk:04d}.parquet", scored)
        log.info("%s: %d images of %d chunks from %d", avatars[0].name, len(scored), chunks, chunk)
        return
    network = {"lpips_net": settings.lpips_net, "lpips_weights": weights}
    protocol = {"color_space": COLOR_SPACE, "region": region(metrics), "protocol": settings.protocol}
    protocol |= network

    means, singles, ablations, times = [], [], [], []
    # Those of an earlier run would stand beside scores that are not theirs.
    if not settings.pictures:
        remove_pictures(out / "images", SHOWN)
    if not (settings.pictures and settings.intrinsic_layers):
        remove_pictures(out / "images", (LAYERS,))
    for folder, path in zip(avatars, frames, strict=True):
        avatar = load_avatar(folder, atlas)
        render = avatar.render
        if scores is None:
            per_image = evaluate(render, images, lit[path], lpips, metrics, avatar.trace, pixels, face)
        else:
            per_image = joined_scores(scores / folder.name, images.table)
        names = {"subject": subject, "variant": folder.name}
        config = read_json(folder / "config.json")
        built = {name: config.get(name, "") for name in ("built", "why")}
        means.append(summarize(per_image).assign(**names, **built, **protocol))
        singles.append(per_image.assign(**names, **network))
        row = scores_in_a_row(means[-1]) | spread_in_a_row(per_image, singles[0])
        ablations.append(names | {"parameters": config["parameters"]} | row)
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


def find_face(atlas: Atlas, index: Path | None) -> ShownFace | None:
    """Finder of the face in images; None, with a warning, if nothing tells what that is."""
    listed = () if index is None else read_table(index / "eyes.parquet").groupby("eye").vertex
    eyes = {name: vertices.to_numpy() for name, vertices in listed}
    face = shown_face(atlas.faces, known_face(atlas.regions, atlas.rest_vertices, eyes))
    if face is None:
        log.warning("psnr_face stays empty: the template has no region face, no joint of a keypoint head, no two eyes")
    return face


def whole_pixels(index: Path) -> dict[str, int]:
    """Pixels of the whole images of each camera."""
    cameras = read_table(index / "cameras.parquet")
    return dict(zip(cameras.camera, (cameras.width * cameras.height).tolist(), strict=True))


def scores_in_a_row(means: pd.DataFrame) -> dict[str, float]:
    """METRIC_LIT of all test images; METRIC_SPLIT of validation and of `TABLES`, all light."""
    rows, metrics = means[means.split == "test"].set_index("lit"), [metric.name for metric in metrics_in(means)]
    scores = {f"{metric}_{lit}": rows.loc[lit, metric] for metric in metrics for lit in LIT}
    rows = means[means.lit == "all"].set_index("split")
    return scores | {
        f"{metric}_{split}": rows.loc[split, metric] for split in (VALIDATION, *TABLES) for metric in metrics
    }


def spread_in_a_row(per_image: pd.DataFrame, first: pd.DataFrame) -> dict[str, float]:
    """METRIC_SPLIT_error of validation and `TABLES`, and gains in PSNR over the first avatar.

    Errors are those over blocks of frames, of images that have the score; NaN where a split has too few.
    """
    found = {}
    for split in (VALIDATION, *TABLES):
        own, base = (capped(table[SPLITS[split](table)]) for table in (per_image, first))
        for metric in metrics_in(per_image):
            found[f"{metric.name}_{split}_error"] = over_frames(own[metric.name], own.frame).error
        gain = over_frames(own.psnr_db.reset_index(drop=True) - base.psnr_db.reset_index(drop=True), own.frame)
        found |= {f"psnr_db_{split}_gain": gain.mean, f"psnr_db_{split}_gain_error": gain.error}
    return found


def over_frames(values: pd.Series, frame: pd.Series) -> Estimate:
    """Mean of what is known, with its standard error."""
    numbers = values.to_numpy(np.float64)
    known = np.isfinite(numbers)
    return mean_over_images(numbers[known], frame.to_numpy()[known])


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


def main() -> None:
    """Command line of this stage."""
    run_as_command(run)


if __name__ == "__main__":
    main()
