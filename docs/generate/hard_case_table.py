"""Write the table of hard cases by area from what `make hard-cases` measured; areas that it has not stay as they are.

python -m docs.generate.hard_case_table --cases results/hard_cases.csv
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
import tyro

from docs.generate.markdown import parted, percent, put_between, table
from pipeline.base.code_digest import ROOT
from pipeline.base.errors import InputError

TABLE = "hard cases"
"""Name of the marks around the table in the page; this module rewrites all between."""

COLUMNS = ("area", "cases", "pass", "with a naive version", "naive versions that fail", "largest share of a bound")

BOUNDED = ("value", "gradient")

NEEDED = ("group", "verdict", "naive_error", *(f"{what}_{kind}" for what in BOUNDED for kind in ("error", "bound")))


@dataclass(frozen=True)
class Area:
    """Counts of an area's cases.

    Attributes:
        cases, passing, naive, failing: all; those that pass; those with a naive version; those whose naive version
            fails, which is a part of passing.
        share: largest error over its bound; NaN if no case has a bound above zero.
    """

    cases: int
    passing: int
    naive: int
    failing: int
    share: float

    def cells(self, name: str) -> list[str]:
        """The row of the table."""
        share = "–" if math.isnan(self.share) else percent(self.share)
        return [name, f"{self.cases}", f"{self.passing}", f"{self.naive}", f"{self.failing}", share]


def run(*, cases: Path = ROOT / "results/hard_cases.csv", page: Path = ROOT / "docs/reliability.md") -> None:
    """Put a row per area into the page's table.

    Args:
        cases: the table that `make hard-cases` wrote, of all areas or of some.
        page: the page with the table.

    Raises:
        InputError: if the table of cases does not exist or lacks columns.
    """
    areas = shown(page) | {str(name): counted(rows) for name, rows in read(cases).groupby("group")}
    rows = [areas[name].cells(name) for name in sorted(areas)]
    put_between(page, TABLE, table(COLUMNS, [*rows, together(list(areas.values())).cells("all")]))


def read(path: Path) -> pd.DataFrame:
    """Rows of hard cases."""
    if not path.is_file():
        raise InputError(f"{path}: expected the table of hard cases, found no file; run `make hard-cases`")
    found = pd.read_csv(path)
    if absent := [name for name in NEEDED if name not in found]:
        raise InputError(f"{path}: expected the column {absent[0]}, found {', '.join(found.columns)}")
    return found


def counted(rows: pd.DataFrame) -> Area:
    """Counts of the cases of one area; a case passes only if its naive version fails."""
    passing, naive = rows.verdict == "PASS", rows.naive_error.notna()
    shares = pd.concat([rows[f"{what}_error"] / rows[f"{what}_bound"] for what in BOUNDED])
    bounds = pd.concat([rows[f"{what}_bound"] for what in BOUNDED])
    return Area(len(rows), int(passing.sum()), int(naive.sum()), int((passing & naive).sum()), shares[bounds > 0].max())


def together(areas: list[Area]) -> Area:
    """Counts of several areas."""
    sums = (sum(getattr(area, name) for area in areas) for name in ("cases", "passing", "naive", "failing"))
    return Area(*sums, max((area.share for area in areas if not math.isnan(area.share)), default=math.nan))


def shown(page: Path) -> dict[str, Area]:
    """Areas that the page's table has, without the sum."""
    lines = [line.strip("| ").split(" | ") for line in parted(page, TABLE)[1].strip().splitlines()[2:]]
    return {
        name: Area(*map(int, counts), math.nan if share == "–" else float(share.removesuffix(" %")) / 100)
        for name, *counts, share in lines
        if name != "all"
    }


if __name__ == "__main__":
    tyro.cli(run)
