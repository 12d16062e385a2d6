"""Where a training step of a finished subject spends its time, part by part, and what training holds of a frame.

    python -m benchmarks.bench_training_parts --results results/walker --out results/time/training_walker.json

Trains anew from the subject's shards with the subject's settings, in a folder of its own, on one thread, with all
frames visited before: of a long training, first visits are no part. After steps that compile, it measures as many as
asked for, and then profiles as many more: the profile divides the processor time of a step that nobody looked at.
Functions of the parts are marked while they run (`benchmarks.training_ranges`), backward by the nodes that they left in
the graph; the loop itself is not touched.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections import Counter
from contextlib import ExitStack
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from unittest import mock

import numba
import numpy as np
import torch
from torch.optim.optimizer import register_optimizer_step_post_hook

from benchmarks.training_ranges import REST, Part, marked, seconds_of_parts
from pipeline.avatar.frames.frame_stream import FrameStream
from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.base.files import read_json, write_json
from pipeline.config.train_avatar import TrainAvatar
from pipeline.config.trained_model import ANALYTIC
from pipeline.stages import train_avatar

WARM_STEPS = 10
"""Steps that compile kernels, and fill caches and the allocator's stores."""

VISITED = ("posed", "irradiance", "lights")
"""What every step asks of its frame; what else it asks for is there after the first of its steps."""

TRACED = ("visibility_bits", "bounces")
"""What a step of analytic shading asks for as well, traced at a frame's first visit."""


@dataclass
class Clock:
    """Times of the optimiser's steps, and a profile of those after `steps` that were measured.

    Attributes:
        times: wall and processor seconds at the end of each step that counts.
        profiled_s: wall seconds of the profiled steps.
    """

    steps: int
    profiler: torch.profiler.profile = field(
        default_factory=lambda: torch.profiler.profile(activities=[torch.profiler.ProfilerActivity.CPU])
    )
    times: list[tuple[float, float]] = field(default_factory=list)
    done: int = 0
    profiled_s: float = 0.0

    def step(self, *_: object) -> None:
        """Called after each step of an optimiser."""
        self.done += 1
        measured = self.done - WARM_STEPS
        if 0 <= measured <= self.steps:
            self.times.append((time.perf_counter(), time.process_time()))
        if measured == self.steps:
            self.profiler.start()
            self.profiled_s = -time.perf_counter()
        if measured == 2 * self.steps:
            self.profiled_s += time.perf_counter()
            self.profiler.stop()

    def per_step(self) -> tuple[float, float]:
        """Wall and processor seconds of a measured step."""
        (wall, cpu), (wall_end, cpu_end) = self.times[0], self.times[-1]
        return (wall_end - wall) / self.steps, (cpu_end - cpu) / self.steps


def measure(results: Path, steps: int, variant: str = "full") -> dict[str, object]:
    """Seconds of a step, of its parts, and bytes of a frame; see the module for how."""
    clock, seen = Clock(steps), []

    def visited(*arguments: object) -> FrameStream:
        seen.append(FrameStream(*arguments))
        seen[0].most_bytes = None
        for frame in seen[0].values():
            for name in asked:
                getattr(frame, name)
        return seen[0]

    trained = read_json(results / "avatars" / variant / "config.json")
    asked = VISITED + TRACED * (trained["spec"]["shading"] in ANALYTIC)
    settings = TrainAvatar(**{**trained["settings"], "steps": WARM_STEPS + 2 * steps, "device": "cpu"})
    eyes = results / "eyes.json"
    hook = register_optimizer_step_post_hook(clock.step)
    try:
        with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
            stack.enter_context(mock.patch.object(train_avatar, "FrameStream", visited))
            stack.enter_context(marked())
            train_avatar.run(
                subject=results.name, atlas=results / "atlas.safetensors", shards=results / "shards",
                effects=results / "effects.json", out=Path(folder, "avatar"),
                fitted_eyes=eyes if eyes.exists() else None, settings=settings,
            )  # fmt: skip
    finally:
        hook.remove()
    wall, cpu = clock.per_step()
    held = [held_bytes(inputs) for inputs in seen[0].values()]
    return {
        "subject": trained["subject"], "steps": steps, "texels": trained["texels"],
        "cameras_per_step": settings.cameras_per_step, "s": wall, "cpu_s": cpu,
        "parts": table(seconds_of_parts(clock.profiler.events()), clock.profiled_s, cpu),
        "frames_held": len(held), "bytes_of_a_frame": dict(max(held, key=lambda counts: counts.total())),
    }  # fmt: skip


def table(seconds: dict[Part, float], whole_s: float, cpu_s: float) -> list[dict[str, object]]:
    """Rows by size: seconds of each part in a step that takes `cpu_s`, forward and backward.

    What no event of the profile covers, the interpreter between operations, belongs to the rest.
    """
    names = {part.name for part in seconds} | {REST}
    between = max(whole_s - sum(seconds.values()), 0.0)
    rows = []
    for name in names:
        forward = seconds.get(Part(name, False), 0.0) + (between if name == REST else 0.0)
        backward = seconds.get(Part(name, True), 0.0)
        whole = max(whole_s, sum(seconds.values()))
        rows.append({"part": name, "forward_s": cpu_s * forward / whole, "backward_s": cpu_s * backward / whole})
    return sorted(rows, key=lambda row: -row["forward_s"] - row["backward_s"])


def held_bytes(inputs: FrameInputs) -> Counter[str]:
    """Bytes of every array that a frame's inputs hold once they were visited, by name; the atlas is all frames'."""
    shared = {"atlas", "sky", "device"}
    return array_bytes({name: value for name, value in vars(inputs).items() if name not in shared})


def array_bytes(held: object, name: str = "") -> Counter[str]:
    """Bytes of the arrays within dictionaries, tuples and dataclasses, by the names that lead there."""
    if isinstance(held, torch.Tensor | np.ndarray):
        return Counter({name: held.nbytes})
    if is_dataclass(held):
        held = {one.name: getattr(held, one.name) for one in fields(held)}
    if isinstance(held, tuple):
        held = {str(number): value for number, value in enumerate(held)}
    found: Counter[str] = Counter()
    if isinstance(held, dict):
        for key, value in held.items():
            found += array_bytes(value, f"{name}.{key}".lstrip("."))
    return found


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--results", type=Path, required=True, help="results/SUBJECT of a finished run")
    parser.add_argument("--out", type=Path, required=True, help="JSON file to write")
    parser.add_argument("--steps", type=int, default=60, help="steps that are measured, and as many profiled")
    options = parser.parse_args()
    torch.set_num_threads(1)
    numba.set_num_threads(1)
    write_json(options.out, measure(options.results, options.steps))


if __name__ == "__main__":
    main()
