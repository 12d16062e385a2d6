"""Write the page "Where the time goes" from finished runs and from what the benchmarks measured.

    python -m docs.generate.where_time_goes --results results/subjectA results/walker --measured results/time

`make time` measures and then calls this. Numbers cannot be measured again whenever the documentation is built, so the
page is committed; its text says nothing that another measurement could make wrong.
"""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import tyro

from docs.generate.markdown import milliseconds, percent, significant, table
from pipeline.base.code_digest import ROOT
from pipeline.base.errors import InputError
from pipeline.base.files import read_json
from pipeline.base.finished_jobs import FinishedJob, finished_jobs
from pipeline.config.project import SECTIONS

PAGE = ROOT / "docs/where_time_goes.md"

LEFT_OUT = ("measure_cost",)
"""Stages that measure the others."""

HEAD = """\
# Where the time goes

<!-- Written by `make time` from results and benchmarks: run it again, or change docs/generate/where_time_goes.py. -->

What runs took, stage by stage; what a training step takes, part by part; and how far the hot loops are from what the
machine can do. Numbers are of the machine they were measured on. How they grow with the sizes of a capture is what
`make scaling` measures, see [results](results.md#scalingcsv).
"""

STAGES = """
## By stage

Of all jobs of a subject, from [Snakemake's benchmarks](results.md#benchmarkstsv): seconds are sums over jobs, memory is
that of the largest job.
Wall time counts what a job waited for, CPU time what it did on all its threads; both contain the start of Python and
its imports.
"""

STEP = """
## A training step

CPU time on one thread, by `benchmarks/bench_training_parts.py`, of a step with all frames visited before. Backward is
the gradient of what the forward pass of the same part did. What runs within another part, as gathering of light does
within the transfer, is counted once, where it is named.
"""

FRAME = """
## What training holds of a frame

Of frames that training comes back to it keeps as many as `training_cache_mb` allows: their records, and what a first
visit makes of them. Images are read as steps need them, from memory-mapped shards whose pages are given back at once.
"""

LIMITS = """
## Against the limits of the machine

By `benchmarks/bench_limits.py`, on one thread. A kernel can be no faster than its operations at the rate of a large
matrix product (float32, which counts a fused pair as two), nor than its bytes, each moved once, at the rate of memory.
The slower of the two bounds it; the share is the bound's time over the kernel's. Exponentials, divisions and choices
count as operations but cannot run at a matrix product's rate, so kernels that have them do not reach it.
"""

TWINS = """
Tracing and reading call libraries, Embree and OpenCV. The share is what the library's part takes alone, with everything
it needs made beforehand, over what the whole takes.
"""


def run(*, results: tuple[Path, ...], measured: Path = ROOT / "results/time", page: Path = PAGE) -> None:
    """Write the page.

    Args:
        results: folders results/SUBJECT of finished runs, for the tables of stages.
        measured: folder with training_SUBJECT.json and limits.json of the benchmarks.
        page: the page to write.

    Raises:
        InputError: if nothing was measured.
    """
    steps = [read_json(path) for path in sorted(measured.glob("training_*.json"))]
    limits = measured / "limits.json"
    if not steps or not limits.exists():
        raise InputError(f"{measured}: expected training_SUBJECT.json and limits.json, found not both; run `make time`")
    parts = [HEAD, STAGES, *(section(folder.name, stage_table(folder / "benchmarks")) for folder in results)]
    parts += [STEP, *(section(step["subject"], step_words(step) + parts_table(step)) for step in steps)]
    parts += [FRAME, *(section(step["subject"], frame_table(step)) for step in steps)]
    found = read_json(limits)
    parts += [LIMITS, "\n", limit_words(found), kernel_table(found), TWINS, "\n", twin_table(found)]
    page.write_text("".join(parts))


def section(subject: str, content: str) -> str:
    """What belongs to one subject, under its name."""
    return f"\n### `{subject}`\n\n{content}"


def stage_table(benchmarks: Path) -> str:
    """Jobs, seconds and memory by stage and variant, in the order of the stages."""
    rows: dict[tuple[str, str], list[FinishedJob]] = {}
    for job in finished_jobs(benchmarks):
        variant = " ".join(word for word in job.words if not word.isdigit())
        if job.stage not in LEFT_OUT:
            rows.setdefault((job.stage, variant), []).append(job)
    if not rows:
        raise InputError(f"{benchmarks}: expected *.tsv of a finished run, found none")
    order = {stage: number for number, stage in enumerate(SECTIONS)}
    whole = pd.DataFrame([job for jobs in rows.values() for job in jobs])
    cells = []
    for (stage, variant), jobs in sorted(rows.items(), key=lambda row: (order.get(row[0][0], len(order)), row[0])):
        name = f"`{stage}`" + (f" {variant}" if variant else "")
        cells.append(stage_row(name, pd.DataFrame(jobs), whole))
    cells.append(stage_row("all", whole, whole))
    return table(("stage", "jobs", "wall, s", "CPU, s", "share of CPU", "peak memory, MB"), cells)


def stage_row(name: str, jobs: pd.DataFrame, whole: pd.DataFrame) -> list[str]:
    """Cells of some jobs; jobs too short for Snakemake to look at have no memory."""
    share = jobs.cpu_s.sum() / whole.cpu_s.sum()
    return [name, f"{len(jobs)}", significant(jobs.wall_s.sum()), significant(jobs.cpu_s.sum()), percent(share),
            f"{jobs.peak_mb.max():,.0f}" if jobs.peak_mb.notna().any() else "–"]  # fmt: skip


def step_words(step: dict) -> str:
    """A step as a whole."""
    return (
        f"A step of {step['cameras_per_step']} images on {step['texels']:,} texels: {milliseconds(step['cpu_s'])} ms "
        f"of CPU time, the mean of {step['steps']}.\n\n"
    )


def parts_table(step: dict) -> str:
    """Parts of a step, largest first."""
    rows = []
    for part in sorted(step["parts"], key=lambda part: -part["forward_s"] - part["backward_s"]):
        ways = (part["forward_s"], part["backward_s"])
        cells = [milliseconds(seconds) if seconds else "–" for seconds in ways]
        rows.append([part["part"], *cells, percent(sum(ways) / step["cpu_s"])])
    return table(("part", "forward, ms", "backward, ms", "share"), rows)


def frame_table(step: dict) -> str:
    """Bytes that one frame holds, by array, largest first."""
    held = step["bytes_of_a_frame"]
    rows = [[f"`{name}`", f"{size:,}", significant(size / step["texels"])]
            for name, size in sorted(held.items(), key=lambda item: -item[1])]  # fmt: skip
    total = sum(held.values())
    rows.append(["all", f"{total:,}", significant(total / step["texels"])])
    return table(("array", "bytes", "bytes per texel"), rows)


def limit_words(found: dict) -> str:
    """What the machine can do."""
    return (
        f"{found['processor']}: {found['operations_per_s'] / 1e9:.0f} billion operations and "
        f"{found['bytes_per_s'] / 1e9:.0f} GB a second.\n\n"
    )


def kernel_table(found: dict) -> str:
    """Kernels beside what bounds them."""
    rows = []
    for kernel in found["kernels"]:
        bounds = {
            "operations": kernel["operations"] / found["operations_per_s"],
            "memory": kernel["bytes"] / found["bytes_per_s"],
        }
        bound = max(bounds, key=lambda name: bounds[name])
        seconds = kernel["cpu_s"]
        rows.append([
            kernel["what"], kernel["size"], milliseconds(seconds), significant(kernel["operations"] / seconds / 1e9),
            significant(kernel["bytes"] / seconds / 1e9), bound, milliseconds(bounds[bound]),
            percent(bounds[bound] / seconds),
        ])  # fmt: skip
    heads = ("kernel", "of", "ms", "billion operations/s", "GB/s", "bound by", "at the bound, ms", "share of the limit")
    return table(heads, rows)


def twin_table(found: dict) -> str:
    """Jobs beside what a library takes alone."""
    rows = []
    for twin in found["twins"]:
        rates = [f"{twin['count'] / seconds / 1e6:.2f}" for seconds in (twin["cpu_s"], twin["bare_cpu_s"])]
        rows.append([
            twin["what"], twin["size"], f"million {twin['unit']}/s", rates[0], f"{rates[1]} ({twin['limit']})",
            percent(twin["bare_cpu_s"] / twin["cpu_s"]),
        ])  # fmt: skip
    return table(("job", "of", "unit", "achieved", "limit", "share of the limit"), rows)


if __name__ == "__main__":
    tyro.cli(run)
