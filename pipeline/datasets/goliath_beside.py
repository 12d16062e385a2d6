"""A file beside Goliath's layout, for what that has no place for.

The set's own programs do not read it. This project's exports write it, so that they come back as the same capture.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from pipeline.base.errors import InputError, listed
from pipeline.base.files import read_json, write_json
from pipeline.datasets.light_durations import light_name

BESIDE = "lightstage.json"
"""The file, in the capture's folder."""


@dataclass(frozen=True)
class GoliathBeside:
    """Frames per second, cameras that test, and the names of the lights in their order."""

    fps: float
    test_cameras: tuple[str, ...]
    lights: tuple[str, ...]

    def named(self, table: pd.DataFrame) -> pd.DataFrame:
        """A table whose column `light` has these names in place of numbers."""
        names = {light_name(number): name for number, name in enumerate(self.lights)}
        return table.assign(light=table.light.map(names).astype("str"))


def write_beside(root: Path, beside: GoliathBeside) -> None:
    """Write the file."""
    content = {"fps": beside.fps, "test_cameras": list(beside.test_cameras), "lights": list(beside.lights)}
    write_json(root / BESIDE, content)


def read_beside(root: Path, cameras: Collection[str], lights: int) -> GoliathBeside | None:
    """The file's content; None where there is none, as of the set itself.

    Raises:
        InputError: if it is of another capture.
    """
    path = root / BESIDE
    if not path.is_file():
        return None
    content: Any = read_json(path)
    try:
        found = GoliathBeside(float(content["fps"]), tuple(content["test_cameras"]), tuple(content["lights"]))
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: expected fps, test_cameras and lights, found {content!r:.80}; delete it") from error
    if len(set(found.lights)) != lights or not found.fps > 0:
        expected = f"{lights} names of lights and a positive fps"
        raise InputError(f"{path}: expected {expected}, found {len(set(found.lights))} and {found.fps:g}; delete it")
    if unknown := sorted(set(found.test_cameras) - set(cameras)):
        raise InputError(
            f"{path}: test_cameras: expected some of {listed(cameras)}, found {listed(unknown)}; delete it"
        )
    return found
