"""Write the table of docs/effects.md: avatars as planned beside one with every effect on.

python -m docs.generate.effects_table --comparison results/effects_comparison.csv
"""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import tyro

from docs.generate.markdown import percent, put_between, table
from pipeline.base.code_digest import ROOT

TABLE = "effects comparison"
"""Name of the marks around the table in the page."""

HEADS = (
    "scene",
    "effects that the plan turns on",
    "everything on",
    "as planned",
    "its time",
    "the default",
    "its time",
)


def run(*, comparison: Path = Path("results/effects_comparison.csv"), page: Path = ROOT / "docs/effects.md") -> None:
    """Put a row per scene into the page's table, and one of medians.

    Args:
        comparison: what `make effects` wrote.
        page: the page with the table.
    """
    rows = pd.read_csv(comparison).set_index(["scene", "avatar"])
    scenes = list(dict.fromkeys(scene for scene, _ in rows.index))
    lines = [cells(scene, rows.loc[scene]) for scene in scenes]
    middle = rows.groupby("avatar")[["psnr_lost_db", "cpu_ratio"]].median()
    last = ["median", "", ""]
    for avatar in ("full", "auto"):
        last += [f"{0.0 - middle.psnr_lost_db[avatar]:+.2f} dB", percent(middle.cpu_ratio[avatar])]
    put_between(page, TABLE, table(HEADS, [*lines, last]))


def cells(scene: str, rows: pd.DataFrame) -> list[str]:
    """The cells of a scene: what each avatar gains on everything on, and its share of that one's time."""
    planned = rows.effects["full"].split() if isinstance(rows.effects["full"], str) else ["none"]
    shown = [scene, ", ".join(effect.replace("_", " ") for effect in planned), f"{rows.psnr_db['everything']:.2f} dB"]
    for avatar in ("full", "auto"):
        shown += [f"{0.0 - rows.psnr_lost_db[avatar]:+.2f} dB", percent(rows.cpu_ratio[avatar])]
    return shown


if __name__ == "__main__":
    tyro.cli(run)
