"""Textures of a glTF material from an avatar's atlas: albedo, normal, roughness, gloss."""

from __future__ import annotations

import io
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, UInt8
from PIL import Image
from scipy.ndimage import distance_transform_edt

from pipeline.avatar.matter import Matter
from pipeline.base.color import srgb_from_linear
from pipeline.geometry.texels import Atlas


@dataclass(frozen=True)
class MaterialTextures:
    """Textures of glTF's metallic-roughness material.

    Attributes:
        base_color: albedo, sRGB.
        metallic_roughness: roughness in green; no metal. GGX's width is its square.
        normal: tangent space: right, up and out as 0 to 255.
        specular: KHR_materials_specular: the scale of the gloss in alpha, at most 1.
    """

    base_color: UInt8[np.ndarray, "size size 3"]
    metallic_roughness: UInt8[np.ndarray, "size size 3"]
    normal: UInt8[np.ndarray, "size size 3"]
    specular: UInt8[np.ndarray, "size size 4"]


def material_textures(
    atlas: Atlas, matter: Matter, tangent_frames: Float[np.ndarray, "t 3 3"], normals: Float[np.ndarray, "t 3"]
) -> MaterialTextures:
    """Textures of a material.

    Args:
        atlas: NumPy.
        matter: of the avatar.
        tangent_frames: of a posed mesh, as `texel_frames` has them.
        normals: for shading, of the same pose.
    """
    roughness = np.sqrt(matter.width.clip(0, 1))
    nothing, full = np.zeros_like(roughness), np.ones_like(roughness)
    return MaterialTextures(
        picture(atlas, srgb_from_linear(matter.albedo.clip(0, 1))),
        picture(atlas, np.stack([full, roughness, nothing], 1)),
        picture(atlas, 0.5 + 0.5 * tangent_normals(atlas, tangent_frames, normals)),
        picture(atlas, np.stack([full, full, full, matter.gloss.clip(0, 1)], 1)),
    )


def tangent_normals(
    atlas: Atlas, tangent_frames: Float[np.ndarray, "t 3 3"], normals: Float[np.ndarray, "t 3"]
) -> Float[np.ndarray, "t 3"]:
    """Normals in glTF's tangent space: along u, up in the picture, out of the surface.

    Where the picture lies mirrored on the surface, up is the other way than n x t, as in MikkTSpace, by which readers
    find the tangents.
    """
    local = (tangent_frames.swapaxes(1, 2) @ normals[:, :, None])[..., 0]
    local[:, 1] *= np.where(mirrored(atlas), -1.0, 1.0)[atlas.face]
    return local / np.linalg.norm(local, axis=1, keepdims=True)


def mirrored(atlas: Atlas) -> Bool[np.ndarray, " f"]:
    """Faces whose picture is seen from behind.

    v points down: the others run clockwise in (u, v).
    """
    edges = np.asarray(atlas.uv[:, 1:] - atlas.uv[:, :1], np.float64)
    return np.linalg.det(edges) > 0


def picture(atlas: Atlas, values: Float[np.ndarray, "t channels"]) -> UInt8[np.ndarray, "size size channels"]:
    """Values in [0, 1] as bytes on the map.

    Texels that belong to nothing have those of the nearest, so that no seam shows.
    """
    known = atlas.to_map(np.ones(len(values), bool))
    row, column = distance_transform_edt(~known, return_distances=False, return_indices=True)
    full = np.moveaxis(atlas.to_map(values.T), 0, -1)[row, column]
    return np.round(255 * full.clip(0, 1)).astype(np.uint8)


def png(texels: UInt8[np.ndarray, "size size channels"]) -> bytes:
    """A .png of them."""
    stored = io.BytesIO()
    Image.fromarray(texels).save(stored, "PNG")
    return stored.getvalue()
