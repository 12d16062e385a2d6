"""Rest shape of the procedural head, in metres.

Origin between the ears, y up, facing +z, the subject's left is +x. A smooth union of ellipsoids and round cones from
which mouth, eye sockets and ear shells are carved. The eyeballs are in `pipeline.synthesis.eyeball`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from pipeline.synthesis.implicit_surface import distance_to_solids, even_out, smooth_minimum, surface_nets
from pipeline.synthesis.skeleton import RoundCone

BOX_LOW_M = np.array([-0.11, -0.19, -0.14])
BOX_HIGH_M = np.array([0.11, 0.15, 0.135])
"""A box around the head with a finger's breadth to spare."""

FILLET_M, CARVED_FILLET_M = 0.005, 0.0025
"""Width of the fillet between two solids, and around what is carved."""

MOUTH_CENTER_M = np.array([0.0, -0.0545, 0.082])
"""Middle of the slot between the lips, which stand a little open at rest."""


@dataclass(frozen=True)
class Ellipsoid:
    """Centre and radii along x, y, z in metres."""

    center: tuple[float, float, float]
    radii: tuple[float, float, float]

    def distance(self, points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, " n"]:
        """Signed distance, metres, to first order near the surface.

        It is the implicit function over its gradient's length.
        """
        scaled = (points - self.center) / self.radii
        length = np.linalg.norm(scaled, axis=1)
        slope = np.linalg.norm(scaled / self.radii, axis=1)
        # At the centre both vanish; any negative number is right there.
        return length * (length - 1.0) / np.maximum(slope, 1e-9)


def _mirrored(solids: Sequence[Ellipsoid | RoundCone]) -> list[Ellipsoid | RoundCone]:
    """Each solid of the left side, and its mirror image."""

    def flip(point: tuple[float, float, float]) -> tuple[float, float, float]:
        return -point[0], point[1], point[2]

    right: list[Ellipsoid | RoundCone] = []
    for s in solids:
        if isinstance(s, Ellipsoid):
            right.append(Ellipsoid(flip(s.center), s.radii))
        else:
            right.append(RoundCone(s.joint, flip(s.start), flip(s.end), s.start_radius, s.end_radius))
    return [*solids, *right]


SOLIDS = [
    Ellipsoid((0.0, 0.035, -0.022), (0.075, 0.088, 0.095)),  # cranium
    Ellipsoid((0.0, -0.025, 0.022), (0.061, 0.085, 0.066)),  # face
    Ellipsoid((0.0, -0.062, 0.018), (0.057, 0.044, 0.050)),  # jaw
    Ellipsoid((0.0, -0.094, 0.058), (0.022, 0.018, 0.026)),  # chin
    RoundCone("nose", (0.0, 0.018, 0.086), (0.0, -0.022, 0.106), 0.006, 0.010),
    Ellipsoid((0.0, -0.055, 0.052), (0.036, 0.034, 0.031)),  # around the mouth
    Ellipsoid((0.0, -0.0445, 0.079), (0.023, 0.0060, 0.0100)),  # upper lip
    Ellipsoid((0.0, -0.0645, 0.078), (0.020, 0.0068, 0.0100)),  # lower lip
    RoundCone("neck", (0.0, -0.060, -0.022), (0.0, -0.115, -0.030), 0.050, 0.052),
    *_mirrored(
        [
            Ellipsoid((0.012, -0.026, 0.092), (0.008, 0.008, 0.010)),  # wing of the nose
            RoundCone("brow", (0.015, 0.031, 0.079), (0.045, 0.028, 0.064), 0.007, 0.006),
            Ellipsoid((0.040, -0.018, 0.058), (0.022, 0.017, 0.020)),  # cheekbone
            Ellipsoid((0.075, 0.000, -0.012), (0.011, 0.031, 0.019)),  # ear
        ]
    ),
]

CARVED = [
    Ellipsoid((0.0, -0.0545, 0.080), (0.021, 0.0042, 0.024)),  # between the lips
    *_mirrored(
        [
            Ellipsoid((0.032, 0.010, 0.084), (0.0155, 0.0078, 0.021)),  # between the lids
            Ellipsoid((0.086, 0.003, -0.006), (0.0065, 0.017, 0.010)),  # ear shell
        ]
    ),
]


def _distances(points: np.ndarray, solids: Sequence[Ellipsoid | RoundCone]) -> np.ndarray:
    return np.stack(
        [s.distance(points) if isinstance(s, Ellipsoid) else distance_to_solids(points, [s])[:, 0] for s in solids],
        axis=1,
    )


def head_field(points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, " n"]:
    """Distance-like field of the head without its eyeballs, negative inside."""
    whole = smooth_minimum(_distances(points, SOLIDS), FILLET_M)
    outside_carved = _distances(points, CARVED)
    # The smooth maximum of the head and of being outside of everything carved.
    return -smooth_minimum(np.concatenate([-whole[:, None], outside_carved], axis=1), CARVED_FILLET_M)


def head_mesh(spacing_m: float) -> tuple[Float64[np.ndarray, "v 3"], Int64[np.ndarray, "f 3"]]:
    """The head's closed surface without eyeballs, edges of about `spacing_m`."""
    vertices, faces = surface_nets(head_field, BOX_LOW_M, BOX_HIGH_M, spacing_m)
    return even_out(vertices, faces, head_field), faces
