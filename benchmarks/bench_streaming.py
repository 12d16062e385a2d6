"""Memory and speed of training against the number of frames, and against the memory that frames may be kept in.

    python -m benchmarks.bench_streaming --results results/tiny --frames 48 480 4800 --cache-mb 0 1000000 --visits 1
    python -m benchmarks.bench_streaming --results results/walker --frames 48 --cache-mb 0 1000000 --scratch

The frames of a finished subject, with two images each, are written as often as it takes under new numbers; an avatar is
trained on them, one process on one thread, so that a step looks at one frame and all of them are visited. Memory is the
largest resident set of the process; speed that of the second half of the steps, in which nothing is compiled. Writes
results/scaling/streaming.csv: a row for each number of frames and memory to keep them in.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import pandas as pd

from pipeline.base.files import read_json, read_table, write_table
from pipeline.capture.records import FrameRecord, ImageRecord
from pipeline.capture.shards import read_frame_shards, read_image_shards, write_frame_shard, write_image_shard
from pipeline.config.flags import flags
from pipeline.config.train_avatar import TrainAvatar

IMAGES_OF_FRAME, FRAMES_OF_SHARD = 2, 64
"""Images written of each frame, as many as a step takes; and frames in a shard, the workflow's default."""

ONE_THREAD = {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


@dataclass(frozen=True)
class Taken:
    """Cost of a training.

    Attributes:
        peak_mb: largest resident set.
        s_per_step: wall seconds of a step of the second half.
        cpu_s: of the process, from its start to its end.
    """

    peak_mb: float
    s_per_step: float
    cpu_s: float


def known_frames(results: Path) -> list[tuple[FrameRecord, list[ImageRecord]]]:
    """Frames of a finished subject that have enough training images, with some of these."""
    images, records = read_image_shards([results / "shards/train"]), read_frame_shards([results / "shards/frames"])
    rows = images.table.groupby("frame").groups.items()
    return [
        (records[int(frame)], [images[row] for row in own[:IMAGES_OF_FRAME]])
        for frame, own in rows
        if len(own) >= IMAGES_OF_FRAME
    ]


def write_frames(results: Path, folder: Path, count: int) -> Path:
    """Shards of so many frames, the known ones again and again; returns their folder."""
    known = known_frames(results)

    def frames(first: int) -> Iterator[tuple[int, FrameRecord, list[ImageRecord]]]:
        for number in range(first, min(first + FRAMES_OF_SHARD, count)):
            yield number, *known[number % len(known)]

    for chunk, first in enumerate(range(0, count, FRAMES_OF_SHARD)):
        own = (replace(record, frame=number) for number, record, _ in frames(first))
        write_frame_shard(folder / f"frames/{chunk:04d}.arrow", own)
        shown = (replace(image, frame=number) for number, _, images in frames(first) for image in images)
        write_image_shard(folder / f"train/{chunk:04d}.arrow", shown)
    return folder


def train(
    results: Path, shards: Path, out: Path, settings: TrainAvatar, cache_mb: int, scratch: Path | None = None
) -> Taken:
    """A training in a process of its own."""
    words = {
        "subject": results.name, "atlas": results / "atlas.safetensors", "shards": shards,
        "effects": results / "effects.json", "out": out, "processes": 1, "cache-mb": cache_mb,
    }  # fmt: skip
    if scratch is not None:
        words["scratch"] = scratch
    if (results / "eyes.json").exists():
        words["fitted-eyes"] = results / "eyes.json"
    command = [sys.executable, "-m", "pipeline.stages.train_avatar", *flags(settings)]
    command += [word for name, value in words.items() for word in (f"--{name}", str(value))]
    started = subprocess.Popen(command, env={**os.environ, **ONE_THREAD})
    _, status, used = os.wait4(started.pid, 0)
    started.returncode = os.waitstatus_to_exitcode(status)
    if started.returncode:
        raise SystemExit(started.returncode)
    log = read_table(out / "log.parquet")
    half, last = log.iloc[len(log) // 2], log.iloc[-1]
    seconds = (last.seconds - half.seconds) / (last.step - half.step)
    return Taken(used.ru_maxrss / 1024, float(seconds), used.ru_utime + used.ru_stime)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--results", type=Path, required=True, help="results/SUBJECT of a finished run")
    parser.add_argument("--frames", type=int, nargs="+", default=[48, 480], help="numbers of frames")
    parser.add_argument(
        "--cache-mb", type=int, nargs="+", default=[0, 1_000_000], help="memory for frames that are kept"
    )
    parser.add_argument("--scratch", action="store_true", help="also the first of these with traced light on a disk")
    parser.add_argument("--visits", type=float, default=2.0, help="steps for each frame")
    parser.add_argument("--out", type=Path, default=Path("results/scaling/streaming.csv"), help="table to write")
    options = parser.parse_args()
    trained = read_json(options.results / "avatars/full/config.json")
    rows = []
    with tempfile.TemporaryDirectory(prefix="bench_streaming_") as made:
        folder = Path(made)
        for count in options.frames:
            shards, steps = write_frames(options.results, folder / str(count), count), round(options.visits * count)
            changes = {"steps": steps, "log_every": 1, "preview_every": 0, "device": "cpu", "checkpoint_every": steps}
            settings = TrainAvatar(**{**trained["settings"], "cameras_per_step": IMAGES_OF_FRAME, **changes})
            ways = [(cache_mb, None) for cache_mb in options.cache_mb]
            ways += [(options.cache_mb[0], folder / "scratch")] * options.scratch
            for number, (cache_mb, scratch) in enumerate(ways):
                taken = train(options.results, shards, folder / f"{count}_{number}", settings, cache_mb, scratch)
                sizes = {"subject": options.results.name, "texels": trained["texels"], "frames": count, "steps": steps}
                kept = {"cache_mb": cache_mb, "scratch": scratch is not None}
                rows.append({**sizes, **kept, **vars(taken), "steps_per_s": 1 / taken.s_per_step})
                print(pd.DataFrame(rows).to_string(index=False), flush=True)
            avatars = {(folder / f"{count}_{n}/avatar.safetensors").read_bytes() for n in range(len(ways))}
            print(f"{count} frames: {'the same bytes' if len(avatars) == 1 else 'DIFFERENT BYTES'} of the avatar")
    write_table(options.out, pd.DataFrame(rows))


if __name__ == "__main__":
    main()
