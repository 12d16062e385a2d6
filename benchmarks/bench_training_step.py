"""Seconds per training step of a finished subject with the kernel of the pixel filter, and with its slow twin.

`python -m benchmarks.bench_training_step --results results/walker` trains anew from the subject's shards, in a folder
of its own, and measures the steps after the first 40. Then the slow twin of the pixel filter takes the kernel's place,
in the same run. Prints one JSON line. `benchmarks.bench_training_parts` says what the parts of a step take.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path
from unittest import mock

from torch.optim.optimizer import register_optimizer_step_post_hook

from pipeline.config.train_avatar import TrainAvatar
from pipeline.rendering import supersample
from pipeline.stages import train_avatar

WARM_STEPS = 40
"""Steps that compile kernels and read frames for the first time."""


def measure(results: Path, steps: int) -> dict[str, float]:
    """Wall and processor seconds per step."""
    clock: list[tuple[float, float]] = []
    hook = register_optimizer_step_post_hook(lambda *_: clock.append((time.perf_counter(), time.process_time())))
    try:
        with tempfile.TemporaryDirectory() as folder:
            train_avatar.run(
                subject=results.name, atlas=results / "atlas.safetensors", shards=results / "shards",
                frames=results / "shards/frames", effects=results / "effects.json", out=Path(folder, "avatar"),
                settings=TrainAvatar(steps=WARM_STEPS + steps),
            )  # fmt: skip
    finally:
        hook.remove()
    (wall, cpu), (wall_end, cpu_end) = clock[WARM_STEPS - 1], clock[-1]
    return {"s": (wall_end - wall) / steps, "cpu_s": (cpu_end - cpu) / steps}


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--results", type=Path, required=True, help="results/SUBJECT of a finished run")
    parser.add_argument("--steps", type=int, default=60)
    args = parser.parse_args()
    kernel = measure(args.results, args.steps)
    with mock.patch.object(supersample, "filter_down", supersample.filter_down_reference):
        twin = measure(args.results, args.steps)
    row = {"kernel": kernel, "filter_twin": twin, "ratio": twin["s"] / kernel["s"]}
    print(json.dumps({"subject": args.results.name, "steps": args.steps, **row}))


if __name__ == "__main__":
    main()
