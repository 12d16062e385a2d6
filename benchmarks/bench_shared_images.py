"""Memory and time of the index against the number of images, by one job and shared by several.

    python -m benchmarks.bench_shared_images --capture captures/tiny --frames 480 4800 --chunk-images 4096 --paper 8

The frames of a capture are repeated under new numbers, as further names of its images and masks. Each stage is a
process of its own; memory is its largest resident set. Compares the bytes of the two indices. With `--paper` also some
frames of a capture of the papers' size are inspected: links to one image of 1332 x 1152 pixels, 512 of each frame, and
to one photograph of 16 times as many. Writes results/scaling/shared_images.csv: a row for each job, with its sizes, as
bench_job_costs takes them.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import yaml

from benchmarks.paper_capture import PaperSize, write_capture
from pipeline.base.files import write_table
from pipeline.capture.paths import fill
from pipeline.config.index_capture import IndexCapture

PHOTOGRAPHING = 8
"""Cameras of which a capture of the papers' size has photographs of a mirror ball here, three of each: enough to find
all threads at work on one."""

THREADS = IndexCapture().decode_threads
"""Of each job, the default."""


def write_longer(capture: Path, folder: Path, count: int) -> int:
    """A capture of so many frames, those of another again and again; returns its number of images and masks."""
    described = yaml.safe_load((capture / "capture.yaml").read_text())
    shutil.copytree(capture, folder, ignore=shutil.ignore_patterns("images", "masks", "truth"))
    frames, images = pd.read_csv(capture / "frames.csv"), 0
    step = 1 / described["fps"]
    rows = frames.iloc[[number % len(frames) for number in range(count)]]
    table = pd.DataFrame({"frame": range(count), "timestamp_s": [step * n for n in range(count)]})
    table.assign(segment=rows.segment.tolist()).to_csv(folder / "frames.csv", index=False)
    for section in ("images", "masks"):
        pattern = described[section]["path"]
        for camera in pd.read_csv(capture / "cameras.csv").camera:
            for number, known in enumerate(rows.frame.tolist()):
                path = folder / fill(pattern, camera=camera, frame=number)
                path.parent.mkdir(parents=True, exist_ok=True)
                if number < len(frames):
                    shutil.copy(capture / fill(pattern, camera=camera, frame=known), path)
                else:
                    os.link(folder / fill(pattern, camera=camera, frame=number % len(frames)), path)
                images += 1
    return images


def index(capture: Path, out: Path, *words: object) -> dict[str, float]:
    """Peak memory and CPU seconds of index_capture, in a process of its own."""
    command = [sys.executable, "-m", "pipeline.stages.index_capture", "--capture", capture, "--out", out, *words]
    started = subprocess.Popen([str(word) for word in command])
    _, status, used = os.wait4(started.pid, 0)
    started.returncode = os.waitstatus_to_exitcode(status)
    if started.returncode:
        raise SystemExit(started.returncode)
    return {"mb": used.ru_maxrss / 1024, "seconds": used.ru_utime + used.ru_stime}


def write_picture(path: Path, width: int, height: int) -> None:
    """A picture as smooth and grainy as photographs are."""
    noise = np.random.default_rng(0).normal(0, 2, (height, width, 3)).astype(np.float32)
    wave = 100 + 60 * np.sin(np.linspace(0, 9, width, dtype=np.float32))[:, None] + noise
    cv2.imwrite(str(path), np.clip(wave, 0, 255).astype(np.uint8))


def inspect_paper(folder: Path, frames: int) -> dict[str, object]:
    """A job that inspects some frames of a capture of the papers' size: sizes and costs."""
    size = PaperSize(frames=frames)
    write_capture(folder / "capture", size, "paper")
    write_picture(folder / "capture/image.png", size.width, size.height)
    write_picture(folder / "capture/photograph.png", 4 * size.width, 4 * size.height)
    for camera in range(PHOTOGRAPHING):
        own = folder / f"capture/ball/middle/cam{camera:03d}"
        own.mkdir(parents=True)
        for name in ("silhouette", "L0000", "L0001"):
            os.symlink("../../../photograph.png", own / f"{name}.png")
    taken = index(folder / "capture", folder / "inspected", "--chunk", 0, "--chunk-size", frames)
    return {
        "subject": "paper", "images": size.cameras * frames, "job": "share 0", "cameras": size.cameras,
        "frames": frames, "pixels": size.width * size.height, "listed": 0, **taken,
    }  # fmt: skip


def contents(folder: Path) -> dict[str, bytes]:
    """Files of an index."""
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--capture", type=Path, required=True, help="capture whose frames are repeated")
    parser.add_argument("--frames", type=int, nargs="+", default=[480, 4800], help="numbers of frames")
    parser.add_argument("--chunk-images", type=int, default=4096, help="images of a share, at least")
    parser.add_argument("--out", type=Path, default=Path("results/scaling/shared_images.csv"), help="table to write")
    parser.add_argument("--paper", type=int, default=0, help="frames of a capture of the papers' size")
    options, rows = parser.parse_args(), []
    table = pd.read_csv(options.capture / "cameras.csv")
    cameras, pixels = len(table), int((table.width * table.height).mean())
    with tempfile.TemporaryDirectory(prefix="bench_shared_images_") as made:
        for count in options.frames:
            folder, own = Path(made, f"{count}"), -(-options.chunk_images // cameras)
            images = write_longer(options.capture, folder / "capture", count)
            jobs = {"one job": (count, cameras * count, index(folder / "capture", folder / "one"))}
            for first in range(-(-count // own)):
                words = ("--chunk", first, "--chunk-size", own)
                frames = min(own, count - first * own)
                jobs[f"share {first}"] = frames, 0, index(folder / "capture", folder / "inspected", *words)
            tables = sorted((folder / "inspected").glob("*.parquet"))
            joined = index(folder / "capture", folder / "joined", "--inspected", *tables)
            jobs["joining"] = 0, cameras * count, joined
            same = {"subject": options.capture.name, "images": images, "cameras": cameras, "pixels": pixels}
            rows += [{**same, "job": n, "frames": f, "listed": known, **cost} for n, (f, known, cost) in jobs.items()]
            print(pd.DataFrame(rows).to_string(index=False), flush=True)
            equal = contents(folder / "one") == contents(folder / "joined")
            print(f"{count} frames: {'the same bytes' if equal else 'DIFFERENT BYTES'} of the index", flush=True)
        if options.paper:
            rows.append(inspect_paper(Path(made, "paper"), options.paper))
            print(pd.DataFrame(rows[-1:]).to_string(index=False))
    write_table(options.out, pd.DataFrame(rows).assign(stage="index_capture", threads=THREADS))


if __name__ == "__main__":
    main()
