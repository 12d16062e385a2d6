"""Inputs of a rig's bundle adjustment: corners of boards in images, and priors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from pipeline.geometry.cameras import Camera


@dataclass(frozen=True)
class Motion:
    """Motion of corners in their images, one row per observation.

    Attributes:
        velocity, acceleration: pixels per second, and per second squared.
        time_s: when the image was taken, less the mean over the images of its view, seconds.
    """

    velocity: Float64[np.ndarray, "observations 2"]
    acceleration: Float64[np.ndarray, "observations 2"]
    time_s: Float64[np.ndarray, " observations"]

    def select(self, chosen: np.ndarray) -> Motion:
        """The rows that a mask or an index array names."""
        return Motion(self.velocity[chosen], self.acceleration[chosen], self.time_s[chosen])


@dataclass(frozen=True)
class RigPriors:
    """Knowledge of a rig before any board is seen.

    Attributes:
        lenses: a camera of each camera's intrinsics, whose pose does not count; None: nothing is known of them.
        lens_sigma: standard deviation of f over itself, by which goes that of all else
            (`intrinsics_priors.given_prior_sigma`); 0: they are known and stay.
        clock_sigma_s: standard deviation of the times of `Observations.motion`.
    """

    lenses: Sequence[Camera] | None = None
    lens_sigma: float = 0.0
    clock_sigma_s: float = 0.03

    @property
    def fixed(self) -> bool:
        """True if the lenses stay as they are."""
        return self.lenses is not None and self.lens_sigma == 0


@dataclass(frozen=True)
class Observations:
    """Board corners seen by cameras; one row per camera, view and corner. Pixels: first centre at (0.5, 0.5).

    A `view` is one pose of one board: two boards in one shot are two views. `corner` counts through all boards.

    Attributes:
        motion: how the corners move, where the images of a view were not taken at once.
    """

    camera: Int64[np.ndarray, " observations"]
    view: Int64[np.ndarray, " observations"]
    corner: Int64[np.ndarray, " observations"]
    pixel: Float64[np.ndarray, "observations 2"]
    motion: Motion | None = None

    def select(self, chosen: np.ndarray) -> Observations:
        """The rows that a mask or an index array names."""
        motion = None if self.motion is None else self.motion.select(chosen)
        return Observations(self.camera[chosen], self.view[chosen], self.corner[chosen], self.pixel[chosen], motion)


NOTHING_KNOWN = RigPriors()
"""Lenses of which nothing is known, and times as good as those of ordinary cameras."""
