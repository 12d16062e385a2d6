"""Costs of the stages of a run of the papers' size, with intervals, and what they read and write."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from pipeline.budget.job_costs import CostTerms, looked_at
from pipeline.budget.job_size import JobSize
from pipeline.workflow.job_requests import THREAD_SHARE, memory_mb, useful_threads
from pipeline.workflow.shared_images import SHARES

FITTED = (
    JobSize(8, 24, 24, 19_200, 30_626, 1000, 38_400, 1),
    JobSize(12, 20, 42, 19_456, 46_492, 1000, 38_912, 1, head_texels=46_492),
    JobSize(12, 64, 48, 33_280, 51_206, 2000, 66_560, 1),
    JobSize(8, 24, 24, 307_200, 42_359, 400, 614_400, 1),
    JobSize(8, 24, 96, 19_200, 30_626, 400, 38_400, 1),
    JobSize(8, 24, 24, 19_200, 7_646, 100, 38_400, 1),
    JobSize(12, 20, 16, 10_944, 46_492, 100, 21_888, 1, head_texels=46_492),
    JobSize(5, 8, 6, 5_120, 591, 60, 10_240, 1),
)
"""Sizes of the runs that config/curves/job_costs.csv was fitted to, as `benchmarks.bench_job_costs` names them."""

EXPONENT_ERROR = 0.1
"""Exponent by which a cost may grow otherwise than as its terms, beyond the largest size that was fitted. An
assumption, for no law was measured over such a range. A thousand times larger, it is a factor of 2."""

RAW = (0.3, 1.5, 6.0)
"""Bytes per pixel of a captured image, low, middle and high: AVIF or JPEG; 8-bit PNG; EXR in half floats as it is. The
recorded body's EXRs have 2.5."""

MASK, CROP = 0.035, (0.2, 0.45, 0.65)
"""Bytes per pixel of a mask of the recorded body; share of the image that is cut out and packed: that of the body is
0.45, of subjectA 0.54, of tiny 0.64."""

PACKED = 7.0
"""Bytes per packed pixel: three of float16, one of the mask."""

HELD_OUT = 0.1
"""Share of images that are scored."""


@dataclass(frozen=True)
class Range:
    """A number, and what it may be at least and at most."""

    low: float
    middle: float
    high: float

    def times(self, factor: float) -> Range:
        """All three, multiplied."""
        return Range(self.low * factor, self.middle * factor, self.high * factor)


@dataclass(frozen=True)
class StageCost:
    """Cost of a stage.

    Attributes:
        jobs: number of them.
        threads, mem_mb: that each asks for.
        cpu_s: of each, on one thread.
        wall_s: of each, with its threads.
        read, written: bytes of all jobs.
        beyond: how many times larger the term that decides is than in any run that was fitted.
    """

    jobs: int
    threads: int
    mem_mb: int
    cpu_s: Range
    wall_s: Range
    read: Range
    written: Range
    beyond: float


def beyond_fitted(terms: CostTerms, size: JobSize) -> float:
    """How many times larger the largest term is than in any run that was fitted."""
    names = max(terms.coefficients, key=lambda each: terms.coefficients[each] * size.product(each))
    return max(1.0, size.product(names) / max(run.product(names) for run in FITTED))


def stage_costs(
    size: JobSize, own_sizes: Mapping[str, JobSize], jobs: Mapping[str, int],
    costs: Mapping[tuple[str, str], CostTerms], most_threads: int,
) -> dict[str, StageCost]:  # fmt: skip
    """Costs of the rules of a run.

    Args:
        size: of the capture.
        own_sizes: of a job of each rule.
        jobs: rules and their numbers of jobs.
        costs: of `read_costs`.
        most_threads: of a node.
    """
    found = {}
    for rule, count in jobs.items():
        stage = SHARES.get(rule, rule)
        own = looked_at(stage, own_sizes[rule])
        threads, terms = min(useful_threads(stage, own), most_threads), costs[stage, "seconds"]
        beyond = beyond_fitted(terms, own)
        middle, off = terms.expected(own), terms.worst * beyond**EXPONENT_ERROR
        cpu = Range(middle / off, middle, middle * off)
        read, written = rule_bytes(rule, size, shared=not own.frames)
        wall = cpu.times(1 / (1 + THREAD_SHARE * (threads - 1)))
        found[rule] = StageCost(count, threads, memory_mb(stage, own, threads, 1), cpu, wall, read, written, beyond)
    return found


def rule_bytes(rule: str, size: JobSize, shared: bool = False) -> tuple[Range, Range]:
    """Bytes that all jobs of a rule read and write, of a capture of that size; `shared`: others read the images."""
    images = size.frames * size.cameras
    raw = Range(*(images * size.pixels * (each + MASK) for each in RAW))
    packed = Range(*(images * size.pixels * PACKED * each for each in CROP))
    per_frame = Range(*[size.frames * size.texels * 4.0] * 3)  # two maps of float16
    steps = Range(*(size.steps * size.step_pixels * PACKED * each for each in CROP))
    none, index = Range(0, 0, 0), Range(*[100.0 * images] * 3)
    visits = min(size.steps, size.frames) if size.steps else 0
    frames_read = per_frame.times(max(1.0, visits / max(size.frames, 1)))
    known = {
        "inspect_images": (raw, index),
        "index_capture": (index if shared else raw, index),
        "book_patterns": (raw.times(min(1.0, size.sync_cameras / size.cameras)), none),
        "trace_irradiance": (none, per_frame),
        "pack_shards": (_sum(raw, per_frame), _sum(packed, per_frame)),
        "train_avatar": (_sum(steps, frames_read), none),
        "score_images": (packed.times(HELD_OUT), none),
        "evaluate_avatar": (none if shared else packed.times(HELD_OUT), none),
    }
    return known.get(rule, (none, none))


def _sum(a: Range, b: Range) -> Range:
    return Range(a.low + b.low, a.middle + b.middle, a.high + b.high)


def digits(value: float) -> str:
    """Two significant digits, with thousands apart."""
    if value == 0:
        return "0"
    places = 1 - math.floor(math.log10(abs(value)))
    return f"{round(value, places):,.{max(0, places)}f}"


def words(found: Range, unit: float = 1.0) -> str:
    """`middle (low to high)`, in a unit; a dash where there is nothing to speak of."""
    if found.high / unit < 0.005:
        return "–"
    return f"{digits(found.middle / unit)} ({digits(found.low / unit)} to {digits(found.high / unit)})"
