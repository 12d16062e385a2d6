"""Measure how long pictures of rows' avatars take, in turn.

    python -m benchmarks.bench_row_times --results results/subjectB --avatars results/rows/rgca results/rows/linear

Avatars are what `benchmarks.bench_rows --avatars` kept. A picture is one of some validation images, from a new pose and
new light on, on one thread. All avatars come once in each round, so that whatever slows the machine slows all of them.
Prints for each the median over the rounds with their quartiles, and what a picture takes over one of the first avatar,
round by round.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pandas as pd
import torch

from docs.generate.markdown import table
from pipeline.avatar.training.checkpoint import load_avatar
from pipeline.capture.shards import read_frame_shards, read_image_shards
from pipeline.metrics.cost import interleaved
from pipeline.stages.evaluate_avatar import measure_milliseconds


def milliseconds(results: Path, avatars: list[Path], rounds: int) -> pd.DataFrame:
    """Milliseconds of a picture: a column per avatar, a row per round."""
    images = read_image_shards([results / "shards/validation"])
    taken: dict[str, list[float]] = {path.name: [] for path in avatars}
    for path in interleaved(avatars, [rounds] * len(avatars)):
        own = results / "variants" / path.name / "frames"
        frames = read_frame_shards([own if own.is_dir() else results / "shards/frames"])
        avatar = load_avatar(path, results / "atlas.safetensors")
        taken[path.name].append(measure_milliseconds(avatar.render, images, frames))
    return pd.DataFrame(taken)


def as_markdown(taken: pd.DataFrame) -> str:
    """The table of a page."""
    lines = []
    for name in taken:
        low, middle, high = np.percentile(taken[name], [25, 50, 75])
        over = np.median(taken[name] / taken.iloc[:, 0])
        lines.append([f"`{name}`", f"{middle:.0f} ({low:.0f} to {high:.0f})", f"{over:.2f}"])
    return table(("row", "picture, ms", "over the first"), lines)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--results", type=Path, required=True, help="folder results/SUBJECT")
    parser.add_argument("--avatars", type=Path, nargs="+", required=True, help="folders of avatars, the first the base")
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    torch.set_num_threads(1)
    print(as_markdown(milliseconds(options.results, options.avatars, options.rounds)))


if __name__ == "__main__":
    main()
