"""Lit lights of a frame, and the points that they shine on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from pipeline.lighting.light_sampling import Sampling
from pipeline.lighting.ray_kernels import share_of_arriving
from pipeline.lighting.shadow_rays import Receivers
from pipeline.lighting.visibility import Occluders

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
"""Luminance of linear RGB with Rec. 709 primaries (ITU-R BT.709, item 3.2)."""

MIN_DISTANCE = 1e-6
"""Least distance to a light, relative to the mesh's half extent: a light on the surface is finite, and outshines all
others there all the same."""


@dataclass(frozen=True)
class Lights:
    """The lit lights of a frame.

    Attributes:
        places: positions, in the unit of the mesh; or, if `distant`, unit directions towards them.
        luminances: of their radiant intensities; of distant lights, the irradiance on a surface that faces them.
        distant: as far away as the sky.
    """

    places: Float64[np.ndarray, "m 3"]
    luminances: Float64[np.ndarray, " m"]
    distant: bool = False

    def lit(self) -> Lights:
        """The lights that shine: one at zero is off, and costs nothing."""
        on = self.luminances > 0
        return Lights(self.places[on], self.luminances[on], self.distant)


@dataclass(frozen=True)
class Scene:
    """Lit lights, the brightest of luminance 1, and the points they shine on.

    Attributes:
        normals: of the smooth surface, for the cosine.
        least2: bound of squared distances to lights from below.
    """

    occluders: Occluders
    receivers: Receivers
    normals: Float64[np.ndarray, "t 3"]
    lights: Float64[np.ndarray, "m 3"]
    luminances: Float64[np.ndarray, " m"]
    distant: bool
    least2: float

    def shares(
        self, arrived: Float64[np.ndarray, " t"], cosine_arrived: Float64[np.ndarray, " t"]
    ) -> tuple[Float64[np.ndarray, " t"], Float64[np.ndarray, " t"]]:
        """Sums over what is seen, divided by those over all lights."""
        axes, arrived, cosine_arrived = np.ascontiguousarray(self.lights.T), arrived.copy(), cosine_arrived.copy()
        share_of_arriving(
            self.receivers.points, self.normals, axes, self.luminances, self.distant, self.least2, arrived,
            cosine_arrived,
        )  # fmt: skip
        return arrived, cosine_arrived

    def chances(self, sampling: Sampling) -> Float64[np.ndarray, " m"]:
        """Probability of each light to be drawn, as far as it is the same for all points."""
        weights = np.ones_like(self.luminances) if sampling == "uniform" else self.luminances
        return weights / weights.sum()

    def per_arriving(self) -> tuple[Float64[np.ndarray, " t"], Float64[np.ndarray, " t"]]:
        """One over the sums of L_j, and of L_j max(0, n . w_j), over all lights."""
        return self.shares(*np.ones((2, len(self.receivers))))


def light_scene(
    occluders: Occluders, points: np.ndarray, face_normals: np.ndarray, lights: Lights, normals: np.ndarray | None
) -> Scene | None:
    """Points and lights as the sums need them, or None if no light is lit."""
    lit = lights.lit()
    if not len(lit.luminances):
        return None
    face_normals = np.ascontiguousarray(face_normals, np.float64)
    normals = face_normals if normals is None else np.ascontiguousarray(normals, np.float64)
    # Only ratios of lights matter, and these fit into float32.
    return Scene(
        occluders, Receivers(np.ascontiguousarray(points, np.float64), face_normals), normals,
        np.ascontiguousarray(lit.places, np.float64), lit.luminances / lit.luminances.max(), lit.distant,
        (MIN_DISTANCE * occluders.half_extent) ** 2,
    )  # fmt: skip
