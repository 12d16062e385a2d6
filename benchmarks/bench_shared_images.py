"""Memory and time of the index against the number of images, by one job and shared by several.

    python -m benchmarks.bench_shared_images --capture captures/tiny --frames 480 4800 --chunk-images 4096

The frames of a capture are repeated under new numbers, as further names of its images and masks. Each stage is a
process of its own; memory is its largest resident set. Compares the bytes of the two indices. Writes
results/scaling/shared_images.csv: a row for each number of frames and kind of job.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pandas as pd
import yaml

from pipeline.base.files import write_table
from pipeline.capture.paths import fill


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
    return {"peak_mb": used.ru_maxrss / 1024, "cpu_s": used.ru_utime + used.ru_stime}


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
    options, rows = parser.parse_args(), []
    cameras = len(pd.read_csv(options.capture / "cameras.csv"))
    with tempfile.TemporaryDirectory(prefix="bench_shared_images_") as made:
        for count in options.frames:
            folder, own = Path(made, f"{count}"), -(-options.chunk_images // cameras)
            images = write_longer(options.capture, folder / "capture", count)
            jobs = {"one job": index(folder / "capture", folder / "one")}
            for first in range(-(-count // own)):
                words = ("--chunk", first, "--chunk-size", own)
                jobs[f"share {first}"] = index(folder / "capture", folder / "inspected", *words)
            tables = sorted((folder / "inspected").glob("*.parquet"))
            jobs["joining"] = index(folder / "capture", folder / "joined", "--inspected", *tables)
            rows += [{"frames": count, "images": images, "job": name, **taken} for name, taken in jobs.items()]
            print(pd.DataFrame(rows).to_string(index=False), flush=True)
            same = contents(folder / "one") == contents(folder / "joined")
            print(f"{count} frames: {'the same bytes' if same else 'DIFFERENT BYTES'} of the index")
    write_table(options.out, pd.DataFrame(rows))


if __name__ == "__main__":
    main()
