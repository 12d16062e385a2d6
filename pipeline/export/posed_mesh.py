"""The posed mesh of tracked frames as glTF: morph targets, animation, and textures.

Every frame but the first is a morph target, and the animation goes from one to the next: vertices in a frame's moment
are those that were tracked, whatever moved them, to float32. Metres, y up. `pipeline.export.skinned_mesh` writes one
that joints move.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pygltflib
from jaxtyping import Float, Int

from pipeline.export.atlas_textures import MaterialTextures, png
from pipeline.export.glb import GlbFile
from pipeline.export.gltf_animation import Track, add_animation, moments_of
from pipeline.geometry.mesh import vertex_normals
from pipeline.geometry.texels import Atlas

SPECULAR = "KHR_materials_specular"


def write_posed_mesh(
    path: Path, atlas: Atlas, textures: MaterialTextures, frames: Mapping[int, Float[np.ndarray, "v 3"]], fps: float
) -> None:
    """Write a .glb.

    Args:
        atlas: NumPy.
        textures: of its material.
        frames: posed vertices by frame number, in order; the first moment of the animation is the first frame's.
        fps: frames of the capture per second.
    """
    file, (vertex, uv, faces) = GlbFile(), unshared_corners(atlas)
    poses = [np.asarray(pose, np.float64) for pose in frames.values()]
    normals = [vertex_normals(pose, atlas.faces, atlas.weld)[vertex] for pose in poses]
    first, first_normals = poses[0][vertex], normals[0]
    primitive = pygltflib.Primitive(
        attributes=pygltflib.Attributes(
            POSITION=file.add_vertices(first, bounded=True), NORMAL=file.add_vertices(first_normals),
            TEXCOORD_0=file.add_vertices(uv),
        ),
        indices=file.add(faces.reshape(-1).astype("<u4"), pygltflib.ELEMENT_ARRAY_BUFFER),
        material=add_material(file, textures),
        targets=[
            {
                "POSITION": file.add_vertices(pose[vertex] - first, bounded=True),
                "NORMAL": file.add_vertices(normal - first_normals),
            }
            for pose, normal in zip(poses[1:], normals[1:], strict=True)
        ],
    )  # fmt: skip
    names = [f"frame {number}" for number in frames]
    mesh = pygltflib.Mesh(name="surface", primitives=[primitive], extras={"targetNames": names[1:]})
    if len(poses) > 1:
        mesh.weights = [0.0] * (len(poses) - 1)
    file.document.meshes.append(mesh)
    node = file.add_node(pygltflib.Node(name="surface", mesh=0))
    if len(poses) > 1:
        weights = np.eye(len(poses))[:, 1:]
        add_animation(file, moments_of(list(frames), fps), [Track(node, "weights", weights)])
    file.write(path)


def unshared_corners(
    atlas: Atlas,
) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, "n 2"], Int[np.ndarray, "f 3"]]:
    """Vertices repeated along the map's seams: vertex and place in the map of each; faces."""
    corners = np.concatenate([atlas.faces.reshape(-1, 1), atlas.uv.reshape(-1, 2)], 1)
    rows, inverse = np.unique(corners.astype(np.float64), axis=0, return_inverse=True)
    return rows[:, 0].astype(np.int64), rows[:, 1:], inverse.reshape(-1, 3).astype(np.int64)


def add_material(file: GlbFile, textures: MaterialTextures) -> int:
    """Append a material without metal; returns its index."""
    names = ("base_color", "metallic_roughness", "normal", "specular")
    base_color, metallic_roughness, normal, specular = (
        file.add_texture(name, png(getattr(textures, name))) for name in names
    )
    material = pygltflib.Material(
        name="skin", alphaMode=pygltflib.OPAQUE,
        pbrMetallicRoughness=pygltflib.PbrMetallicRoughness(
            baseColorTexture=pygltflib.TextureInfo(index=base_color), metallicFactor=0.0, roughnessFactor=1.0,
            metallicRoughnessTexture=pygltflib.TextureInfo(index=metallic_roughness),
        ),
        normalTexture=pygltflib.NormalMaterialTexture(index=normal, scale=1.0),
        extensions={SPECULAR: {"specularFactor": 1.0, "specularTexture": {"index": specular}}},
    )  # fmt: skip
    file.use(SPECULAR)
    file.document.materials.append(material)
    return len(file.document.materials) - 1
