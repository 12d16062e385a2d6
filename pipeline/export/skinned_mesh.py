"""The posed mesh of tracked frames as glTF with a skin.

Joints turn, and morph targets do what joints cannot.

glTF adds morph targets before it skins, as track_mesh adds a frame's offsets: both together are the tracked vertices in
a frame's moment, to float32. The mesh itself is the bind pose. Metres, y up.

Source: Khronos glTF 2.0 specification, sections 3.7.2 (morph targets) and 3.7.3 (skins).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pygltflib

from pipeline.export.atlas_textures import MaterialTextures
from pipeline.export.glb import GlbFile
from pipeline.export.gltf_animation import Track, add_animation, moments_of
from pipeline.export.gltf_skin import add_skin, skin_attributes
from pipeline.export.posed_mesh import add_material, unshared_corners
from pipeline.export.rigged_motion import RiggedMotion
from pipeline.geometry.mesh import vertex_normals
from pipeline.geometry.texels import Atlas


def write_skinned_mesh(path: Path, atlas: Atlas, textures: MaterialTextures, motion: RiggedMotion, fps: float) -> None:
    """Write a .glb.

    Args:
        atlas: NumPy.
        textures: of its material.
        motion: of the frames; the first moment of the animation is the first frame's.
        fps: frames of the capture per second.
    """
    file, (vertex, uv, faces) = GlbFile(), unshared_corners(atlas)
    template = motion.template
    bind = template.scale_to_m * template.vertices_bind
    normals = vertex_normals(bind, atlas.faces, atlas.weld)
    primitive = pygltflib.Primitive(
        attributes=pygltflib.Attributes(
            POSITION=file.add_vertices(bind[vertex], bounded=True), NORMAL=file.add_vertices(normals[vertex]),
            TEXCOORD_0=file.add_vertices(uv), **skin_attributes(file, template, vertex),
        ),
        indices=file.add(faces.reshape(-1).astype("<u4"), pygltflib.ELEMENT_ARRAY_BUFFER),
        material=add_material(file, textures),
    )  # fmt: skip
    mesh = pygltflib.Mesh(name="surface", primitives=[primitive])
    corrected = bool(motion.offsets.any())
    for offsets in motion.offsets if corrected else ():
        changed = vertex_normals(bind + offsets, atlas.faces, atlas.weld) - normals
        target = {
            "POSITION": file.add_vertices(offsets[vertex], bounded=True),
            "NORMAL": file.add_vertices(changed[vertex]),
        }
        primitive.targets.append(target)
    if corrected:
        mesh.extras = {"targetNames": [f"corrections of frame {number}" for number in motion.frames]}
        mesh.weights = [1.0] + [0.0] * (len(motion.frames) - 1)
    file.document.meshes.append(mesh)
    tracks = add_skin(file, motion)
    node = file.add_node(pygltflib.Node(name="surface", mesh=0, skin=0))
    if corrected:
        tracks.append(Track(node, "weights", np.eye(len(motion.frames))))
    if len(motion.frames) > 1:
        add_animation(file, moments_of(motion.frames, fps), tracks)
    file.write(path)
