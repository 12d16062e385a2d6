"""Write the table of docs/papers_rows.md that says what the papers' own choices cost, and gain.

python -m docs.generate.papers_dials --costs results/subjectC/accuracy_cost.csv
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import tyro

from docs.generate.markdown import put_between, table
from pipeline.base.code_digest import ROOT
from pipeline.dials.papers import PAPERS_DIALS
from pipeline.metrics.cost import IMPORTS_ONLY

TABLE = "papers' dials"
"""Name of the marks around the table in the page."""

HEADS = ("subject", "dial", "value", "loses, dB", "CPU s", "ratio", "a picture, ms")

LOST, PICTURE = "PSNR lost on validation images, partial", "time of a picture"
"""How names of metrics begin."""


def run(*, costs: tuple[Path, ...], page: Path = ROOT / "docs/papers_rows.md") -> None:
    """Put a row per subject, dial and value into the page's table.

    Args:
        costs: tables that `measure_cost` wrote, each in a folder of the subject's name.
        page: the page with the table.
    """
    lines = []
    for path in costs:
        rows = pd.read_csv(path, dtype={"setting": str})
        rows = rows[rows.setting != IMPORTS_ONLY]
        for dial in (dial.name for dial in PAPERS_DIALS):
            lines += of_dial(path.resolve().parent.name, dial, rows[rows.dial == dial])
    put_between(page, TABLE, table(HEADS, lines))


def of_dial(subject: str, dial: str, rows: pd.DataFrame) -> list[list[str]]:
    """The lines of a dial; the value that others are compared with, which is measured last, comes first."""
    lines: list[list[str]] = []
    values = rows.setting.unique()[::-1]
    for setting in values:
        own, reference = (rows[rows.setting == one] for one in (setting, values[0]))
        seconds, of_reference = (of_value.cpu_seconds.iloc[0] for of_value in (own, reference))
        compared = with_error(own, LOST) if lines else ""
        picture = own.error[own.metric.str.startswith(PICTURE)].mean()
        lines.append([
            f"`{subject}`", f"`{dial}`", f"`{setting}`", compared, f"{seconds:.0f}", f"{seconds / of_reference:.2f}",
            f"{picture:.0f}",
        ])  # fmt: skip
    return lines


def with_error(rows: pd.DataFrame, metric: str) -> str:
    """The mean of a metric, and its standard error where it is known; nothing for a value that was refused."""
    row = rows[rows.metric.str.startswith(metric)].iloc[0]
    if np.isnan(row.error):
        return "-"
    return f"{row.error:z.2f}" + (f" ± {row.standard_error:.2f}" if np.isfinite(row.standard_error) else "")


if __name__ == "__main__":
    tyro.cli(run)
