"""What the papers' captures would take, by the laws that were measured.

A job's cost is the law of its first size, times, for each other size, how much that one's law grows from where it was
held. Exponents are the predicted ones where the measured interval holds them, else the measured ones. The range is that
of the intervals, whose logarithms are added in squares.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import pandas as pd

from pipeline.metrics.growth import Growth, law_with_exponent

CHUNK = 64
"""Frames of one job, the workflow's default."""


@dataclass(frozen=True)
class Work:
    """A stage's part of a capture: how often which sizes. Sizes are those of `benchmarks.growth_cases`."""

    jobs: float
    sizes: Mapping[str, float]


def works(
    cameras: int, lights: int, frames: int, width: int, height: int, steps: int, images_per_step: int
) -> dict[str, Work]:
    """Stage -> what a capture asks of it, with 1024 x 1024 texels, all lights lit, and images that are all subject."""
    texels, chunks = 1024**2, frames / CHUNK
    traced = {"texels": texels, "lights": lights, "frames": CHUNK}
    return {
        "trace_irradiance, all lights": Work(chunks, traced),
        "trace_irradiance, 1 sample": Work(chunks, traced),
        "pack_shards": Work(chunks, {"images": CHUNK * cameras, "pixels": width * height}),
        "train_avatar, 2 steps": Work(steps / 2, {"texels": texels, "pixels": images_per_step * width * height}),
        "track_mesh, 5 cameras": Work(chunks, {"frames": CHUNK}),
    }


CAPTURES = {
    # RFGCA 4: images of 5328 x 4608 pixels are reduced to a quarter; 300,000 steps of 4 images.
    "RFGCA": works(512, 1024, 5500, 1332, 1152, 300_000, 4),
    # RGCA 3: 4096 x 2668 pixels; reduced alike, as the paper does not say; 200,000 steps of 16 images.
    "RGCA": works(110, 460, 144_000, 1024, 667, 200_000, 16),
}


def project(runs: pd.DataFrame, exponents: pd.DataFrame) -> pd.DataFrame:
    """A row per capture and stage.

    Args:
        runs, exponents: of `benchmarks.bench_growth`.

    Returns:
        Columns capture, stage, jobs, sizes, beyond (how many times the largest that was measured, all sizes
        multiplied), cpu_hours of all jobs with low and high, and peak_gb of one with low and high.
    """
    rows = []
    for capture, stages in CAPTURES.items():
        for stage, work in stages.items():
            own = runs[runs.stage == stage]
            if own.empty:
                continue
            hours = [seconds * work.jobs / 3600 for seconds in _range(own, exponents, "CPU seconds", work.sizes)]
            peaks = [mb / 1024 for mb in _range(own, exponents, "peak MB", work.sizes)]
            beyond = math.prod(max(1.0, size / own[name].max()) for name, size in work.sizes.items())
            rows.append({
                "capture": capture, "stage": stage, "jobs": work.jobs,
                "sizes": ", ".join(f"{size:g} {name}" for name, size in work.sizes.items()), "beyond": beyond,
                "cpu_hours": hours[0], "cpu_hours_low": hours[1], "cpu_hours_high": hours[2],
                "peak_gb": peaks[0], "peak_gb_low": peaks[1], "peak_gb_high": peaks[2],
            })  # fmt: skip
    return pd.DataFrame(rows)


def _range(own: pd.DataFrame, exponents: pd.DataFrame, cost: str, sizes: Mapping[str, float]) -> list[float]:
    """What one job costs, and the ends of its range."""
    rows = exponents[(exponents.stage == own.stage.iloc[0]) & (exponents.cost == cost)].set_index("varied")
    logs, squares = 0.0, [0.0, 0.0]
    for position, (varied, row) in enumerate(rows.iterrows()):
        runs = own[own.varied == varied]
        first_held = own[own.varied == rows.index[0]][varied].iloc[0] if position else None
        inside = row.low <= row.predicted <= row.high
        grown = [
            _grown(law_with_exponent(runs[varied], runs[cost], max(k, 0.0)), sizes[varied], first_held)
            for k in (row.predicted if inside else row.exponent, row.low, row.high)
        ]
        logs += grown[0]
        squares = [total + (end - grown[0]) ** 2 for total, end in zip(squares, grown[1:], strict=True)]
    low, high = (math.sqrt(total) for total in squares)
    return [math.exp(logs), math.exp(logs - low), math.exp(logs + high)]


def _grown(law: Growth, size: float, held: float | None) -> float:
    """Logarithm of the cost at a size, or of how much more that is than where it was held."""
    return math.log(law.cost(size)) - (math.log(law.cost(held)) if held else 0.0)
