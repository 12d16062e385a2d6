"""Hold what settings lose together against what each loses alone, in whole runs.

    cp benchmarks/second_body.yaml config/subjects
    python -m benchmarks.bench_dials_together --subjects subjectA second_body

Curves turn one dial at a time, and a budget turns several. Here the whole workflow runs with the preset `reference`,
then with settings as small budgets choose them, one by one and together. Decibels are of partially lit validation
images, each against the same image of the first run. They are held against two sums of those of each setting alone: of
decibels, and of mean squared errors (`pipeline.budget.total_loss`). Prints a table, and adds it to --out.
"""

from __future__ import annotations

import copy
import json
import shlex
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import pandas as pd
import yaml

from benchmarks.bench_presets import validation_scores
from benchmarks.workflow_runs import keep_run, run_options, run_workflow
from docs.generate.markdown import table
from pipeline.budget.total_loss import total_loss_db

REFERENCE = Path("config/presets/reference.yaml")

NONE = "none"
"""Name of the run with no dial turned."""

QUICK: dict[str, tuple[str, str, Any]] = {
    "texels": ("unwrap_atlas", "texel_pixels", 0.9),
    "supersampling": ("train_avatar", "supersample", 2),
    "steps": ("train_avatar", "steps", 400),
    "outlines": ("track_mesh", "outline_rounds", 1),
}
"""Settings of small budgets: stage, option and value by dial."""

TOGETHER = (("texels", "supersampling"), ("texels", "steps"), ("texels", "supersampling", "steps"), tuple(QUICK))
"""Dials that are turned together; each is turned alone before. What tracks again comes last."""


@dataclass(frozen=True)
class Run:
    """Run of a subject with some dials turned.

    Attributes:
        dials: their names, or `NONE`.
        validation_db: PSNR of partially lit validation images.
        lost_db: that of the reference less this, image by image.
    """

    subject: str
    dials: str
    validation_db: float
    lost_db: float


def run_subject(subject: str, config: list[str]) -> Iterator[Run]:
    """Run a subject with the reference, with each dial turned alone, then with several."""
    results, reference = Path("results", subject), yaml.safe_load(REFERENCE.read_text())
    best: pd.Series | None = None
    for dials in ((), *((dial,) for dial in QUICK), *TOGETHER):
        settings = copy.deepcopy(reference)
        for stage, option, value in (QUICK[dial] for dial in dials):
            settings[stage][option] = value
        words = [f"{stage}={json.dumps(each)}" for stage, each in settings.items()]
        run_workflow(results / "metrics.csv", [*words, *config])
        scores = validation_scores(results)
        best = scores if best is None else best
        yield Run(subject, " ".join(dials) or NONE, float(scores.mean()), float((best - scores).mean()))


def as_markdown(runs: pd.DataFrame) -> str:
    """The table of a page: a line for each run."""
    lines = []
    for subject, own in runs.groupby("subject", sort=False):
        lost = own.set_index("dials").lost_db
        for dials in lost.index.drop(NONE):
            alone = [float(lost[dial]) for dial in dials.split()]
            sums = ["", ""] if len(alone) == 1 else [f"{sum(alone):.2f}", f"{total_loss_db(alone):.2f}"]
            lines.append([f"`{subject}`", dials.replace(" ", ", "), f"{lost[dials]:.2f}", *sums])
    return table(("subject", "turned", "lost, dB", "sum of decibels", "sum of squared errors"), lines)


def main() -> None:
    """Command line."""
    options = run_options(__doc__ or "", Path("results/dials_together.csv")).parse_args()
    for subject in options.subjects:
        for run in run_subject(subject, [f"captures={options.captures}", *shlex.split(options.config)]):
            print(json.dumps(asdict(run)), flush=True)
            keep_run(asdict(run), ["subject", "dials"], options.out)
    print(as_markdown(pd.read_csv(options.out)))


if __name__ == "__main__":
    main()
