"""Memory and time of `index_capture` against the rows of a table of 2D keypoints.

    python -m benchmarks.bench_keypoint_rows --rows 500000 2000000 8000000

A table is made for each size, of 20 cameras and 50 keypoints, camera by camera: the order that is farthest from the
index's. It is checked and copied in a process of its own. Memory is what the peak adds to what was there before. Writes
results/scaling/keypoint_rows.csv: a row for each size.
"""

from __future__ import annotations

import argparse
import multiprocessing
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks.call_cost import cost_of
from pipeline.base.errors import Complaints
from pipeline.base.files import write_table
from pipeline.base.large_tables import written_pieces
from pipeline.capture.index.keypoint_tables import KeypointSource, copy_keypoints

CAMERAS = [f"cam{number:03d}" for number in range(20)]
KEYPOINTS = [f"keypoint_{number:02d}" for number in range(50)]

TABLE = "given.parquet"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("results/scaling"), help="folder to write to")
    parser.add_argument("--rows", type=int, nargs="+", default=[500_000, 2_000_000, 8_000_000], help="of the tables")
    options = parser.parse_args()
    spawned = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=spawned, max_tasks_per_child=1) as processes:
        table = pd.DataFrame(list(processes.map(measure, options.rows)))
    write_table(options.out / "keypoint_rows.csv", table)
    print(table.round(2).to_string(index=False))


def measure(rows: int) -> dict[str, float]:
    """Cost of one table; a small one first, so that what is done once does not count."""
    frames = rows // (len(CAMERAS) * len(KEYPOINTS))
    with tempfile.TemporaryDirectory(prefix="bench_keypoint_rows_") as name:
        for number in (1, frames):
            folder = Path(name) / f"{number}_frames"
            write_keypoints(folder / TABLE, number)
            cost = cost_of(lambda folder=folder, number=number: index(folder, number), 1)
        return {"rows": rows, **cost, "file MB": (folder / TABLE).stat().st_size / 2**20}


def write_keypoints(path: Path, frames: int) -> None:
    """Write a table of as many frames, camera by camera."""
    random = np.random.default_rng(0)
    count = frames * len(KEYPOINTS)
    with written_pieces(path) as writer:
        for camera in CAMERAS:
            numbers = {column: random.uniform(size=count) for column in ("x", "y", "confidence")}
            names = {"frame": np.repeat(np.arange(frames), len(KEYPOINTS)), "camera": camera}
            writer.add(pd.DataFrame({**names, "keypoint": KEYPOINTS * frames, **numbers}))


def index(folder: Path, frames: int) -> None:
    """Check and copy the table of a folder."""
    complaints = Complaints(folder)
    known = {"frame": range(frames), "camera": CAMERAS, "keypoint": KEYPOINTS}
    copy_keypoints(KeypointSource(folder, TABLE), known, folder, complaints)
    complaints.raise_if_any()


if __name__ == "__main__":
    main()
