"""The page about a capture of the papers' size."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from benchmarks.paper_capture import PaperSize
from benchmarks.paper_costs import EXPONENT_ERROR, HELD_OUT, RAW, StageCost, words
from benchmarks.schedule import Cluster, Schedule

HOUR, DAY, TERA = 3600.0, 86400.0, 1e12

INTRODUCTION = """\
# A capture of the papers' size

<!-- Written by `python -m benchmarks.bench_paper_size`: run it again, or change benchmarks/paper_page.py. -->

RFGCA was filmed by {cameras:,} cameras under {lights:,} lights, {frames:,} frames of {width} x {height} pixels:
{images:.2f} million images. No such capture was run. This page says what the workflow would make of one, trained with
`config/presets/gpu.yaml`, and where it would be absurd. Its tables are whole, its images links to one.

Costs are those of [the jobs that were measured](clusters.md#what-jobs-ask-for), at sizes up to thousands of times
larger. So all numbers have an interval: the largest error of the runs that were fitted, times what an exponent that is
off by {exponent} makes of the distance, given in the column `beyond`. Nobody has measured that far. What no fitted run
tells apart is missing: `track_mesh` was fitted without pixels, which took little of its time there, and
`evaluate_avatar` as if as large a share of images were scored.
"""

PLAN = """\
## The plan

| from | jobs | wall, s | CPU, s | memory, MB |
|---|---|---|---|---|
{rows}

A plan reads tables and the names of the first 5,000 files, and no image.
"""

STAGES = """\
## What the stages take

CPU hours are of all jobs of a stage; the longest job is one of them with the threads it asks for, {cores} at most.
Bytes are those of all jobs: captured images of {low} to {high} bytes a pixel, of which {held} are scored.

| stage | jobs | threads | memory asked, GB | CPU hours | longest job, hours | read, TB | written, TB | beyond |
|---|---|---|---|---|---|---|---|---|
{rows}
"""

RUNS = """\
## How long it takes

By a simulation of the jobs and what they wait for, on nodes of {cores} cores and {memory} GB; the longest way to the
end goes first, and {overhead:.0f} s pass between a job and the next. A job that asks for more memory than a node has
gets all of it.

| nodes | wall, days | of it before training, days | cores at work |
|---|---|---|---|
{rows}

Nodes beyond the number of chunks help no stage: what is left is the row of jobs without chunks.

{checked}
"""

CHECKED = """\
The simulation was held against two runs on Slurm by `python -m benchmarks.bench_schedule`: `tiny` in three chunks on
two nodes of two cores, a cluster on one host that did much else. The first, of 19 jobs, took 448 s, and gave the
seconds between a job and the next: with 29 the simulation takes as long. The second, of 23 jobs, with shares of images
and a training that was cancelled, took 428 s. Simulated with these 29 s it takes 441 s, with the times that its
commands took there, and 387 s with those that the table of costs expects; without them, 93 s."""
"""The simulation against runs on Slurm, as `benchmarks/bench_schedule.py` measured it."""

ABSURD = """\
## Where it is absurd

| stage | why | what would mend it |
|---|---|---|
{rows}

Jobs of `inspect_images`, `trace_irradiance`, `pack_shards` and `score_images` are bounded by their chunk, those of
`find_boards` by their share of the photographs, those of `measure_lights` by their cameras, those of `track_mesh` by
their chunk and the cameras that are looked at, and training keeps at most `training_cache_mb` of frames. What does grow
with the capture is a row for each image, in `index_capture`, one for each corner of a board in `calibrate_cameras`, one
for each spot in `calibrate_lights`, and one for each scored image in `evaluate_avatar`, which join the tables of the
others; and the table of lit lights, which many stages read whole.
"""

ABSURDITIES = (
    ("measure_lights", "a mirror ball photographed by every camera under every light, half a million images",
     "photograph it with a few cameras"),
    ("calibrate_lights", "its fit to the spots of so many photographs was never measured", "the same"),
    ("train_avatar", "{train} CPU hours in one job",
     "a GPU, for which the preset is made; fewer steps; or several nodes, `training_nodes`"),
    ("score_images", "{scores} CPU hours for {held} of the images", "fewer held-out images"),
)  # fmt: skip
"""Rule, what is wrong with it at this size, and what can be done."""


@dataclass(frozen=True)
class Planning:
    """Cost of a dry run, and the jobs that it plans."""

    wall_s: float
    cpu_s: float
    peak_mb: float
    jobs: dict[str, int]


def paper_page(
    size: PaperSize, fresh: Planning, whole: Planning, costs: Mapping[str, StageCost],
    runs: Mapping[tuple[int, str], Schedule],
) -> str:  # fmt: skip
    """Markdown of the page."""
    images, node = size.cameras * size.frames / 1e6, Cluster(1)
    return "\n".join((
        INTRODUCTION.format(**vars(size), images=images, exponent=EXPONENT_ERROR),
        PLAN.format(rows="\n".join(_plan_rows(fresh, whole))),
        STAGES.format(rows="\n".join(_stage_rows(costs)), low=RAW[0], high=RAW[2], held=f"{100 * HELD_OUT:.0f} %",
                      cores=node.cores),
        RUNS.format(rows="\n".join(_run_rows(runs)), cores=node.cores, memory=node.mem_mb // 1000,
                    overhead=node.overhead_s, checked=CHECKED),
        ABSURD.format(rows="\n".join(_absurd_rows(costs))),
    ))  # fmt: skip


def _plan_rows(fresh: Planning, whole: Planning) -> list[str]:
    rows = (("nothing", fresh), ("the plan of effects, with shadows", whole))
    return [
        f"| {name} | {sum(plan.jobs.values())} | {plan.wall_s:.1f} | {plan.cpu_s:.1f} | {plan.peak_mb:,.0f} |"
        for name, plan in rows
    ]


def _stage_rows(costs: Mapping[str, StageCost]) -> list[str]:
    rows = []
    for stage, cost in sorted(costs.items(), key=lambda item: -item[1].cpu_s.middle * item[1].jobs):
        hours = words(cost.cpu_s.times(cost.jobs), HOUR), words(cost.wall_s, HOUR)
        parts = (
            f"`{stage}`", cost.jobs, cost.threads, f"{cost.mem_mb / 1000:,.1f}", *hours,
            words(cost.read, TERA), words(cost.written, TERA), f"{cost.beyond:,.0f} x",
        )  # fmt: skip
        rows.append("| " + " | ".join(map(str, parts)) + " |")
    return rows


def _run_rows(runs: Mapping[tuple[int, str], Schedule]) -> list[str]:
    rows = []
    for nodes in dict.fromkeys(nodes for nodes, _ in runs):
        low, middle, high = (runs[nodes, end] for end in ("low", "middle", "high"))
        before = middle.ends["pack_shards"] / DAY
        days = f"{middle.wall_s / DAY:.1f} ({low.wall_s / DAY:.1f} to {high.wall_s / DAY:.1f})"
        rows.append(f"| {nodes} | {days} | {before:.1f} | {100 * middle.busy:.1f} % |")
    return rows


def _absurd_rows(costs: Mapping[str, StageCost]) -> list[str]:
    train = words(costs["train_avatar"].cpu_s, HOUR)
    scored = costs["score_images"]
    values = {"train": train, "scores": words(scored.cpu_s.times(scored.jobs), HOUR), "held": f"{100 * HELD_OUT:.0f} %"}
    filled = [[cell.format(**values) for cell in row] for row in ABSURDITIES]
    return [f"| `{stage}` | {why} | {mend} |" for stage, why, mend in filled]
