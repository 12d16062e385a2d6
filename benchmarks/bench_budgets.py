"""Hold what budgets promise against what runs achieve, on subjects that the curves were not measured on.

    cp benchmarks/unseen_*.yaml config/subjects
    python -m benchmarks.bench_budgets --subjects unseen_head --minutes 11 7.5 5
    python -m benchmarks.bench_budgets --subjects unseen_body unseen_far_body --minutes 6 4 2.67 2
    python -m benchmarks.bench_budgets --subjects walker --captures /path/to/captures --minutes 12 7.5 5.6

For each subject the whole workflow runs once with time for everything, then once for each budget; stages that a
budget does not turn are not run again. Seconds are a processor's. Each run says how much longer stages took here than
the costs of jobs expect (`machine_pace`), which the next is promised with. A machine that others use is not as fast in
every run: a fixed piece of work is timed all the while (`benchmarks.machine_speed`), and what a run achieved is also
given at the speed of the one before. Decibels are what the partially lit validation images lose against the first run.
Prints a table, and adds it to --out.
"""

from __future__ import annotations

import json
import math
import shlex
import time
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks.machine_speed import SpeedMeter
from benchmarks.workflow_runs import run_options, run_workflow
from docs.generate.markdown import table
from pipeline.base.files import write_table
from pipeline.budget.run_seconds import ON_THE_WAY
from pipeline.stages.check_budget import LOST_BY_ALL, stage_times

PLENTY_MINUTES = 10_000.0
"""Time for the most accurate settings of all."""


@dataclass(frozen=True)
class Run:
    """Run with a budget: what was promised of it, and what it achieved.

    Attributes:
        minutes: of the budget.
        promised_s, achieved_s: of all stages on the way to metrics.csv.
        promised_lost_db: PSNR against the most accurate settings.
        validation_db: PSNR of partially lit validation images.
        pace: seconds that jobs took over those that the costs expect.
        fresh_s: of `achieved_s`, those of stages that ran this time.
        meanwhile_s: seconds that a fixed piece of work took meanwhile.
    """

    subject: str
    minutes: float
    promised_s: float
    achieved_s: float
    promised_lost_db: float
    validation_db: float
    pace: float
    fresh_s: float
    meanwhile_s: float


def run_budget(subject: str, minutes: float, paces: dict[str, float], config: list[str]) -> Run:
    """Run the workflow with a budget, and read what it says of it."""
    folder = Path("results", subject)
    words = [f"budget_minutes={minutes:g}", f"machine_pace={json.dumps(paces)}", *config]
    begun = time.time()
    with SpeedMeter() as meter:
        run_workflow(folder / "budget.csv", words)
    found = pd.read_csv(folder / "budget.csv").set_index("quantity")
    scores = pd.read_csv(folder / "metrics.csv")
    known = scores[(scores.split == "validation") & (scores.lit == "partial")]
    return Run(
        subject, minutes, float(found.estimated["total"]), float(found.achieved["total"]),
        float(found.estimated[LOST_BY_ALL]), float(known.psnr_db.iloc[0]), float(found.achieved["machine_pace"]),
        seconds_since(begun, folder / "benchmarks"), meter.seconds,
    )  # fmt: skip


def paces_of(folder: Path) -> dict[str, float]:
    """Read the pace of each stage, as it was found in the last run."""
    found = pd.read_csv(folder / "budget.csv").set_index("quantity").achieved
    own = {stage: found.get(f"machine_pace.{stage}", math.nan) for stage in ON_THE_WAY}
    return {stage: round(pace, 3) for stage, pace in own.items() if pace > 0}


def seconds_since(begun: float, folder: Path) -> float:
    """Sum a processor's seconds of the stages on the way to metrics.csv that ran since then."""
    ran = {path.name.partition(".")[0] for path in folder.glob("*.tsv") if path.stat().st_mtime >= begun}
    return float(stage_times(folder, [stage for stage in ON_THE_WAY if stage in ran]).cpu.sum())


def run_subject(subject: str, minutes: list[float], config: list[str], out: Path) -> list[Run]:
    """Run a subject with plenty of time, then with each budget; runs are kept as they are done.

    Args:
        minutes: of budgets, if this machine were as fast as that of the curves.
    """
    runs = [run_budget(subject, PLENTY_MINUTES, {}, config)]
    paces = paces_of(Path("results", subject))
    print(json.dumps(asdict(runs[0])), json.dumps(paces), flush=True)
    for each in minutes:
        runs.append(run_budget(subject, each * runs[0].pace, paces, config))
        paces |= paces_of(Path("results", subject))
        print(json.dumps(asdict(runs[-1])), flush=True)
        keep(runs, out)
    return runs


def keep(runs: list[Run], out: Path) -> None:
    """Write runs among those of other subjects."""
    done = pd.DataFrame([asdict(one) for one in runs])
    if out.exists():
        before = pd.read_csv(out)
        done = pd.concat([before[before.subject != runs[0].subject], done])
    write_table(out, done)


def as_markdown(runs: pd.DataFrame) -> list[str]:
    """The table of a page: a line for each budget whose run had stages to run, and how many hold."""
    lines, ratios, decibels = [], [], []
    for subject, own in runs.groupby("subject", sort=False):
        best = own.iloc[0]
        ran = own[own.fresh_s > 0]  # without fresh stages settings are those of the run before
        for before, row in pairwise(ran.itertuples()):
            promised, achieved = row.promised_lost_db - best.promised_lost_db, best.validation_db - row.validation_db
            ratio, slower = row.achieved_s / row.promised_s, row.meanwhile_s / before.meanwhile_s
            equal = (row.achieved_s - row.fresh_s + row.fresh_s / slower) / row.promised_s
            ratios.append((ratio, equal))
            decibels.append(abs(achieved - promised))
            lines.append([
                f"`{subject}`", f"{row.minutes:.3g}", f"{row.promised_s:.0f}", f"{row.achieved_s:.0f}",
                f"{ratio:.2f}", f"{slower:.2f}", f"{equal:.2f}", f"{promised:.2f}", f"{achieved:.2f}",
            ])  # fmt: skip
    head = (
        "subject", "budget, min", "promised, s", "achieved, s", "ratio", "machine slower by", "ratio at equal speed",
        "promised to lose, dB", "lost, dB",
    )  # fmt: skip
    within, within_equal = np.sum(np.abs(np.log(ratios)) <= math.log(1.15), axis=0)
    said = (
        f"{within} of {len(lines)} within 15 % of the seconds, {within_equal} at equal speed, "
        f"{sum(1 for each in decibels if each <= 0.3)} within 0.3 dB."
    )
    return [*table(head, lines).splitlines(), "", said]


def main() -> None:
    """Command line."""
    parser = run_options(__doc__ or "", Path("results/budgets.csv"))
    parser.add_argument("--minutes", type=float, nargs="+", required=True, help="of each, on the machine of the curves")
    options = parser.parse_args()
    for subject in options.subjects:
        config = [f"captures={options.captures}", *shlex.split(options.config)]
        run_subject(subject, sorted(options.minutes, reverse=True), config, options.out)
    print("\n".join(as_markdown(pd.read_csv(options.out))))


if __name__ == "__main__":
    main()
