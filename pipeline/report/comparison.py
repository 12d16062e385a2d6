"""Several subjects' avatars in one table: scores, and differences beyond chance."""

from __future__ import annotations

import math

import pandas as pd

from pipeline.metrics.ablation_table import ALL
from pipeline.report.part import Part
from pipeline.report.scores import LIT_NAMES, METRICS, TESTED, differences
from pipeline.report.tables import Html, folded, html_table, number, paragraph

NEW_SUBJECTS = (
    "The columns behind new subjects ask more: would the difference be there in other people, filmed like these? "
    "Their standard error is that of the subjects' means, and p that of a paired t-test on these, so with few subjects "
    "they find only differences that are large and alike in all, and lean on the means being normally distributed. "
    "The first p says nothing about other people."
)


def overview(table: pd.DataFrame) -> Part:
    """PSNR of every avatar of every subject, side by side."""
    rows = table[(table.metric == "psnr_db") & (table.lit == "all")]
    subjects, variants = list(dict.fromkeys(rows.subject)), list(dict.fromkeys(rows.variant))
    values = rows.set_index(["variant", "subject"])
    cells = []
    for variant in variants:
        own = ((variant, subject) for subject in subjects)
        cells.append([variant, *(_mean(values.loc[key]) if key in values.index else "–" for key in own)])
    head = ["avatar", *("all subjects" if subject == ALL else subject for subject in subjects)]
    name = METRICS["psnr_db"].heading
    text = paragraph(f"{name}, {LIT_NAMES['all']}, mean of all held-out images ± standard error over frames.")
    return Part("Overview", text + html_table("PSNR by subject", head, cells, "s" + "n" * len(subjects)))


def _mean(row: pd.Series) -> str:
    return number(row["mean"]) + (f" ± {number(row.mean_error)}" if math.isfinite(row.mean_error) else "")


def over_subjects(table: pd.DataFrame) -> Part:
    """Means over subjects, and both tests of each ablation."""
    title, rows = "Over all subjects", table[table.subject == ALL]
    if rows.empty:
        return Part(title, "", "there is only one subject; compare_subjects.subjects names more")
    if rows.variant.nunique() == 1:
        return Part(title, differences(rows, subjects=True), "the subjects have only one avatar in common")
    return Part(title, paragraph(TESTED) + paragraph(NEW_SUBJECTS) + differences(rows, subjects=True))


def by_subject(table: pd.DataFrame) -> Part:
    """The same for each subject alone."""
    groups = table[table.subject != ALL].groupby("subject", sort=False)
    return Part("Subject by subject", Html("".join(folded(name, differences(rows)) for name, rows in groups)))
