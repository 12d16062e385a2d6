"""Changes to the table of keypoints."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pandas as pd

from tests.support.chaos.mutations.mutation import Meaning, Mutation, remove

FILE = "keypoints_2d.parquet"
BROKEN, SAME, OTHER = Meaning.BROKEN, Meaning.SAME, Meaning.OTHER

DATE = pd.Timestamp("2026-01-01")

Change = Callable[[pd.DataFrame], pd.DataFrame]


def mutations(rng: random.Random) -> Iterator[Mutation]:
    """Changes to columns, cells and their meaning."""
    columns = ("frame", "camera", "keypoint", "x", "y", "confidence")
    for column in columns:
        yield _table(f"no column {column}", BROKEN, lambda table, column=column: table.drop(columns=column))
        yield _table(f"{column} is text", BROKEN, lambda table, column=column: table.assign(**{column: "a b"}))
        yield _table(f"{column} is null", BROKEN, lambda table, column=column: table.assign(**{column: None}))
        yield _table(f"{column} is a date", BROKEN, lambda table, column=column: table.assign(**{column: DATE}))
    for column in ("x", "y", "confidence"):
        for value in (np.nan, np.inf, -np.inf, 1e300, -1e300):
            row = rng.randrange(100)
            yield _table(f"{column} of a row is {value}", BROKEN, _with_cell(column, row, value))
        for factor in (-1.0, 0.0, 2.0, 5.0, 1e-3):
            meaning = OTHER if column == "confidence" and factor in (2.0, 5.0, 1e-3) else BROKEN
            yield _table(f"{column} times {factor:g}", meaning, _scaled(column, factor))
    yield _table("confidences of 0 and 1", OTHER, lambda table: table.assign(confidence=(table.confidence > 0.5) * 1.0))
    yield _table("x and y exchanged", BROKEN, lambda table: table.rename(columns={"x": "y", "y": "x"}))
    yield _table("pixels of the sensor", BROKEN, lambda table: table.assign(x=5 * table.x, y=5 * table.y))
    yield _table("rows and columns from 0 to 1", BROKEN, lambda table: table.assign(x=table.x / 64, y=table.y / 80))
    yield _table("mirrored images", BROKEN, lambda table: table.assign(x=64 - table.x))
    yield _table("images upside down", BROKEN, lambda table: table.assign(y=80 - table.y))
    yield _table("cameras one further", BROKEN, lambda table: table.assign(camera=_rolled(table.camera)))
    yield _table("keypoints one further", BROKEN, lambda table: table.assign(keypoint=_rolled(table.keypoint)))
    yield _table("frames one further", BROKEN, lambda table: table.assign(frame=_rolled(table.frame)))
    yield _table("all at one place", BROKEN, lambda table: table.assign(x=32.0, y=40.0))
    yield _table("drawn by chance", BROKEN, _by_chance(rng.randrange(1 << 30)))
    yield _table("rows shuffled", SAME, lambda table: table.sample(frac=1, random_state=3))
    yield _table("columns in another order", SAME, lambda table: table[table.columns[::-1]])
    yield _table("an unknown column", OTHER, lambda table: table.assign(remark="seen"))
    yield _table("numbers as float32", OTHER, lambda table: table.astype({"x": "float32", "y": "float32"}))
    yield _table("an index", SAME, lambda table: table.set_index(table.index * 7 + 3), index=True)
    yield _table("no row", BROKEN, lambda table: table[:0])
    yield _table("one row", BROKEN, lambda table: table[:1])
    yield _table("one row twice", BROKEN, lambda table: pd.concat([table, table[:1]]))
    yield _table("one frame is missing", OTHER, lambda table: table[table.frame != table.frame.max()])
    yield _table("one camera alone", BROKEN, lambda table: table[table.camera == table.camera.min()])
    for share in (0.02, 0.2, 0.6):
        yield _table(
            f"{share:.0%} thrown far off", OTHER if share < 0.5 else BROKEN, _thrown(share, rng.randrange(1 << 30))
        )


def _table(what: str, meaning: Meaning, change: Change, index: bool | None = False) -> Mutation:
    def apply(root: Path) -> None:
        table = change(pd.read_parquet(root / FILE))
        remove(root / FILE)
        table.to_parquet(root / FILE, index=index)

    return Mutation(FILE, what, meaning, apply)


def _with_cell(column: str, row: int, value: float) -> Change:
    def change(table: pd.DataFrame) -> pd.DataFrame:
        values = table[column].astype(float).to_numpy(copy=True)
        values[row % len(values)] = value
        return table.assign(**{column: values})

    return change


def _scaled(column: str, factor: float) -> Change:
    return lambda table: table.assign(**{column: table[column] * factor})


def _rolled(column: pd.Series) -> pd.Series:
    """Each value replaced by the next of those that occur."""
    known = sorted(column.unique())
    return column.map(dict(zip(known, [*known[1:], known[0]], strict=True)))


def _by_chance(seed: int) -> Change:
    def change(table: pd.DataFrame) -> pd.DataFrame:
        rng = np.random.default_rng(seed)
        return table.assign(x=rng.uniform(0, 64, len(table)), y=rng.uniform(0, 80, len(table)))

    return change


def _thrown(share: float, seed: int) -> Change:
    def change(table: pd.DataFrame) -> pd.DataFrame:
        rng = np.random.default_rng(seed)
        far = rng.random(len(table)) < share
        return table.assign(x=np.where(far, rng.uniform(0, 64, len(table)), table.x))

    return change
