"""Write the error budgets of docs/comparison.md from finished ones, and take over their pictures.

python -m docs.generate.error_budget_table --results results/subjectA results/subjectB results/subjectC
"""

from __future__ import annotations

import shutil
from pathlib import Path

import pandas as pd
import tyro

from docs.generate.markdown import put_between, table
from pipeline.base.code_digest import ROOT

TABLE = "error budgets"
"""Name of the marks around the table in the page."""


def run(*, results: tuple[Path, ...], page: Path = ROOT / "docs/comparison.md") -> None:
    """Put a row per subject into the page's table, and its waterfall below.

    Args:
        results: folders results/SUBJECT with an error_budget, of the same steps.
        page: the page with the table; pictures go to the folder `pictures` beside it.
    """
    budgets = {folder.name: pd.read_csv(folder / "error_budget/error_budget.csv") for folder in results}
    steps = next(iter(budgets.values())).step.tolist()
    text = table(["subject", *steps, "lost"], (cells(name, budget) for name, budget in budgets.items()))
    for folder in results:
        picture = f"pictures/error_budget_{folder.name}.png"
        shutil.copyfile(folder / "error_budget/error_budget.png", page.parent / picture)
        text += f"\n![{folder.name}: what each input costs]({picture})\n"
    put_between(page, TABLE, text)


def cells(name: str, budget: pd.DataFrame) -> list[str]:
    """The cells of a subject: decibels of test images after each step, of partially lit ones in brackets."""
    shown = [
        f"{whole:.2f} ({partial:.2f})"
        for whole, partial in zip(budget.test_all_db, budget.test_partial_db, strict=True)
    ]
    return [f"`{name}`", *shown, f"{budget.test_all_db.iloc[0] - budget.test_all_db.iloc[-1]:.2f}"]


if __name__ == "__main__":
    tyro.cli(run)
