"""Columns of gloss and of transport at texels, for the fits of `appearance_fits`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64

from pipeline.effects.seen_texels import SeenTexels
from pipeline.effects.texel_light import TexelLight, as_float32
from pipeline.lighting.frame_lights import FrameLights
from pipeline.lighting.microfacet import gather_reflections
from pipeline.lighting.point_lights import PointLights

GLOSS_WIDTHS = (0.06, 0.1, 0.16, 0.25, 0.4, 0.63)
"""Widths of GGX that are tried together: a factor 1.6 apart, from nearly a mirror to nearly matte."""

COSINE_KNOTS = np.linspace(-1, 1, 9)
"""Transport under test is piecewise linear in the cosine to the lamp: pieces of a quarter resolve a terminator that
light leaks across."""


def gloss_columns(
    seen: SeenTexels, lights: Sequence[FrameLights], lit: Sequence[TexelLight]
) -> Float64[np.ndarray, "n widths 3"]:
    """Radiance that a dielectric of each of `GLOSS_WIDTHS` reflects to the cameras."""
    out = np.zeros((len(seen.point), len(GLOSS_WIDTHS), 3))
    for f, (lamps, light) in enumerate(zip(lights, lit, strict=True)):
        rows = np.flatnonzero(seen.frame == f)
        point = seen.point[rows]
        bits = np.packbits(light.seen[:, point], axis=1)
        places = as_float32(seen.points[f, point], seen.normals[f, point], seen.to_camera[rows])
        lamps_in_torch = PointLights(*as_float32(lamps.positions, lamps.intensities), bits)
        for k, width in enumerate(GLOSS_WIDTHS):
            alpha = as_float32(np.full(len(rows), width))[0]
            out[rows, k] = gather_reflections(*places, alpha, lamps_in_torch).numpy()
    return out


def transport_columns(seen: SeenTexels, lit: Sequence[TexelLight]) -> Float64[np.ndarray, "n columns 3"]:
    """Light by the cosine that it comes at, piecewise linear, unoccluded and as it arrives."""
    step, parts = COSINE_KNOTS[1] - COSINE_KNOTS[0], []
    for light in lit:
        columns = []
        for knot in COSINE_KNOTS:
            share = (1 - np.abs(light.cosine - knot) / step).clip(0)
            columns.append((share[..., None] * light.arriving).sum(0))
            if knot >= 0:
                columns.append(((share * light.seen)[..., None] * light.arriving).sum(0))
        parts.append(np.stack(columns, 1))
    return np.stack(parts)[seen.frame, seen.point]
