"""Memory and time of scoring an avatar against the number of images that are held out.

    python -m benchmarks.bench_scored_images --results results/tiny --images 50 500 5000 --enlarged 16

The held-out images of a finished subject, and the frames that they show, are written as often as it takes under new
numbers, and scored by one job, by shares of at most so many images, and by the job that joins the tables of these. Each
is a process of its own, on one thread; memory is its largest resident set. Compares the bytes of the scores. With
`--enlarged` a share of enlarged images is scored as well, whose sides are so many times as long. Writes
results/scaling/scored_images.csv: a row for each job, with its sizes, as bench_job_costs takes them.
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

import numpy as np
import pandas as pd

from pipeline.base.files import read_json, read_table, write_table
from pipeline.capture.records import FrameRecord, ImageRecord
from pipeline.capture.shards import read_frame_shards, read_image_shards, write_frame_shard, write_image_shard

ONE_THREAD = {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}

HELD_OUT = 0.43
"""Share of a capture's images, whose number a job knows, that is scored: of a recorded body 246 of 576."""

SCORES = ("metrics.csv", "metrics_per_image.parquet", "ablations.csv")
"""Files of evaluate_avatar that hold nothing measured."""


@dataclass(frozen=True)
class HeldOut:
    """Held-out images of a subject by frame, with what is known of the frame.

    Attributes:
        frames: number, state and images of each.
        images: of all of them together.
    """

    frames: list[tuple[int, FrameRecord, list[ImageRecord]]]
    images: int

    def enlarged(self, factor: int) -> HeldOut:
        """The same views, in images whose sides are so many times as long."""
        return HeldOut(
            [(n, frame, [_enlarged(each, factor) for each in own]) for n, frame, own in self.frames], self.images
        )

    @classmethod
    def read(cls, results: Path) -> HeldOut:
        """Of a finished run."""
        images, records = read_image_shards([results / "shards/test"]), read_frame_shards([results / "shards/frames"])
        rows = images.table.groupby("frame").groups.items()
        frames = [(int(frame), records[int(frame)], [images[row] for row in own]) for frame, own in rows]
        return cls(frames, len(images.table))


def _enlarged(image: ImageRecord, factor: int) -> ImageRecord:
    sides = {name: factor * getattr(image, name) for name in ("x0", "y0", "width", "height")}
    pixels = [each.repeat(factor, 0).repeat(factor, 1) for each in (image.image, image.mask)]
    return replace(image, **sides, image=pixels[0], mask=pixels[1], K=np.diag([factor, factor, 1.0]) @ image.K)


def write_shards(held_out: HeldOut, folder: Path, count: int, share: int) -> tuple[int, int]:
    """Shards of at least so many images, the known ones again and again.

    Args:
        held_out: the known ones.
        folder: for test/, validation/ and frames/.
        count: images in all.
        share: images in a shard, about.

    Returns:
        Number of frames and of shards.
    """
    each = len(held_out.frames)
    frames = -(-count * each // held_out.images)
    together = max(1, share * each // held_out.images)

    def shown(first: int) -> Iterator[tuple[int, FrameRecord, list[ImageRecord]]]:
        for number in range(first, min(first + together, frames)):
            yield number, *held_out.frames[number % each][1:]

    for chunk, first in enumerate(range(0, frames, together)):
        name = f"{chunk:04d}.arrow"
        write_frame_shard(folder / "frames" / name, (replace(frame, frame=n) for n, frame, _ in shown(first)))
        images = (replace(image, frame=n) for n, _, images in shown(first) for image in images)
        write_image_shard(folder / "test" / name, images)
        write_image_shard(folder / "validation" / name, iter(()))
    return frames, -(-frames // together)


def score(results: Path, shards: Path, out: Path, *words: object) -> dict[str, float]:
    """Peak memory and CPU seconds of evaluate_avatar, in a process of its own."""
    known = {
        "atlas": results / "atlas.safetensors", "effects": results / "effects.json", "shards": shards, "out": out,
        "avatars": results / "avatars/full", "subject": results.name,
    }  # fmt: skip
    command = [sys.executable, "-m", "pipeline.stages.evaluate_avatar"]
    command += [str(word) for name, value in known.items() for word in (f"--{name}", value)]
    started = subprocess.Popen([*command, *map(str, words)], env={**os.environ, **ONE_THREAD})
    _, status, used = os.wait4(started.pid, 0)
    started.returncode = os.waitstatus_to_exitcode(status)
    if started.returncode:
        raise SystemExit(started.returncode)
    return {"mb": used.ru_maxrss / 1024, "seconds": used.ru_utime + used.ru_stime}


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--results", type=Path, required=True, help="results/SUBJECT of a finished run")
    parser.add_argument("--images", type=int, nargs="+", default=[50, 500, 5000], help="numbers of images")
    parser.add_argument("--share", type=int, default=500, help="images of a share, at most")
    parser.add_argument("--out", type=Path, default=Path("results/scaling/scored_images.csv"), help="table to write")
    parser.add_argument("--enlarged", type=int, default=0, help="factor by which the sides of images are longer")
    options, rows = parser.parse_args(), []
    held_out, without = HeldOut.read(options.results), "--no-pictures"
    cameras = read_table(options.results / "index/cameras.parquet")
    sizes = {
        "stage": "evaluate_avatar", "subject": options.results.name, "cameras": len(cameras), "avatars": 1,
        "pixels": int((cameras.width * cameras.height).mean()), "threads": 1,
        "texels": read_json(options.results / "avatars/full/config.json")["texels"],
    }  # fmt: skip
    with tempfile.TemporaryDirectory(prefix="bench_scored_images_") as made:
        for count in options.images:
            folder = Path(made, str(count))
            frames, shards = write_shards(held_out, folder, count, options.share)
            jobs = {"one job": (frames, score(options.results, folder, folder / "one", without))}
            for chunk in range(shards):
                words = ("--chunk", chunk, without)
                own = len(read_frame_shards([folder / f"frames/{chunk:04d}.arrow"]))
                jobs[f"share {chunk}"] = own, score(options.results, folder, folder / "scores/full", *words)
            joined = score(options.results, folder, folder / "joined", "--scores", folder / "scores", without)
            jobs["joining"] = 0, joined
            for name, (own, taken) in jobs.items():
                listed = 0 if name.startswith("share") else round(count / HELD_OUT)
                rows.append({**sizes, "images": count, "job": name, "frames": own, "listed": listed, **taken})
            print(pd.DataFrame(rows)[["images", "job", "mb", "seconds"]].to_string(index=False), flush=True)
            same = all(
                (folder / "one" / name).read_bytes() == (folder / "joined" / name).read_bytes() for name in SCORES
            )
            print(f"{count} images: {'the same bytes' if same else 'DIFFERENT BYTES'} of the scores", flush=True)
        if options.enlarged:
            folder = Path(made, "enlarged")
            frames, _ = write_shards(held_out.enlarged(options.enlarged), folder, held_out.images, held_out.images)
            taken = score(options.results, folder, folder / "scores/full", "--chunk", 0, without)
            larger = {
                "pixels": options.enlarged**2 * sizes["pixels"],
                "images": held_out.images,
                "job": "share 0",
                "listed": 0,
            }
            rows.append({**sizes, **larger, "frames": frames, **taken})
            print(pd.DataFrame(rows[-1:]).to_string(index=False))
    write_table(options.out, pd.DataFrame(rows))


if __name__ == "__main__":
    main()
