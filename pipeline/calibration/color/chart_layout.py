"""Places of the patches on a colour chart."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64

ROWS, COLUMNS = 4, 6
"""Of the classic chart, the only one that is found without being told where it lies."""

SAME_PLACE = 0.1
"""Distance of two places, over that of two patches, up to which they are one: charts are drawn to a tenth."""

TURNS = {"as it is": (1, 1), "upside down": (-1, -1), "mirrored": (-1, 1), "mirrored and upside down": (1, -1)}
"""Ways in which a chart may be taken: factors of columns and rows."""


@dataclass(frozen=True)
class ChartLayout:
    """Places of a chart's patches.

    Attributes:
        places: column and row of each patch, in distances of two patches, from 0; whole numbers but for charts whose
            blocks stand apart.
    """

    places: Float64[np.ndarray, "patches 2"]

    @classmethod
    def from_index(cls, calibration: Mapping[str, Any]) -> ChartLayout:
        """The layout that calibration_color.json describes; the classic chart's where it says none."""
        places = calibration.get("places")
        return CLASSIC if places is None else cls(np.asarray(places, np.float64))

    @property
    def patches(self) -> int:
        """Number of patches."""
        return len(self.places)

    @property
    def is_classic(self) -> bool:
        """True for 24 patches in four rows, which a detector finds by itself."""
        return self.places.shape == CLASSIC.places.shape and bool((self.places == CLASSIC.places).all())

    @property
    def extent(self) -> tuple[float, float]:
        """Columns and rows from the middle of the first patch to that of the last."""
        return float(self.places[:, 0].max()), float(self.places[:, 1].max())

    @cached_property
    def orders(self) -> list[Int64[np.ndarray, " patches"]]:
        """Patches as the chart counts them, for each of the `TURNS` that its outline allows."""
        middle = np.array(self.extent) / 2
        found = []
        for factors in TURNS.values():
            turned = (self.places - middle) * factors + middle
            apart = np.linalg.norm(turned[:, None] - self.places, axis=-1)
            if (apart.min(1) < SAME_PLACE).all():
                found.append(apart.argmin(1))
        return found


def grid_layout(rows: int, columns: int) -> ChartLayout:
    """Patches counted row by row."""
    row, column = np.divmod(np.arange(rows * columns), columns)
    return ChartLayout(np.stack([column, row], 1).astype(np.float64))


CLASSIC = grid_layout(ROWS, COLUMNS)
"""The 24-patch chart: brown first, black last."""
