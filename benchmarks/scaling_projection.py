"""What the papers' captures would take, by a sum of terms that is fitted to all runs of a stage.

The terms are those that the predicted exponents speak of: what is done once, per frame, per texel of a frame, per texel
and light ... Each is linear in its sizes; coefficients are not negative and have the least relative error. The range
adds, in squares of logarithms, that error and what the measured intervals of the exponents leave open beyond the
largest size that was measured.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.optimize import nnls

CHUNK = 64
"""Frames of one job, the workflow's default."""


@dataclass(frozen=True)
class Work:
    """A stage's part of a capture: how often which sizes. Sizes are those of `benchmarks.scaling_cases`."""

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


ONCE: tuple[str, ...] = ()
TRACED = {
    "CPU seconds": [ONCE, ("frames",), ("frames", "texels"), ("frames", "texels", "lights")],
    "peak MB": [ONCE, ("texels",), ("frames",)],
}
TRAINED = [ONCE, ("texels",), ("pixels",)]
TERMS = {
    "trace_irradiance, all lights": TRACED,
    "trace_irradiance, 1 sample": TRACED,
    "pack_shards": {"CPU seconds": [ONCE, ("images",), ("images", "pixels")], "peak MB": [ONCE, ("pixels",)]},
    "train_avatar, 2 steps": {"CPU seconds": TRAINED, "peak MB": TRAINED},
    "track_mesh, 5 cameras": {"CPU seconds": [ONCE, ("frames",)], "peak MB": [ONCE, ("frames",)]},
}
"""Stage -> cost -> products of sizes that it is a sum of."""


@dataclass(frozen=True)
class TermFit:
    """Coefficients of the terms, and the root mean square relative error that they leave."""

    terms: Sequence[tuple[str, ...]]
    coefficients: np.ndarray
    relative_error: float

    def cost(self, sizes: Mapping[str, float]) -> float:
        """Of a job, in the unit of the runs."""
        return float(sum(c * product(sizes, term) for c, term in zip(self.coefficients, self.terms, strict=True)))


def product(sizes: Mapping[str, float], term: tuple[str, ...]) -> float:
    """Of the sizes that a term names; 1 for none."""
    return math.prod(sizes[name] for name in term)


def fit_terms(runs: pd.DataFrame, cost: str, terms: Sequence[tuple[str, ...]]) -> TermFit:
    """Fit a cost of all runs of a stage; columns of `runs` are sizes and costs."""
    rows = np.array([[product(sizes, term) for term in terms] for sizes in runs.to_dict("records")], float)
    relative = rows / runs[cost].to_numpy(float)[:, None]
    scale = relative.max(0)  # Sizes differ by powers of ten, which the solver's tolerance does not know of.
    found, left = nnls(relative / scale, np.ones(len(rows)))
    return TermFit(terms, found / scale, float(left / math.sqrt(len(rows))))


def project(runs: pd.DataFrame, exponents: pd.DataFrame) -> pd.DataFrame:
    """A row per capture and stage.

    Args:
        runs, exponents: of `benchmarks.bench_scaling`.

    Returns:
        Columns capture, stage, jobs, sizes, beyond (how many times the largest that was measured, all sizes
        multiplied), cpu_hours of all jobs with low and high, and peak_gb of one with low and high.
    """
    rows = []
    for capture, stages in CAPTURES.items():
        for stage, work in stages.items():
            own, known = runs[runs.stage == stage], exponents[exponents.stage == stage]
            if own.empty:
                continue
            beyond = math.prod(max(1.0, size / own[name].max()) for name, size in work.sizes.items())
            row = {
                "capture": capture, "stage": stage, "jobs": work.jobs,
                "sizes": ", ".join(f"{size:,.0f} {name}" for name, size in work.sizes.items()), "beyond": beyond,
            }  # fmt: skip
            for name, cost, unit in (
                ("cpu_hours", "CPU seconds", work.jobs / 3600),
                ("peak_gb", "peak MB", 1 / 1024),
            ):
                fit = fit_terms(own, cost, TERMS[stage][cost])
                low, high = log_range(own, known[known.cost == cost], work.sizes, fit.relative_error)
                middle = fit.cost(work.sizes) * unit
                ends = {f"{name}_low": middle * math.exp(-low), f"{name}_high": middle * math.exp(high)}
                row |= {name: middle, **ends}
            rows.append(row)
    return pd.DataFrame(rows)


def log_range(
    runs: pd.DataFrame, exponents: pd.DataFrame, sizes: Mapping[str, float], relative_error: float
) -> tuple[float, float]:
    """How far, in logarithms, a projection may be too high and too low."""
    low, high = relative_error**2, relative_error**2
    for row in exponents.itertuples():
        beyond = math.log(max(1.0, sizes[row.varied] / runs[row.varied].max()))
        low += (beyond * min(row.low - row.predicted, 0)) ** 2
        high += (beyond * max(row.high - row.predicted, 0)) ** 2
    return math.sqrt(low), math.sqrt(high)
