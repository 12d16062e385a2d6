"""Measurements of the project as a whole, on scenes of its own.

They say how costs scale, and what effects are worth.
"""

from __future__ import annotations

from html import escape
from pathlib import Path

import pandas as pd

from pipeline.base.errors import InputError
from pipeline.report.part import Part
from pipeline.report.results import Results, missing_files, read_csv
from pipeline.report.tables import Html, folded, html_table, number, paragraph, significant

EFFECTS = "effects_comparison.csv"
SCALING, SCALING_FILES = "scaling", ("exponents.csv", "projection.csv", "scaling.png")
"""Below the folder of what belongs to no subject."""

OLD_SCALING, OLD_SCALING_FILES = "growth", ("exponents.csv", "projection.csv", "growth.png")
"""The same as an earlier version wrote it, shown where nothing newer is."""

GRADES = {"as predicted": "good", "cannot tell": "weak", "less than predicted": "weak"}
"""Of verdicts; any other is a failure."""


def cost_scaling(results: Results) -> Part:
    """Exponents against predictions, their picture, and what the papers' captures would take."""
    title, folder, files = "Scaling of cost", results.project / SCALING, SCALING_FILES
    if missing_files(folder, files):
        folder, files = results.project / OLD_SCALING, OLD_SCALING_FILES
    if missing_files(folder, files):
        return Part(title, "", "how time and memory grow with the sizes of a capture", "make scaling")
    table = _read(folder / "exponents.csv", (
        "stage", "varied", "smallest", "largest", "held", "cost", "predicted", "exponent", "low", "high", "verdict",
        "reason",
    ))  # fmt: skip
    projection = _read(folder / "projection.csv", (
        "capture", "stage", "sizes", "beyond", "cpu_hours", "cpu_hours_low", "cpu_hours_high", "peak_gb",
    ))  # fmt: skip
    told = table[table.verdict != "cannot tell"]
    text = (
        f"{len(table)} costs, on one thread. Of {len(told)} exponents that are known well enough, "
        f"{int((told.verdict == 'as predicted').sum())} are as predicted. An exponent is that of the part that grows, "
        "beside a fixed cost; in brackets is its 95 % interval. A miss by less than a tenth of the cost is none."
    )
    caution = (
        "The laws, taken further: hours of one core of the machine they were measured on, without a GPU. Beyond says "
        "how many times the largest measured job that is, all sizes multiplied. Trained is the default avatar, without "
        "the papers' networks."
    )
    picture = results.pictures.figure(folder / files[-1], "Time and memory against size, stage by stage")
    parts = [
        paragraph(text), picture, folded("All exponents", _exponents(table)),
        "<h3>What the papers' captures would take</h3>", paragraph(caution), _projection(projection),
    ]  # fmt: skip
    return Part(title, "".join(parts))


def _exponents(table: pd.DataFrame) -> Html:
    rows = []
    for stage, own in table.groupby("stage", sort=False):
        rows.append([stage])
        for row in own.itertuples():
            held = f", {row.held}" if isinstance(row.held, str) else ""
            size = f"{row.smallest:,.0f} to {row.largest:,.0f} {row.varied}{held}"
            measured = f"{number(row.exponent)} [{number(row.low)}, {number(row.high)}]"
            grade = GRADES.get(row.verdict, "failed")
            verdict = Html(f'<b class="{grade}">{escape(row.verdict)}</b>')
            rows.append([row.cost, size, measured, f"{row.predicted:g}", verdict, row.reason])
    head = ["cost", "sizes", "exponent", "predicted", "verdict", "why predicted"]
    return html_table("exponents of cost", head, rows, "stnnsw")


def _projection(table: pd.DataFrame) -> Html:
    rows = []
    for capture, own in table.groupby("capture", sort=False):
        rows.append([capture])
        for row in own.itertuples():
            hours = (
                f"{significant(row.cpu_hours)} [{significant(row.cpu_hours_low)}, {significant(row.cpu_hours_high)}]"
            )
            rows.append([row.stage, row.sizes, hours, significant(row.peak_gb), significant(row.beyond)])
    head = ["stage", "sizes of a job", "CPU hours in all", "peak of a job [GB]", "beyond"]
    return html_table("projection to the papers' captures", head, rows, "stnnn")


def _hours(value: float) -> str:
    """Whole hours of a long time, with a comma at thousands."""
    return f"{value:,.0f}" if value >= 100 else significant(value)


def effects_comparison(results: Results) -> Part:
    """Savings of a plan and their cost in quality, on scenes that call for other effects."""
    title, path = "Effects, planned against all on", results.project / EFFECTS
    if not path.is_file():
        return Part(title, "", "scenes that call for different effects, planned and with everything on", "make effects")
    table = _read(path, (
        "scene", "avatar", "effects", "shading", "psnr_db", "psnr_lost_db", "cpu_seconds", "cpu_ratio", "parameters",
        "jobs", "steps",
    ))  # fmt: skip
    planned = table[table.avatar.isin(["full", "auto"])]
    text = (
        "Small path-traced scenes, each of which calls for other effects. Everything: the papers' model with every "
        "effect on, whatever the plan says; full: the default settings under the plan; auto: the plan decides learned "
        "transport and deferred shading, too; half: that after half the steps. Lost is against everything on, "
        "on images that no setting was chosen by. "
        f"The largest loss is {number(planned.psnr_lost_db.max())} dB. Jobs are those of the workflow after the plan; "
        f"seconds are of the CPU, for light and {int(table.steps.iloc[0])} steps of training."
    )
    rows = []
    for scene, own in table.groupby("scene", sort=False):
        rows.append([scene])
        for row in own.itertuples():
            jobs = "" if pd.isna(row.jobs) else int(row.jobs)  # of avatars that no plan asks for
            names = ", ".join(row.effects.split()).replace("_", " ") if isinstance(row.effects, str) else "none"
            rows.append([
                row.avatar, number(row.psnr_db), number(row.psnr_lost_db, sign="+"), number(row.cpu_seconds, 1),
                number(row.cpu_ratio), jobs, f"{row.parameters:,}", row.shading, names,
            ])  # fmt: skip
    head = ["avatar", "PSNR [dB]", "lost", "CPU [s]", "of everything", "jobs", "parameters", "shading", "effects on"]
    return Part(title, paragraph(text) + html_table("effects, planned and all on", head, rows, "snnnnnnsw"))


def _read(path: Path, columns: tuple[str, ...]) -> pd.DataFrame:
    """Raises:
    InputError: if the file is no csv table, or lacks a column.
    """
    table = read_csv(path)
    if absent := [name for name in columns if name not in table]:
        raise InputError(f"{path}: expected the column {absent[0]}, found {', '.join(table.columns)}")
    return table
