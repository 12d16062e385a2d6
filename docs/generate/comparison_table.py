"""Write the table of all subjects' avatars, docs/comparison.md, from a finished comparison.

python -m docs.generate.comparison_table --comparison results/comparison.csv
"""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import tyro

from docs.generate.markdown import put_between, table
from pipeline.base.code_digest import ROOT
from pipeline.metrics.ablation_table import ALL

TABLE = "comparison"
"""Name of the marks around the table in the page."""

COLUMNS = ("subject", "variant", "images", "PSNR, dB", "partially lit", "against {baseline}", "SSIM", "FLIP")


def run(*, comparison: Path = Path("results/comparison.csv"), page: Path = ROOT / "docs/comparison.md") -> None:
    """Put a row per subject and variant into the page's table.

    Args:
        comparison: comparison.csv of compare_subjects.
        page: the page with the table.
    """
    rows = pd.read_csv(comparison)
    rows = rows[rows.subject != ALL].set_index(["subject", "variant", "metric", "lit"])
    avatars = list(dict.fromkeys((subject, variant) for subject, variant, _, _ in rows.index))
    heads = [column.format(baseline=f"`{rows.baseline.iloc[0]}`") for column in COLUMNS]
    put_between(page, TABLE, table(heads, (cells(rows, *avatar) for avatar in avatars)))


def cells(rows: pd.DataFrame, subject: str, variant: str) -> list[str]:
    """The cells of an avatar: means over its test images with standard errors for new frames."""
    lit, partial = (rows.loc[subject, variant, "psnr_db", light] for light in ("all", "partial"))
    shown = [f"`{subject}`", f"`{variant}`", f"{lit.images:.0f}"]
    shown += [f"{each['mean']:.2f} ± {each['mean_error']:.2f}" for each in (lit, partial)]
    own = pd.isna(lit.difference)
    shown += ["" if own else f"{lit.difference:+.2f} ± {lit.difference_error:.2f}"]
    return shown + [f"{rows.loc[subject, variant, metric, 'all']['mean']:.3f}" for metric in ("ssim", "flip")]


if __name__ == "__main__":
    tyro.cli(run)
