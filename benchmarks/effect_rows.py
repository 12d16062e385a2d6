"""The table of `benchmarks.bench_effects` as it grows: what is known, and each avatar against everything on."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from benchmarks.effect_scenes import SCENES
from pipeline.base.code_digest import code_digest
from pipeline.base.files import write_table

MEASURED = "benchmarks.bench_effects"
"""Module whose code the numbers are of, with all that it imports."""

REFERENCE = "everything"
"""Avatar that the others are held against."""


class EffectRows:
    """Rows in a file, by draw, scene and avatar.

    Rows of other steps or of other code than `MEASURED` is now are left out.
    """

    def __init__(self, path: Path, steps: int) -> None:
        self._path = path
        self._code = code_digest(MEASURED)
        self._table = pd.DataFrame()
        if path.is_file() and "code" in (table := pd.read_csv(path, dtype={"code": str})):
            self._table = table[(table.code == self._code) & (table.steps == steps)]

    def missing(self, draw: str, scene: str, avatars: Sequence[str]) -> list[str]:
        """Those of the avatars that have no row."""
        if self._table.empty:
            return list(avatars)
        known = self._table[(self._table.draw == draw) & (self._table.scene == scene)]
        return [avatar for avatar in avatars if avatar not in set(known.avatar)]

    def add(self, rows: Sequence[dict]) -> list[dict]:
        """Write rows of a scene to the file, and return them as they stand there.

        Each gets what it loses against everything on, dB, and its share of that one's processor time.
        """
        added = pd.DataFrame([{**row, "code": self._code} for row in rows])
        table = pd.concat([self._table, added], ignore_index=True)
        reference = table[table.avatar == REFERENCE].set_index(["draw", "scene"])
        own = pd.MultiIndex.from_frame(table[["draw", "scene"]])
        table["psnr_lost_db"] = (reference.psnr_db.reindex(own).to_numpy() - table.psnr_db).round(3)
        table["cpu_ratio"] = (table.cpu_seconds / reference.cpu_seconds.reindex(own).to_numpy()).round(3)
        self._table = table.sort_values(["draw", "scene"], key=_places, kind="stable", ignore_index=True)
        write_table(self._path, self._table)
        return [row.dropna().to_dict() for _, row in table[-len(rows) :].iterrows()]


def _places(names: pd.Series) -> pd.Series:
    """Where scenes stand in `SCENES`; draws as they are called."""
    return names.map({scene: number for number, scene in enumerate(SCENES)}) if names.name == "scene" else names
