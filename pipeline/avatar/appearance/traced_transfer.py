"""Precomputed radiance transfer of the template at rest (Sloan et al. 2002).

Where a learned transfer may start.

A stage lights a subject in a few dozen patterns, a texel's transfer has 113 coefficients. What the mesh hides at rest
needs no pictures: it is traced, so that only the rest is left to learn.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.avatar.appearance.transfer import UNTURNED_SCALE
from pipeline.geometry.mesh import area_vectors, unit_or
from pipeline.geometry.texels import Atlas, texel_frames
from pipeline.lighting.environment_sh import COEFFICIENTS, even_directions, spherical_harmonics
from pipeline.lighting.visibility import Occluders
from pipeline.lighting.visibility_bits import trace_bits

DIRECTIONS = 1024
"""Each stands for 4 pi / 1024 sr, a cap of 3.6 degrees: degree 8, the highest, has waves of 360 / 8 = 45 degrees."""

AT_ONCE = 64
"""Directions whose visibility is held in memory."""


def hidden_harmonics(atlas: Atlas) -> Float[Tensor, "texels 81"]:
    """Part of each texel's Lambertian transfer that the template at rest hides from it.

    In the template's frame.

    (4 pi / N) sum over hidden directions of max(0, n . w) / pi Y_lm(w), times `UNTURNED_SCALE` as all such
    coefficients. Zero where nothing hides anything: the open part of the lobe is known in closed form, and is not
    sampled.
    """
    vertices = atlas.rest_vertices.astype(np.float64)
    points, frames = texel_frames(atlas, vertices)
    normals = unit_or(area_vectors(vertices, atlas.faces), 0.0)[atlas.face]
    occluders, hidden = Occluders(vertices, atlas.faces), torch.zeros(len(points), COEFFICIENTS)
    for directions in np.split(even_directions(DIRECTIONS), DIRECTIONS // AT_ONCE):
        bits = trace_bits(occluders, points, normals, directions, distant=True)
        seen = np.stack([bits.seen(light) for light in range(AT_ONCE)])
        # Below the flat face but above the smooth normal's horizon is no shadow: the terminator stays smooth.
        blocked = ~seen & (directions @ normals.T > 0)
        weights = torch.as_tensor(blocked * (directions @ frames[..., 2].T).clip(0), dtype=torch.float32)
        hidden += weights.T @ spherical_harmonics(torch.as_tensor(directions)).float()
    return UNTURNED_SCALE * 4 / DIRECTIONS * hidden
