"""Shadow rays as Embree takes them, and the points they start from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float64, Int

RAYS_AT_ONCE = 16384
"""Rays aimed at in one go where points are few: a thousand times the cost of a call."""


@dataclass(frozen=True)
class Receivers:
    """Points of a mesh that light falls on, and the outward unit normals of their faces.

    The normals are geometric, not smoothed (see `pipeline.lighting.visibility.ORIGIN_OFFSET`).
    """

    points: Float64[np.ndarray, "n 3"]
    normals: Float64[np.ndarray, "n 3"]

    def __len__(self) -> int:
        return len(self.points)


@dataclass(frozen=True)
class Rays:
    """Rays in Embree's scaled scene, float32; `rows` has the receiver and the light of each."""

    rows: Int[np.ndarray, "r 2"]
    origins: Float[np.ndarray, "r 3"]
    directions: Float[np.ndarray, "r 3"]
    lengths: Float[np.ndarray, " r"]

    @staticmethod
    def room_for(count: int) -> Rays:
        """Arrays for that many rays."""
        ways = np.empty((2, count, 3), np.float32)
        return Rays(np.empty((count, 2), np.int32), ways[0], ways[1], np.empty(count, np.float32))

    def arrays(self) -> tuple[np.ndarray, ...]:
        """All of them, to be written by a kernel."""
        return self.rows, self.origins, self.directions, self.lengths

    def first(self, count: int) -> Rays:
        """The first of them."""
        return Rays(*(array[:count] for array in self.arrays()))


def light_blocks(points: int, lights: int) -> list[range]:
    """Lights in groups that make enough rays to be worth a call, and fit into memory."""
    size = max(1, RAYS_AT_ONCE // max(points, 1))
    return [range(start, min(start + size, lights)) for start in range(0, lights, size)]
