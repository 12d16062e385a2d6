"""Compare the estimate of a budget with what the run achieved: time of stages, and errors.

Time is a processor's (`pipeline.base.finished_jobs`), as the budget counts it; wall time stands beside it.
`machine_pace` is the setting with which the total would have been right, machine_pace.STAGE that of a stage. Errors are
those that the run shows: the standard error of drawn irradiance, and the PSNR of partially lit test images, which is
only estimated for the curves' own subjects. What dials lose, each and together, is not shown by one run. Writes a
table, see `COLUMNS`.
"""

from __future__ import annotations

import json
import logging
import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pipeline.base.command import run_as_command
from pipeline.base.errors import InputError
from pipeline.base.files import read_table, write_table
from pipeline.base.finished_jobs import finished_jobs
from pipeline.config.check_budget import CheckBudget

LOST_BY_ALL = "PSNR lost by all dials"
"""Row of what the dials' settings lose together, against the best of each."""

log = logging.getLogger("check_budget")

COLUMNS = ["quantity", "setting", "by", "estimated", "achieved", "unit", "wall_seconds", "verdict"]
"""quantity: a stage, their total, a dial; setting, by: of a dial, and who set it; unit: of a dial, its metric; verdict:
kept, missed, or empty where either side is not known."""


def run(*, results: Path, estimate: str, out: Path, settings: CheckBudget = CheckBudget()) -> None:
    """Compare.

    Args:
        results: the subject's results, with benchmarks and metrics.csv.
        estimate: JSON of `pipeline.budget.estimate.Estimate`.
        out: the table.
        settings: see the flags below.
    """
    expected = read_estimate(estimate)
    seconds = expected["seconds"]
    times = stage_times(results / "benchmarks", list(seconds))
    rows = [row(name, seconds[name], times.cpu[name], "s", wall=times.wall[name]) for name in seconds]
    total = times.sum(skipna=False)
    rows.append(row("total", sum(seconds.values()), total.cpu, "s", wall=total.wall))
    rows.append(row("budget", expected["budget_s"], total.cpu, "s", wall=total.wall))
    paces, unit = expected["paces"], "of what is expected"
    plain = {name: seconds[name] / paces[name] for name in seconds}
    pace, expected_s = sum(seconds.values()) / sum(plain.values()), sum(plain.values())
    rows.append(row("machine_pace", pace, total.cpu / expected_s, unit))
    rows += [row(f"machine_pace.{name}", paces[name], times.cpu[name] / plain[name], unit) for name in plain]
    for choice in expected["choices"]:
        estimated = math.nan if choice["error"] is None else choice["error"]
        achieved = achieved_error(choice, results)
        rows.append(row(choice["dial"], estimated, achieved, choice["metric"], choice["setting"], choice["by"]))
    rows.append(row(LOST_BY_ALL, expected["lost_db"], math.nan, "dB"))
    psnr = math.nan if expected["psnr_db"] is None else expected["psnr_db"]
    rows.append(row("PSNR of partially lit test images", psnr, read_test_psnr(results / "metrics.csv"), "dB"))
    table = pd.DataFrame(rows, columns=COLUMNS)
    table["verdict"] = [verdict(one, settings.tolerance) for one in table.itertuples()]
    for one in table.itertuples():
        log.info(
            "%s: estimated %.4g, achieved %.4g %s %s", one.quantity, one.estimated, one.achieved, one.unit, one.verdict
        )
    write_table(out, table)


def read_estimate(text: str) -> dict[str, Any]:
    """Read the estimate of a budget from JSON.

    Raises:
        InputError: if the text is no estimate.
    """
    try:
        expected = json.loads(text)
        lacking = sorted({"budget_s", "seconds", "choices", "lost_db", "psnr_db", "paces"} - expected.keys())
    except (ValueError, AttributeError) as error:
        raise InputError(f"--estimate: expected JSON of the estimate of a budget, found {text!r}") from error
    if lacking:
        raise InputError(f"--estimate: expected the key {lacking[0]}, found {', '.join(expected) or 'none'}")
    return expected


def stage_times(folder: Path, stages: list[str]) -> pd.DataFrame:
    """Columns cpu and wall, seconds, of all jobs of each stage; NaN for stages that did not run."""
    rows = {stage: [math.nan, math.nan] for stage in stages}
    finished = finished_jobs(folder)
    for stage in stages:
        jobs = [job for job in finished if job.stage == stage]
        if jobs:
            rows[stage] = [sum(job.cpu_s for job in jobs), sum(job.wall_s for job in jobs)]
    return pd.DataFrame.from_dict(rows, orient="index", columns=["cpu", "wall"])


def achieved_error(choice: dict[str, Any], results: Path) -> float:
    """The error of a dial's metric, as far as this run shows it; else NaN."""
    if choice["stage"] != "trace_irradiance":
        return math.nan
    tables = [read_table(path) for path in sorted((results / "irradiance").glob("*.parquet"))]
    errors = np.concatenate([table.error_rms.to_numpy(np.float64) for table in tables]) if tables else np.array([])
    return float(np.sqrt(np.mean(np.square(errors)))) if len(errors) else math.nan


def read_test_psnr(path: Path) -> float:
    """Read the PSNR of the partially lit test images of the first avatar, dB."""
    table = pd.read_csv(path)
    rows = table[(table.split == "test") & (table.lit == "partial")]
    return float(rows.psnr_db.iloc[0]) if len(rows) else math.nan


def row(
    quantity: str, estimated: float, achieved: float, unit: str, setting: str = "", by: str = "", wall: float = math.nan
) -> dict[str, Any]:  # fmt: skip
    """A row of the table without its verdict."""
    return dict(zip(COLUMNS, (quantity, setting, by, estimated, achieved, unit, wall, ""), strict=True))


def verdict(one: Any, tolerance: float) -> str:
    """Verdict: kept, if what was achieved is no more than `tolerance` worse.

    PSNR is better the larger it is.
    """
    if math.isnan(one.estimated) or math.isnan(one.achieved) or one.quantity.startswith("machine_pace"):
        return ""
    if one.quantity.startswith("PSNR"):
        return "kept" if one.achieved >= one.estimated - 10 * math.log10(1 + tolerance) else "missed"
    allowed = one.estimated * (1 if one.quantity == "budget" else 1 + tolerance)
    return "kept" if one.achieved <= allowed else "missed"


def main() -> None:
    """Command line of this stage."""
    run_as_command(run, renamed={"--promise": "--estimate"})


if __name__ == "__main__":
    main()
