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
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.avatar.training.checkpoint import LoadedAvatar, load_avatar
from pipeline.base.command import run_as_command
from pipeline.base.errors import InputError
from pipeline.base.files import read_json, read_table, write_table
from pipeline.capture.shards import FrameShards, ImageShards, read_frame_shards, read_image_shards
from pipeline.config.evaluate_avatar import EvaluateAvatar
from pipeline.figures.scored_images import LAYERS, remove_pictures, write_layers, write_pictures
from pipeline.geometry.texels import Atlas, read_atlas
from pipeline.metrics.ablation_rows import scores_in_a_row, spread_in_a_row
from pipeline.metrics.evaluation import (
    COLOR_SPACE,
    SHOWN,
    Render,
    evaluate,
    region,
    summarize,
)
from pipeline.metrics.face_region import ShownFace, known_face, shown_face
from pipeline.metrics.image_metrics import asked_metrics
from pipeline.metrics.joined_scores import joined_scores
from pipeline.metrics.lpips import open_lpips

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
    frames = frames or (shards / "frames",) * len(avatars)
    require_folders(avatars, frames, chunk)
    lpips, weights = open_lpips(settings.lpips_net, settings.lpips_backbone)
    if lpips is None:
        log.warning("LPIPS stays empty: %s", weights)
    parts = [""] if chunk is None else [f"{chunk + each:04d}.arrow" for each in range(chunks)]
    images = read_image_shards([shards / split / part for split in settings.splits for part in parts])
    lit = {path: read_frame_shards([path / part for part in parts]) for path in frames}
    log.info("effects on: %s", [name for name, effect in read_json(effects).items() if effect["on"]])
    metrics = asked_metrics(settings.metrics)
    pixels = {} if index is None else whole_pixels(index)
    face = find_face(read_atlas(atlas), index) if "psnr_face" in settings.metrics else None

    def scored(avatar: LoadedAvatar, path: Path) -> pd.DataFrame:
        return evaluate(avatar.render, images, lit[path], lpips, metrics, avatar.trace, pixels, face)

    if chunk is not None:
        table = scored(load_avatar(avatars[0], atlas), frames[0])
        write_table(out / f"{chunk:04d}.parquet", table)
        log.info("%s: %d images of %d chunks from %d", avatars[0].name, len(table), chunks, chunk)
        return
    network = {"lpips_net": settings.lpips_net, "lpips_weights": weights}
    protocol = {"color_space": COLOR_SPACE, "region": region(metrics), "protocol": settings.protocol, **network}
    remove_old_pictures(out / "images", settings)
    means, singles, ablations, times = [], [], [], []
    for folder, path in zip(avatars, frames, strict=True):
        avatar = load_avatar(folder, atlas)
        per_image = scored(avatar, path) if scores is None else joined_scores(scores / folder.name, images.table)
        names = {"subject": subject, "variant": folder.name}
        config = read_json(folder / "config.json")
        built = {name: config.get(name, "") for name in ("built", "why")}
        means.append(summarize(per_image).assign(**names, **built, **protocol))
        singles.append(per_image.assign(**names, **network))
        row = scores_in_a_row(means[-1]) | spread_in_a_row(per_image, singles[0])
        ablations.append(names | {"parameters": config["parameters"]} | row)
        times.append(names | times_of(folder, avatar, images, lit[path]))
        log.info("%s: %s", folder.name, means[-1].iloc[0][["images", *(metric.name for metric in metrics)]].to_dict())
        draw(out / "images", folder.name, avatar, per_image, images, lit[path], settings)
    write_table(out / "metrics_per_image.parquet", names_first(pd.concat(singles, ignore_index=True)))
    write_table(out / "metrics.csv", names_first(pd.concat(means, ignore_index=True)))
    write_table(out / "ablations.csv", pd.DataFrame(ablations))
    write_table(out / "avatar_times.csv", pd.DataFrame(times))


def require_folders(avatars: Sequence[Path], frames: Sequence[Path], chunk: int | None) -> None:
    """Require avatars of different names, each with its frames.

    Raises:
        InputError: if there are none, two of one name, or several for a chunk.
    """
    variants = [folder.name for folder in avatars]
    if len(set(variants)) < len(variants) or not variants:
        raise InputError(
            f"--avatars: expected folders of different names, found {variants}; a variant is its folder's name"
        )
    if chunk is not None and len(avatars) > 1:
        raise InputError(f"--avatars: expected one folder, as a chunk is scored for each alone, found {len(avatars)}")
    if len(frames) != len(avatars):
        raise InputError(f"--frames: expected a folder for each of {len(avatars)} avatars, found {len(frames)}")


def remove_old_pictures(folder: Path, settings: EvaluateAvatar) -> None:
    """Remove pictures of an earlier run that this one does not replace: its scores are others."""
    if not settings.pictures:
        remove_pictures(folder, SHOWN)
    if not (settings.pictures and settings.intrinsic_layers):
        remove_pictures(folder, (LAYERS,))


def draw(
    folder: Path, variant: str, avatar: LoadedAvatar, per_image: pd.DataFrame, images: ImageShards,
    frames: FrameShards, settings: EvaluateAvatar,
) -> None:  # fmt: skip
    """Write the pictures of an avatar that are asked for."""
    if settings.pictures:
        write_pictures(folder, variant, avatar.render, per_image, images, frames)
    if settings.pictures and settings.intrinsic_layers:
        write_layers(folder, variant, avatar.intrinsic_layers, per_image, images, frames)


def times_of(folder: Path, avatar: LoadedAvatar, images: ImageShards, frames: FrameShards) -> dict[str, float]:
    """Seconds of an avatar's training, and milliseconds of a picture."""
    trained = float(read_table(folder / "log.parquet").seconds.iloc[-1])
    return {"training_seconds": trained, "render_milliseconds": measure_milliseconds(avatar.render, images, frames)}


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
