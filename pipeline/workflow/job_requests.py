"""Threads, memory and time that the jobs of a stage ask for, by their size.

A job asks for more than it is expected to take (`pipeline.budget.job_costs`), and for twice as much at each further
attempt. Nothing here knows how much a node has: Snakemake takes at most what `--max-threads` and `--resources
mem_mb=... runtime=...` allow, which a cluster's profile sets.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from pipeline.budget import job_costs
from pipeline.budget.job_costs import CHUNKED, looked_at, read_costs
from pipeline.budget.job_size import JobSize
from pipeline.config.project import SECTIONS
from pipeline.workflow.job_files import JobFiles
from pipeline.workflow.job_size import job_size

MEMORY_MARGIN = 1.25
"""Memory asked for over that of the largest run, for its size, that was fitted: the same run takes more or less by what
the allocator keeps."""

SNAKEMAKE_MB = 400
"""Memory of the two Snakemake processes that a cluster's job runs beside its stage, which count as its own."""

MEMORY_STEP_MB = 100
"""Requests are multiples of this."""

TIME_MARGIN = 2.0
"""Time asked for over that of the slowest run, for its size, that was fitted: a node may be half as fast."""

START_S = 300.0
"""Time until a stage starts to work: Snakemake, imports over a network, and kernels compiled on first use."""

THREAD_SHARE = 0.5
"""Work that a further thread takes over, beside one that works all the time."""

MOST_THREADS = 16
"""Threads beyond which no stage was measured to be faster."""

TEXELS_PER_THREAD = 100_000
"""Texels of an avatar up to which a training process is fastest alone: operations on 50,000 are too short to be split,
see `pipeline.avatar.training.local_processes`."""

PIXELS_PER_THREAD = 64 * 16**2
"""Pixels of an image that keep a thread busy that blends it: 64 tiles of 16 x 16."""

PIECES_PER_THREAD: Mapping[str, tuple[tuple[str, ...], float]] = {
    "synthesize_capture": (("cameras", "frames"), 8),
    "calibrate_cameras": (("cameras",), 4), "calibrate_color": (("cameras",), 4), "calibrate_lights": (("cameras",), 4),
    "review_calibration": (("cameras",), 4), "review_tracking": (("cameras",), 4),
    "trace_irradiance": (("frames",), 4),
    "evaluate_avatar": (("pixels",), PIXELS_PER_THREAD), "relight_avatar": (("pixels",), PIXELS_PER_THREAD),
    "export_viewer": (("pixels",), PIXELS_PER_THREAD), "export_avatar": (("pixels",), PIXELS_PER_THREAD),
    "train_avatar": (("texels",), TEXELS_PER_THREAD),
}  # fmt: skip
"""Stages that split their work: the pieces, as a product of sizes, and how many of them make a thread worth its start.
All others work on one thread."""

LEAST_SPLIT = 2
"""Threads of a stage that splits its work, at least."""

RERUN = {"measure_cost": 100, "budget_errors": 6}
"""Stages that train an avatar again and again, and about how often: settings of all dials with their repeats; inputs
that are true at first, and then ours."""

NOT_MEASURED = {
    "import_capture": {"mb": 2500.0, "seconds": 900.0},
    "detect_landmarks": {"mb": 2500.0, "seconds": 3600.0},
    "segment_subject": {"mb": 2500.0, "seconds": 3600.0},
    "estimate_gaze": {"mb": 1100.0, "seconds": 900.0},
    "export_capture": {"mb": 2500.0, "seconds": 900.0},
    "check_budget": {"mb": 1100.0, "seconds": 60.0},
    "compare_subjects": {"mb": 1100.0, "seconds": 300.0},
}
"""Megabytes and seconds of stages that the fitted runs do not have; the memory is what their rules always asked for."""


@dataclass(frozen=True)
class Request:
    """Threads, megabytes and minutes that a job asks for."""

    threads: int
    mem_mb: int
    minutes: int


def request(stage: str, size: JobSize) -> Request:
    """Request of a job at its first attempt, with all threads that it can use."""
    threads = useful_threads(stage, size)
    return Request(threads, memory_mb(stage, size, threads, 1), minutes(stage, size, threads, 1))


def request_words(files: JobFiles) -> list[str]:
    """Words for a subject's report, what jobs of each stage ask for: STAGE:MEGABYTES:MINUTES."""
    size = job_size(files)
    chunk = job_size(replace(files, chunk=files.chunks[0]))
    sizes = {stage: chunk if stage in CHUNKED else size for stage in SECTIONS}
    asked = {stage: request(stage, each) for stage, each in sizes.items()}
    return [f"{stage}:{each.mem_mb}:{each.minutes}" for stage, each in asked.items()]


def useful_threads(stage: str, size: JobSize) -> int:
    """Threads that make a job faster."""
    if stage == "index_capture":
        return size.decode_threads
    if stage not in PIECES_PER_THREAD:
        return 1
    names, pieces = PIECES_PER_THREAD[stage]
    split = math.ceil(size.product(names) / pieces)
    if stage == "train_avatar":
        return size.processes * min(split, max(1, MOST_THREADS // size.processes))
    return min(max(split, LEAST_SPLIT), MOST_THREADS)


def memory_mb(stage: str, size: JobSize, threads: int, attempt: int) -> int:
    """Megabytes that a job asks for."""
    expected = max(_expected(each, "mb", replace(size, threads=threads)) for each in _parts(stage))
    asked = (MEMORY_MARGIN * expected + SNAKEMAKE_MB) * 2 ** (attempt - 1)
    return MEMORY_STEP_MB * math.ceil(asked / MEMORY_STEP_MB)


def minutes(stage: str, size: JobSize, threads: int, attempt: int) -> int:
    """Minutes that a job asks for, of wall time."""
    expected = RERUN.get(stage, 1) * sum(_expected(each, "seconds", size) for each in _parts(stage))
    speed = 1 + THREAD_SHARE * (threads - 1)
    return math.ceil((START_S + TIME_MARGIN * expected / speed) * 2 ** (attempt - 1) / 60)


def expected_seconds(stage: str, size: JobSize) -> float:
    """Seconds of one processor that a job is expected to take."""
    costs = read_costs(job_costs.TABLE)
    seconds = (
        NOT_MEASURED[part]["seconds"]
        if part in NOT_MEASURED
        else costs[part, "seconds"].expected(looked_at(part, size))
        for part in _parts(stage)
    )
    return RERUN.get(stage, 1) * sum(seconds)


def _parts(stage: str) -> tuple[str, ...]:
    """Stages that a job runs, one after the other."""
    return ("train_avatar", "evaluate_avatar") if stage in RERUN else (stage,)


def _expected(stage: str, cost: str, size: JobSize) -> float:
    if stage in NOT_MEASURED:
        return NOT_MEASURED[stage][cost]
    return read_costs(job_costs.TABLE)[stage, cost].highest(looked_at(stage, size))
