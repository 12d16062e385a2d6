"""Strange names of cameras and lights, the same in every file: the same capture if they are names at all."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pandas as pd

from tests.support.chaos.mutations.mutation import Meaning, Mutation, remove, replace

VALID = (
    "NA",
    "nan",
    "null",
    "True",
    "no",
    "007",
    "1e5",
    "0x10",
    "-1",
    "1.0",
    "1_000",
    "inf",
    "None",
    "A.b",
    "con",
    "x" * 60,
)
"""Names that the format allows: letters, digits, _ - and . alone."""

WRONG = ("", " ", "a b", "..", "../x", "a/b", "-rf", "é", "a\tb", "a'b", "$(id)", "{x}", "*", "x" * 300, "写")
"""Names that it does not allow, or that are too long for a file."""


def mutations(cameras: list[str], lights: list[str]) -> Iterator[Mutation]:
    """A camera or a light with another name."""
    for names, meaning in ((VALID, Meaning.SAME), (WRONG, Meaning.BROKEN)):
        for number, name in enumerate(names):
            camera, light = cameras[number % len(cameras)], lights[number % len(lights)]
            shown = name if len(name) < 20 else f"{name[:3]} of {len(name)} letters"
            for column, old in (("camera", camera), ("light", light)):
                apply = partial(_rename, column, old, name)
                yield Mutation("names", f"{column} {old} is called {shown!r}", meaning, apply, (old, name))


def _rename(column: str, old: str, new: str, root: Path) -> None:
    """Rename in tables, paths and capture.yaml, as far as there can be files of that name."""
    for path in root.glob("*.csv"):
        table = pd.read_csv(path, dtype=str, keep_default_na=False)
        if column in table:
            replace(path, table.assign(**{column: table[column].replace(old, new)}).to_csv(index=False))
    keypoints = pd.read_parquet(root / "keypoints_2d.parquet")
    if column in keypoints:
        remove(root / "keypoints_2d.parquet")
        keypoints.assign(**{column: keypoints[column].replace(old, new)}).to_parquet(
            root / "keypoints_2d.parquet", index=False
        )
    text = (root / "capture.yaml").read_text()
    quoted = new.replace("'", "''")
    listed = re.compile(rf"^( *- ){re.escape(old)}$", re.MULTILINE)
    replace(root / "capture.yaml", listed.sub(lambda found: f"{found[1]}'{quoted}'", text))
    if not new or "/" in new or len(new) > 250 or new in (".", ".."):
        return
    for path in sorted(root.glob("**/*"), key=lambda path: -len(path.parts)):
        if (path.stem if path.is_file() else path.name) == old and "truth" not in path.parts:
            path.rename(path.with_name(new + (path.suffix if path.is_file() else "")))
