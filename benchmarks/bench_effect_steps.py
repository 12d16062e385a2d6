"""Time of a training step that an effect takes: steps of a finished subject with all effects, and with one less.

    python -m benchmarks.bench_effect_steps --results results/subjectA --results results/walker

trains anew from each subject's shards, in a folder of its own, on one thread, and takes the mean of the 40 steps after
the first 40. Prints a line of JSON for each subject: microseconds per texel, of all effects and of each, which are what
`pipeline.effects.effect_costs.STEP_US` says.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path

import numba
import torch
from torch.optim.optimizer import register_optimizer_step_post_hook

from pipeline.base.files import read_arrays
from pipeline.config.train_avatar import TrainAvatar
from pipeline.stages import train_avatar

WARM_STEPS, STEPS = 40, 40
"""Both are whole rounds (`train_avatar.steps_together`), whose steps are applied one right after the other."""

ALL = {"shading": "subsurface", "specular": "on", "shadow": "on"}
"""A body with every effect that costs time in a step."""

WITHOUT = {"specular": {"specular": "off"}, "learned_transport": {"shading": "microfacet"}}


def step_seconds(results: Path, change: dict[str, str]) -> float:
    """Processor seconds of a step, the mean of all after those that warm up."""
    clock: list[float] = []
    settings = TrainAvatar.model_validate({**ALL, **change, "avatar": "body", "steps": WARM_STEPS + STEPS})
    hook = register_optimizer_step_post_hook(lambda *_: clock.append(time.process_time()))
    try:
        with tempfile.TemporaryDirectory() as folder:
            train_avatar.run(
                subject=results.name, atlas=results / "atlas.safetensors", shards=results / "shards",
                frames=results / "shards/frames", effects=results / "effects.json", out=Path(folder, "avatar"),
                settings=settings,
            )  # fmt: skip
    finally:
        hook.remove()
    return (clock[-1] - clock[WARM_STEPS - 1]) / STEPS


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--results", type=Path, action="append", required=True, help="results/SUBJECT of a finished run"
    )
    args = parser.parse_args()
    torch.set_num_threads(1)
    numba.set_num_threads(1)
    for results in args.results:
        texels = len(read_arrays(results / "atlas.safetensors")["texel"])
        whole = step_seconds(results, {})
        less = {effect: whole - step_seconds(results, change) for effect, change in WITHOUT.items()}
        row = {name: round(1e6 * seconds / texels, 2) for name, seconds in {"all": whole, **less}.items()}
        print(json.dumps({"subject": results.name, "texels": texels, **row}), flush=True)


if __name__ == "__main__":
    main()
