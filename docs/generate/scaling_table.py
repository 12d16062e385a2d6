"""Write the table of docs/budgets.md that says how cost grows, and take over its picture.

python -m docs.generate.scaling_table --results results/scaling
"""

from __future__ import annotations

import shutil
from pathlib import Path

import pandas as pd
import tyro

from docs.generate.markdown import put_between, table
from pipeline.base.code_digest import ROOT

TABLE = "scaling"
"""Name of the marks around the table in the page."""

HEADS = ("stage", "made larger", "cost", "from", "to", "exponent predicted", "measured, 95 %", "verdict")


def run(*, results: Path = Path("results/scaling"), page: Path = ROOT / "docs/budgets.md") -> None:
    """Put a row per stage, size and cost into the page's table.

    Args:
        results: what `make scaling` wrote.
        page: the page with the table; the picture goes to the folder `pictures` beside it.
    """
    rows = pd.read_csv(results / "exponents.csv")
    put_between(page, TABLE, table(HEADS, (cells(row) for row in rows.itertuples())))
    shutil.copyfile(results / "scaling.png", page.parent / "pictures/scaling.png")


def cells(row: pd.Series) -> list[str]:
    """The cells of a fit; an exponent that nothing tells is empty."""
    measured = "" if pd.isna(row.exponent) else f"{row.exponent:.2f} ({row.low:.2f} to {row.high:.2f})"
    sizes = [f"{size:,.0f}" for size in (row.smallest, row.largest)]
    return [f"`{row.stage}`", row.varied, row.cost, *sizes, f"{row.predicted:g}", measured, row.verdict]


if __name__ == "__main__":
    tyro.cli(run)
