"""Count how often each stage decodes the images and masks of public sets.

    python -m benchmarks.bench_decodes [--only goliath ...]

Fakes of the sets go through all stages up to the packed images, and heads through their mean textures, in one process
and one chunk of frames. Every file that is decoded is counted for the stage that does it, and of videos every frame
that the codec decodes. Long videos are then read chunk by chunk. Writes the tables between marks of docs/datasets.md.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import yaml

from benchmarks.bench_dataset_costs import ATLAS
from benchmarks.fake_sets import FAKES, FakeSet
from benchmarks.marked_page import write_between
from pipeline.base.files import read_json, read_table
from pipeline.capture import video_frames
from pipeline.capture.video_frames import read_video_frame
from pipeline.capture.video_seeking import frame_times
from pipeline.config.import_capture import ImportCapture
from pipeline.stages import (
    bake_textures,
    book_patterns,
    calibrate_cameras,
    calibrate_color,
    calibrate_lights,
    import_capture,
    index_capture,
    pack_shards,
    plan_effects,
    track_mesh,
    unwrap_atlas,
)
from tests.support.datasets.decodes import Decodes, counted_decodes
from tests.support.datasets.imported import import_set, packed

PAGE = Path("docs/datasets.md")

STAGES = (
    import_capture, index_capture, calibrate_cameras, calibrate_color, calibrate_lights, track_mesh, book_patterns,
    unwrap_atlas, plan_effects, pack_shards, bake_textures,
)  # fmt: skip
"""All that a fake goes through, in this order."""

EVERY = "all"
"""Name of the row that sums the stages."""

VIDEO_FRAMES, CHUNK_FRAMES = 1100, 64
"""Of a long sequence of NeRSemble, and of a job as the defaults have it."""

VIDEOS = {"VP9": "vp09", "MPEG-2, two B-frames between others": "mpg2"}
"""Codecs of videos that are read chunk by chunk. OpenCV writes a key frame every 12 frames."""


@dataclass(frozen=True)
class Counted:
    """Decodes of one set.

    Attributes:
        images, masks: paths below the set's folder, of those that the capture has.
        decoded: stage and path below the set's folder of each decode.
        video_frames: frames that codecs decoded, by stage.
    """

    images: frozenset[str]
    masks: frozenset[str]
    decoded: Sequence[tuple[str, str]]
    video_frames: Counter[str]

    def times(self, stage: str, masks: bool) -> Counter[str]:
        """How often a stage decodes each image, or each mask; what is no mask of the capture counts as an image."""
        return Counter(path for name, path in self.decoded if stage in (name, EVERY) and (path in self.masks) is masks)


def count_fake(fake: FakeSet) -> Counted:
    """Take a fake through the stages."""
    with tempfile.TemporaryDirectory() as made, counted_decodes(*STAGES) as found:
        folder, truth = Path(made), fake.truth(image=fake.image)
        shipped = fake.write(folder / "set", truth)
        found.files.clear()
        found.video_frames.clear()
        capture, results = import_set(
            fake.dataset, shipped, folder, ImportCapture(**yaml.safe_load(fake.settings(folder, truth)))
        )
        packed(capture, results, ATLAS.get(fake.name, 32))
        if read_json(results / "index/capture.json")["kind"] == "head":
            bake(capture, results)
        return counted(found, capture, read_table(results / "index/images.parquet"))


def bake(capture: Path, results: Path) -> None:
    """Bake the mean textures of a packed capture."""
    bake_textures.run(
        capture=capture, index=results / "index", atlas=results / "atlas.safetensors",
        tracking=results / "tracking/0000.safetensors", cameras=results / "calibration/cameras.json",
        color=results / "calibration/color.json", effects=results / "effects.json",
        frames=results / "frames.parquet", out=results / "textures/0000",
    )  # fmt: skip


def counted(found: Decodes, capture: Path, images: pd.DataFrame) -> Counted:
    """What was found, by paths below the set's folder, which importing has by their own and others by the link."""
    link = capture / "source"
    prefixes = [f"{link}/", f"{link.resolve()}/", "source/"]

    def below_set(path: str) -> str:
        return next((path.removeprefix(prefix) for prefix in prefixes if path.startswith(prefix)), path)

    return Counted(
        frozenset(map(below_set, images.path)), frozenset(map(below_set, images.mask_path.dropna())),
        [(stage, below_set(path)) for stage, path in found.files], Counter(stage for stage, _ in found.video_frames),
    )  # fmt: skip


def rows(dataset: str, found: Counted) -> list[str]:
    """Rows of the table: a set's stages that decode anything, and all together."""
    size = f"{dataset}: {len(found.images)} images, {len(found.masks)} masks"
    there = {stage for stage, _ in found.decoded}
    names = [name for stage in STAGES if (name := stage.__name__.rpartition(".")[2]) in there]
    return [
        f"| {size if number == 0 else ''} | {name if name == EVERY else f'`{name}`'} | "
        f"{cells(found.times(name, masks=False))} | {cells(found.times(name, masks=True))} | "
        f"{(found.video_frames.total() if name == EVERY else found.video_frames[name]) or ''} |"
        for number, name in enumerate([*names, EVERY])
    ]


def cells(times: Counter[str]) -> str:
    """`files | times each`: one number if it is the same for all, else the mean and the range."""
    if not times:
        return "0 | "
    least, most = min(times.values()), max(times.values())
    each = f"{most}" if least == most else f"{times.total() / len(times):.2g} ({least} to {most})"
    return f"{len(times)} | {each}"


def table(found: Collection[tuple[str, Counted]]) -> list[str]:
    """Lines of the table."""
    return [
        "| fake | stage | images decoded | times each | masks decoded | times each | frames of videos |",
        "|---|---|---|---|---|---|---|",
        *(line for dataset, each in found for line in rows(dataset, each)),
    ]


def write_frames(path: Path, code: str) -> None:
    """Write a video of noise that moves."""
    noise = np.random.default_rng(0).integers(0, 256, (64, 2 * VIDEO_FRAMES + 96, 3)).astype(np.uint8)
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter_fourcc(*code), 24.0, (96, 64))
    for frame in range(VIDEO_FRAMES):
        writer.write(cv2.blur(noise[:, 2 * frame : 2 * frame + 96], (5, 5)))
    writer.release()


def video_row(what: str, folder: Path) -> str:
    """Row of a video: how many frames codecs decode for all chunks together, each read by a job of its own."""
    path = folder / "video.mp4"
    write_frames(path, VIDEOS[what])
    ends = [min(first + CHUNK_FRAMES, VIDEO_FRAMES) for first in range(0, VIDEO_FRAMES, CHUNK_FRAMES)]
    decoded, before = 0, sum(ends)
    for first, end in zip([0, *ends], ends, strict=False):
        video_frames._shared.cache_clear()
        frame_times.cache_clear()
        with counted_decodes() as found:
            for frame in range(first, end):
                read_video_frame(path, frame)
        decoded += len(found.video_frames)
    cells = f"{decoded:,} | {decoded / VIDEO_FRAMES:.2g} | {before:,} | {before / VIDEO_FRAMES:.2g}"
    return f"| {what} | {len(ends)} | {cells} |"


def video_table() -> list[str]:
    """Lines of the table of videos."""
    with tempfile.TemporaryDirectory() as made:
        return [
            f"| video of {VIDEO_FRAMES:,} frames | jobs | decoded by all | times each | from the first | times each |",
            "|---|---|---|---|---|---|",
            *(video_row(what, Path(made)) for what in VIDEOS),
        ]


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--only", nargs="*", default=[fake.name for fake in FAKES], help="sets; no page is written")
    options = parser.parse_args()
    fakes = {fake.name: fake for fake in FAKES}
    lines = table([(name, count_fake(fakes[name])) for name in options.only])
    videos = video_table()
    print("\n".join([*lines, *videos]))
    if options.only == list(fakes):
        write_between(PAGE, "decodes", lines)
        write_between(PAGE, "video chunks", videos)


if __name__ == "__main__":
    main()
