"""Columns of gloss and of subsurface light at texels, for the fits of `appearance_fits`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np
from jaxtyping import Float64, Int64

from pipeline.effects.seen_texels import SeenTexels
from pipeline.effects.texel_light import TexelLight, as_float32
from pipeline.lighting.frame_lights import FrameLights
from pipeline.lighting.microfacet import gather_reflections
from pipeline.lighting.point_lights import PointLights
from pipeline.lighting.subsurface import SurfaceSamples, gaussian_spread

GLOSS_WIDTHS = (0.06, 0.1, 0.16, 0.25, 0.4, 0.63)
"""Widths of GGX that are tried together: a factor 1.6 apart, from nearly a mirror to nearly matte."""


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


def subsurface_columns(
    seen: SeenTexels, lit: Sequence[TexelLight], rest: SurfaceSamples, parts: Sequence[Int64[np.ndarray, " _"]]
) -> Float64[np.ndarray, "n spreads 3"]:
    """Irradiance of the looked-at texels as it spreads below the surface, within each part.

    Args:
        rest: all texels at rest; those that were looked at stand for the others.
        parts: of what was looked at.
    """
    looked, count = rest.at(seen.texels), len(rest.deviations)
    looked = replace(looked, areas=looked.areas * len(rest.areas) / len(seen.texels))
    columns = np.zeros((len(lit), len(seen.texels), count, 3))
    for part, (number, deviation) in product(parts, enumerate(rest.deviations)):
        kernel, means = gaussian_spread(looked.at(part), float(deviation))
        for frame, light in enumerate(lit):
            columns[frame, part, number] = kernel @ (means @ light.direct[part])
    return columns[seen.frame, seen.point]
