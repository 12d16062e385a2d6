"""Seconds per training step of a finished subject, and how many of them its largest parts take.

`python -m benchmarks.bench_training_step --results results/walker` trains anew from the subject's shards, in a folder
of its own, and measures the steps after the first 40. Then the slow twin of the pixel filter takes the kernel's place,
in the same run. Prints one JSON line.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path
from unittest import mock

import torch

from pipeline.avatar.training.training import Training
from pipeline.config.train_avatar import TrainAvatar
from pipeline.rendering import supersample
from pipeline.stages import train_avatar

WARM_STEPS = 40
"""Steps that compile kernels and read frames for the first time."""


def measure(results: Path, steps: int, parts: bool = False) -> dict[str, object]:
    """Wall and processor seconds per step; with `parts`, also the share of the ten slowest operations."""
    clock: list[tuple[float, float]] = []
    profiler = torch.profiler.profile(activities=[torch.profiler.ProfilerActivity.CPU])
    take_step = Training.take_step

    def timed(self, step, *arguments, **words):
        if step >= WARM_STEPS:
            clock.append((time.perf_counter(), time.process_time()))
        if step == WARM_STEPS and parts:
            profiler.start()
        return take_step(self, step, *arguments, **words)

    with tempfile.TemporaryDirectory() as folder, mock.patch.object(Training, "take_step", timed):
        train_avatar.run(
            subject=results.name, atlas=results / "atlas.safetensors", shards=results / "shards",
            frames=results / "shards/frames", effects=results / "effects.json", out=Path(folder, "avatar"),
            settings=TrainAvatar(steps=WARM_STEPS + steps),
        )  # fmt: skip
    (wall, cpu), (wall_end, cpu_end) = clock[0], clock[-1]
    found: dict[str, object] = {"s": (wall_end - wall) / (steps - 1), "cpu_s": (cpu_end - cpu) / (steps - 1)}
    if parts:
        profiler.stop()
        events = [event for event in profiler.key_averages() if event.self_cpu_time_total > 0]
        total = sum(event.self_cpu_time_total for event in events)
        slowest = sorted(events, key=lambda event: -event.self_cpu_time_total)[:10]
        found["parts"] = {event.key: round(event.self_cpu_time_total / total, 3) for event in slowest}
    return found


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--results", type=Path, required=True, help="results/SUBJECT of a finished run")
    parser.add_argument("--steps", type=int, default=60)
    args = parser.parse_args()
    kernel = measure(args.results, args.steps)
    with mock.patch.object(supersample, "filter_down", supersample.filter_down_reference):
        twin = measure(args.results, args.steps)
    parts = measure(args.results, args.steps, parts=True)["parts"]
    row = {"kernel": kernel, "filter_twin": twin, "ratio": twin["s"] / kernel["s"], "parts": parts}
    print(json.dumps({"subject": args.results.name, "steps": args.steps, **row}))


if __name__ == "__main__":
    main()
