"""Hold the presets that curves chose against the defaults: whole runs, on several subjects.

    python -m benchmarks.bench_presets --subjects subjectA subjectB subjectC

A preset turns several dials together, each of which was measured by itself. Here the whole workflow runs with a
subject's own settings, then with each preset; stages that a preset does not turn are not run again. Seconds are a
processor's, of all stages on the way to metrics.csv. Decibels are of partially lit validation images, each against the
same image of the first run, with the standard error over frames where there are several. Let the machine do nothing
else meanwhile. Prints a table, and adds it to --out; the results are left as the last preset made them.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks.workflow_runs import keep_run, run_options, run_workflow
from docs.generate.markdown import table
from pipeline.base.files import read_table
from pipeline.budget.presets import RULES
from pipeline.budget.run_seconds import ON_THE_WAY
from pipeline.metrics.evaluation import LIT, capped
from pipeline.metrics.significance import mean_over_images
from pipeline.stages.check_budget import stage_times

OWN = "own settings"
"""The run that presets are held against."""


@dataclass(frozen=True)
class Run:
    """Run of a subject.

    Attributes:
        preset: `OWN`, or a name of a file in config/presets.
        seconds: of all stages on the way to metrics.csv.
        validation_db: PSNR of partially lit validation images.
        gained_db, error_db: that over the run with its own settings, and its standard error; NaN of one frame alone.
    """

    subject: str
    preset: str
    seconds: float
    validation_db: float
    gained_db: float
    error_db: float


def run_subject(subject: str, config: list[str], presets: Sequence[str] = tuple(RULES)) -> Iterator[Run]:
    """Run a subject with its own settings, then with each preset."""
    results, own = Path("results", subject), None
    for preset in (OWN, *presets):
        run_workflow(results / "metrics.csv", config, [] if preset == OWN else [f"config/presets/{preset}.yaml"])
        scores = validation_scores(results)
        own = scores if own is None else own
        gained = mean_over_images((scores - own).to_numpy(np.float64), own.index.get_level_values("frame").to_numpy())
        seconds = float(stage_times(results / "benchmarks", list(ON_THE_WAY)).cpu.sum())
        yield Run(subject, preset, seconds, float(scores.mean()), gained.mean, gained.error)


def validation_scores(results: Path) -> pd.Series:
    """PSNR of a run's partially lit validation images, by camera and frame."""
    scores = read_table(results / "metrics_per_image.parquet")
    known = capped(scores[scores.validation & LIT["partial"](scores)])
    return known.set_index(["camera", "frame"]).psnr_db.sort_index()


def as_markdown(runs: pd.DataFrame) -> str:
    """The table of a page: a line for each run."""
    first = runs[runs.preset == OWN].set_index("subject").seconds
    lines = [
        [
            f"`{row.subject}`", f"`{row.preset}`" if row.preset != OWN else OWN, f"{row.seconds:.0f}",
            f"{row.seconds / first[row.subject]:.2f}", f"{row.validation_db:.2f}",
            "" if row.preset == OWN else signed(row.gained_db, row.error_db),
        ]
        for row in runs.itertuples()
    ]  # fmt: skip
    return table(("subject", "preset", "CPU s", "of its own settings'", "validation, dB", "gained, dB"), lines)


def signed(mean: float, error: float) -> str:
    """A gain with its standard error, where that is known."""
    return f"{mean:+.2f}" + ("" if np.isnan(error) else f" ± {error:.2f}")


def main() -> None:
    """Command line."""
    parser = run_options(__doc__ or "", Path("results/presets.csv"))
    parser.add_argument("--presets", nargs="+", choices=RULES, default=list(RULES))
    options = parser.parse_args()
    for subject in options.subjects:
        config = [f"captures={options.captures}", *shlex.split(options.config)]
        for run in run_subject(subject, config, options.presets):
            print(json.dumps(asdict(run)), flush=True)
            keep_run(asdict(run), ["subject", "preset"], options.out)
    print(as_markdown(pd.read_csv(options.out)))


if __name__ == "__main__":
    main()
