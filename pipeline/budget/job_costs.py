"""Expected cost of a job, by its size.

It is a sum of terms, each a product of sizes, with coefficients of `config/curves/job_costs.csv`:
`benchmarks/bench_job_costs.py` fits them to finished runs, and says there which.
"""

from __future__ import annotations

import csv
import functools
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from pipeline.base.errors import InputError
from pipeline.budget.job_size import JobSize

TABLE = Path("config/curves/job_costs.csv")
"""Rows: a term of a stage's cost, seconds of a processor or mb of memory."""

CHUNKED = ("track_mesh", "trace_irradiance", "bake_textures", "pack_shards")
"""Stages with a job for each chunk of frames."""

LOOKED_AT = {"book_patterns": "sync_cameras", "track_mesh": "tracking_cameras"}
"""Stages that look at the images of some cameras, and how many: more cameras cost them no more."""


@dataclass(frozen=True)
class CostTerms:
    """Cost as a sum of products of sizes.

    Attributes:
        coefficients: of each product, by the names of its sizes, which are attributes of `JobSize`.
        worst: largest cost of a run that was fitted over the sum of its terms.
    """

    coefficients: Mapping[tuple[str, ...], float]
    worst: float = 1.0

    @property
    def fixed(self) -> float:
        """Cost of a job of no size: starting it, and importing its code."""
        return self.coefficients.get((), 0.0)

    def before_steps(self, size: JobSize) -> float:
        """Cost of a job before its first step.

        It is that of a job of no size, where nothing grows with steps.
        """
        if any("steps" in names for names in self.coefficients):
            return self.expected(replace(size, steps=0))
        return self.fixed

    def expected(self, size: JobSize) -> float:
        """Cost of a job, in seconds or megabytes."""
        return sum(factor * size.product(names) for names, factor in self.coefficients.items())

    def highest(self, size: JobSize) -> float:
        """Cost of a job that exceeds its terms as the worst run did."""
        return self.worst * self.expected(size)


def looked_at(stage: str, size: JobSize) -> JobSize:
    """Size of a job with as many cameras as the stage looks at."""
    if stage not in LOOKED_AT:
        return size
    return replace(size, cameras=min(size.cameras, getattr(size, LOOKED_AT[stage])))


@functools.cache
def read_costs(path: Path) -> dict[tuple[str, str], CostTerms]:
    """Terms of each stage and cost, seconds or mb.

    Raises:
        InputError: if the file is not the table that bench_job_costs writes.
    """
    found: dict[tuple[str, str], dict[tuple[str, ...], float]] = {}
    worst: dict[tuple[str, str], float] = {}
    try:
        with open(path, newline="", encoding="utf-8") as file:
            for row in csv.DictReader(file):
                key = row["stage"], row["cost"]
                found.setdefault(key, {})[tuple(row["sizes"].split())] = float(row["coefficient"])
                worst[key] = float(row["worst"])
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{path}: expected columns stage, cost, sizes, coefficient and worst, found: {error!r}; "
            "restore the file, or write it with `python -m benchmarks.bench_job_costs`"
        ) from error
    return {key: CostTerms(terms, worst[key]) for key, terms in found.items()}
