"""Compare several subjects in one table: means, standard errors, significance.

Significance says whether an ablation's effect is more than chance.

In: metrics_per_image.parquet of evaluate_avatar, of every subject. Out: comparison.csv, see
`pipeline.metrics.ablation_table.compare`, and comparison/index.html, the same to read.
"""

from __future__ import annotations

import logging
from pathlib import Path

import pandas as pd

from pipeline.base.command import run_as_command
from pipeline.base.errors import InputError
from pipeline.base.files import read_table, write_table
from pipeline.config.compare_subjects import CompareSubjects
from pipeline.metrics.ablation_table import ALL, compare
from pipeline.report.comparison import by_subject, over_subjects, overview
from pipeline.report.part import write_parts

log = logging.getLogger("compare_subjects")


def run(*, scores: tuple[Path, ...], out: Path, settings: CompareSubjects = CompareSubjects()) -> None:
    """Compare avatars over subjects.

    Args:
        scores: metrics_per_image.parquet of each subject.
        out: folder for comparison.csv and comparison/index.html.
    """
    tables = [read_table(path) for path in scores]
    names = [name for table in tables for name in table.subject.unique()]
    if len(set(names)) < len(names) or not names:
        raise InputError(f"--scores: expected one table per subject, found {', '.join(names) or 'none'}")
    everything = pd.concat(tables, ignore_index=True)
    baseline = settings.baseline or everything.variant.iloc[0]
    table = compare(everything, baseline)
    for row in table[(table.subject == ALL) & (table.lit == "all") & table.p_value.notna()].itertuples():
        text = "%s, %s: %+.4g (standard error %.2g) against %s, p = %.3g, corrected %.3g; for new subjects p = %.3g"
        numbers = (row.difference, row.difference_error, baseline, row.p_value, row.p_holm, row.new_p_value)
        log.info(text, row.variant, row.metric, *numbers)
    write_table(out / "comparison.csv", table)
    title, facts = "Comparison of subjects", f"{', '.join(names)}; avatars against {baseline}"
    parts = [overview(table), over_subjects(table), by_subject(table)]
    write_parts(out / "comparison/index.html", title, facts, parts)


def main() -> None:
    """Command line of this stage."""
    run_as_command(run)


if __name__ == "__main__":
    main()
