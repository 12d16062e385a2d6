"""Write the tables of docs/effects.md: avatars as planned beside one with every effect on, and decisions turned round.

python -m docs.generate.effects_table --comparison results/effects_comparison.csv
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import tyro

from docs.generate.markdown import percent, put_between, table
from pipeline.base.code_digest import ROOT

TABLE, TURNED_TABLE = "effects comparison", "effects turned round"
"""Names of the marks around the tables in the page."""

HEADS = (
    "scene",
    "effects that the plan turns on",
    "everything on",
    "as planned",
    "its time",
    "the default",
    "its time",
    "with half the steps",
    "its time",
)

SHOWN = ("full", "auto", "half")
"""Avatars that are held against the one with everything on."""

UNTRAINED = "-"
"""Instead of a gain and a time where an avatar was not trained."""

TURNED = "not_"
"""How names of default avatars with a decision turned round begin."""


def run(
    *, comparison: tuple[Path, ...] = (Path("results/effects_comparison.csv"),), page: Path = ROOT / "docs/effects.md"
) -> None:
    """Put a row per scene into the page's tables, and one of medians into the first.

    Args:
        comparison: what `make effects` wrote, in one file or several.
        page: the page with the tables.
    """
    rows = pd.concat([pd.read_csv(path) for path in comparison])
    gains = {avatar: of_avatar(rows, avatar) for avatar in SHOWN}
    lines = [cells(str(scene), of_scene) for scene, of_scene in rows.groupby("scene", sort=False)]
    last = ["median", "", ""]
    for avatar in SHOWN:
        known = not gains[avatar].empty
        gained, ratio = -gains[avatar].psnr_lost_db.median(), gains[avatar].cpu_ratio.median()
        last += [f"{gained:+.2f} dB", percent(ratio)] if known else [UNTRAINED, UNTRAINED]
    put_between(page, TABLE, table(HEADS, [*lines, last]))
    put_between(page, TURNED_TABLE, turned_table(rows))


def of_avatar(rows: pd.DataFrame, avatar: str) -> pd.DataFrame:
    """Means of an avatar over the draws of each scene."""
    return rows[rows.avatar == avatar].groupby("scene", sort=False)[["psnr_lost_db", "cpu_ratio"]].mean()


def cells(scene: str, rows: pd.DataFrame) -> list[str]:
    """The cells of a scene: what each avatar gains on everything on, and its share of that one's time.

    Means over the draws, and their standard errors where there are several.
    """
    effects = rows.effects[rows.avatar == "full"].iloc[0]
    planned = effects.split() if isinstance(effects, str) else ["none"]
    everything = rows.psnr_db[rows.avatar == "everything"].mean()
    shown = [scene, ", ".join(effect.replace("_", " ") for effect in planned), f"{everything:.2f} dB"]
    for avatar in SHOWN:
        of_avatar = rows[rows.avatar == avatar]
        if of_avatar.empty:
            shown += [UNTRAINED, UNTRAINED]
        else:
            shown += [gain(-of_avatar.psnr_lost_db.to_numpy()), percent(of_avatar.cpu_ratio.mean())]
    return shown


def gain(values: np.ndarray) -> str:
    """Mean in dB with its standard error over draws; `values` of one draw have none."""
    error = f" ± {values.std(ddof=1) / np.sqrt(len(values)):.2f}" if len(values) > 1 else ""
    return f"{values.mean():+.2f}{error} dB"


def turned_gains(rows: pd.DataFrame) -> dict[str, np.ndarray]:
    """What each decision turned round gains on the default, dB: one number per draw in which it was turned."""
    turned = rows[rows.avatar.str.startswith(TURNED)]
    if turned.empty:
        return {}
    default = rows[rows.avatar == "auto"].set_index("draw").psnr_db
    gains = turned.psnr_db - turned.draw.map(default)
    return {str(avatar): of_one.to_numpy() for avatar, of_one in gains.groupby(turned.avatar)}


def turned_table(rows: pd.DataFrame) -> str:
    """A table of scenes by decisions: what the plan says, and what the default gains if told otherwise."""
    names = list(dict.fromkeys(rows.avatar[rows.avatar.str.startswith(TURNED)]))
    lines = []
    for scene, of_scene in rows.groupby("scene", sort=False):
        effects, gains = of_scene.effects[of_scene.avatar == "auto"].iloc[0], turned_gains(of_scene)
        planned = effects.split() if isinstance(effects, str) else []
        cells = [
            f"{'on' if name.removeprefix(TURNED) in planned else 'off'}, turned {gain(gains[name])}"
            if name in gains
            else UNTRAINED
            for name in names
        ]
        lines.append([str(scene), *cells])
    return table(["scene", *(name.removeprefix(TURNED).replace("_", " ") for name in names)], lines)


if __name__ == "__main__":
    tyro.cli(run)
