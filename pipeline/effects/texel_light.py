"""Light on some texels of a frame: of each lamp, of all together, and by way of one bounce."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float64, Int64, UInt8

from pipeline.geometry.mesh import area_vectors, unit_or
from pipeline.geometry.texels import Atlas, texel_frames
from pipeline.lighting.bounces import trace_bounces
from pipeline.lighting.frame_lights import FrameLights
from pipeline.lighting.visibility import Occluders
from pipeline.lighting.visibility_bits import trace_bits


@dataclass(frozen=True)
class TexelLight:
    """Light on P texels from M lamps.

    Attributes:
        arriving: I / d^2, linear RGB, seen or not.
        cosine: between the normal and the way to the lamp.
        seen: which lamps each texel sees.
        bits: the same, packed as np.packbits does.
        hits: of rays spread by the cosine, the atlas texel each hits; T, one past the last, for none.
    """

    arriving: Float64[np.ndarray, "M P 3"]
    cosine: Float64[np.ndarray, "M P"]
    seen: Bool[np.ndarray, "M P"]
    bits: UInt8[np.ndarray, "M bytes"]
    hits: Int64[np.ndarray, "P rays"]

    @property
    def direct(self) -> Float64[np.ndarray, "P 3"]:
        """Irradiance straight from the lamps, their shadows included."""
        return ((self.seen * self.cosine.clip(0))[..., None] * self.arriving).sum(0)


def light_texels(
    atlas: Atlas, vertices: np.ndarray, texels: Int64[np.ndarray, " P"], normals: Float64[np.ndarray, "P 3"],
    lights: FrameLights, rays: int,
) -> TexelLight:  # fmt: skip
    """The light on texels of a posed mesh; `rays`: per texel for the bounce, 0 for none."""
    mesh = vertices.astype(np.float64)
    points, frames = (array.astype(np.float64) for array in texel_frames(atlas, mesh))
    face_normals, occluders = unit_or(area_vectors(mesh, atlas.faces), 0.0), Occluders(mesh, atlas.faces)
    offset = lights.positions[:, None] - points[texels]
    squared = np.maximum((offset**2).sum(-1), np.finfo(np.float32).tiny)
    traced = trace_bits(occluders, points[texels], face_normals[atlas.face[texels]], lights.positions)
    seen = np.unpackbits(traced.bits, axis=1, count=len(texels)).astype(bool)
    hits = np.zeros((len(texels), 0), np.int64)
    if rays:
        hits = trace_bounces(atlas, occluders, points, frames, face_normals, rays)[texels].astype(np.int64)
    return TexelLight(
        lights.intensities[:, None] / squared[..., None], (offset * normals).sum(-1) / np.sqrt(squared), seen,
        traced.bits, hits,
    )  # fmt: skip


def as_float32(*arrays: np.ndarray) -> list[torch.Tensor]:
    """Tensors for the kernels of shading."""
    return [torch.tensor(array, dtype=torch.float32) for array in arrays]
