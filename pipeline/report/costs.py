"""Costs: accuracy against time, and what each input costs.

Also the hard cases, and each stage's time and memory.
"""

from __future__ import annotations

import math
from html import escape

import pandas as pd

from pipeline.base.errors import InputError
from pipeline.base.finished_jobs import finished_jobs
from pipeline.config.project import SECTIONS
from pipeline.metrics.cost import IMPORTS_ONLY
from pipeline.report.part import Part
from pipeline.report.requests import Asked
from pipeline.report.results import Results, missing_files, read_csv
from pipeline.report.tables import Html, folded, html_table, number, paragraph, significant


def accuracy_cost(results: Results) -> Part:
    """The curves, and the cheapest setting within tolerance of each dial."""
    title = "Accuracy against time"
    missing = missing_files(results.folder, ["accuracy_cost.csv", "accuracy_cost.png"])
    if missing:
        return Part(title, "", "what each accuracy dial costs", results.make("accuracy_cost.csv"))
    table = results.csv("accuracy_cost.csv")
    chosen = table[table.chosen.astype(bool)]
    picture = results.pictures.figure(results.folder / "accuracy_cost.png", "Error against seconds, dial by dial")
    text = paragraph("The cheapest setting within tolerance, by dial and metric:")
    rest = table[table.setting != IMPORTS_ONLY]
    return Part(title, picture + text + _dials(chosen, "chosen") + folded("All settings", _dials(rest, "all")))


def _dials(table: pd.DataFrame, name: str) -> Html:
    rows = [
        [
            row.dial, row.setting, row.metric, significant(row.error), significant(row.allowed),
            f"{number(row.seconds)} ± {number(row.seconds_spread / 2)}", number(row.peak_mb, 0),
            f"{significant(row.work)} {row.unit}",
        ]
        for row in table.itertuples()
    ]  # fmt: skip
    head = ["dial", "setting", "metric", "error", "allowed", "seconds", "peak [MB]", "work"]
    return html_table(f"{name} settings", head, rows, "sstnnnns")


def error_budget(results: Results) -> Part:
    """Decibels that each input costs, of captures whose truth is known."""
    title, files = "What each input costs", ["error_budget/error_budget.csv", "error_budget/error_budget.png"]
    if missing_files(results.folder, files):
        what = "decibels that each input costs, for a capture whose truth is known"
        return Part(title, "", what, results.make("error_budget"))
    table = results.csv(files[0])
    picture = results.pictures.figure(results.folder / files[1], "PSNR with true inputs, and with ours in their place")
    scores = ["validation_db", "test_all_db", "test_full_db", "test_partial_db"]
    rows = [[row["step"], *(number(row[name]) for name in scores)] for row in table.to_dict("records")]
    head = ["step", "validation [dB]", "test [dB]", "fully lit [dB]", "partially lit [dB]"]
    return Part(title, picture + html_table("error budget", head, rows, "snnnn"))


HARD_CASE_COLUMNS = (
    "case", "group", "value_error", "value_bound", "gradient_error", "gradient_bound", "verdict", "naive_error",
)  # fmt: skip


def hard_cases(results: Results) -> Part:
    """Table of numerical hard cases: errors, their bounds, and what a naive version does."""
    title = "Hard cases"
    if not results.hard_cases.is_file():
        return Part(title, "", "the table of numerical hard cases", "make hard-cases")
    table = read_csv(results.hard_cases)
    if absent := [name for name in HARD_CASE_COLUMNS if name not in table]:
        raise InputError(f"{results.hard_cases}: expected the column {absent[0]}, found {', '.join(table.columns)}")
    amiss = table[table.verdict != "PASS"]
    naive = int(table.naive_error.notna().sum())
    text = (
        f"{len(table)} cases, {len(table) - len(amiss)} pass, {len(amiss)} do not. For {naive} of them a plausible "
        "naive version was run as well; its error stands beside. The bound is in brackets."
    )
    shown = _cases(amiss) if len(amiss) else ""
    return Part(title, paragraph(text) + shown + folded("All cases", _cases(table)))


def _cases(table: pd.DataFrame) -> Html:
    rows = []
    for group, cases in table.groupby("group", sort=False):
        rows.append([group])
        for case in cases.itertuples():
            unit = getattr(case, "unit", "")
            value = _bounded(case.value_error, case.value_bound, unit if isinstance(unit, str) else "")
            gradient = _bounded(case.gradient_error, case.gradient_bound)
            grade = "good" if case.verdict == "PASS" else "failed"
            verdict = Html(f'<b class="{grade}">{escape(str(case.verdict))}</b>')
            rows.append([case.case, value, gradient, _error(case.naive_error), verdict])
    return html_table("hard cases", ["case", "value", "gradient", "naive", "verdict"], rows, "wnnns")


def _bounded(error: float, bound: float, unit: str = "") -> str:
    return f"{_error(error)} ({significant(bound)}) {unit}".strip() if pd.notna(error) else ""


def _error(error: float) -> str:
    return "" if pd.isna(error) else significant(error) if math.isfinite(error) else "not finite"


def stages(results: Results) -> Part:
    """Time and memory of each stage, of the last run of each of its jobs."""
    title = "Time and memory"
    table = benchmarks(results)
    if table.empty:
        return Part(title, "", "benchmarks: Snakemake writes them when it runs a stage", results.make("metrics.csv"))
    longest, total = table.seconds.max(), table.seconds.sum()
    rows = [
        [
            row.stage, row.jobs, number(row.seconds, 1), Html(row.seconds / longest if longest else 0),
            number(row.cpu_seconds, 1), number(row.peak_mb, 0), *_asked(results.requests.get(row.stage)),
        ]
        for row in table.itertuples()
    ]  # fmt: skip
    text = (
        f"{number(total / 60, 1)} minutes of stages in all, one after the other; the largest took "
        f"{number(table.peak_mb.max(), 0)} MB. Memory is the largest resident set that was sampled. "
        "Asked for is what one job may take at most on a cluster, at its first attempt: with the memory of Snakemake, "
        "and with the time until a stage starts to work."
    )
    head = ["stage", "jobs", "wall [s]", "", "CPU [s]", "peak [MB]", "asked [MB]", "asked [min]"]
    return Part(title, paragraph(text) + html_table("time and memory of stages", head, rows, "snnbnnnn"))


def _asked(request: Asked | None) -> list[str]:
    return ["", ""] if request is None else [number(request.mem_mb, 0), number(request.minutes, 0)]


def benchmarks(results: Results) -> pd.DataFrame:
    """Columns stage, jobs, seconds and cpu_seconds (sums), peak_mb (largest), in data order."""
    rows = [[job.stage, job.wall_s, job.cpu_s, job.peak_mb] for job in finished_jobs(results.folder / "benchmarks")]
    jobs = pd.DataFrame(rows, columns=["stage", "seconds", "cpu_seconds", "peak_mb"])
    table = jobs.groupby("stage", as_index=False).agg({"seconds": "sum", "cpu_seconds": "sum", "peak_mb": "max"})
    table["jobs"] = table.stage.map(jobs.stage.value_counts())
    order = {stage: position for position, stage in enumerate(SECTIONS)}
    return table.sort_values("stage", key=lambda names: names.map(order), kind="stable", ignore_index=True)
