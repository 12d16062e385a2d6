"""The animated mesh and its textures: what independent readers find is the tracked surface and its matter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pygltflib
import pytest
import trimesh

from pipeline.avatar.matter import Matter
from pipeline.base.color import srgb_from_linear
from pipeline.export.atlas_textures import material_textures
from pipeline.export.posed_mesh import write_posed_mesh
from pipeline.geometry.atlas import rasterize_faces, tangent_weights
from pipeline.geometry.texels import texel_frames
from tests.support.avatars.sheet import make_sheet

FPS, FRAMES, SIZE = 12.0, (7, 8, 10), 12


def sheet(mirrored):
    """A sheet of two triangles that fill the map; mirrored: u runs the other way."""
    atlas = make_sheet(SIZE)
    if not mirrored:
        return atlas
    uv = np.stack([1 - atlas.uv[..., 0], atlas.uv[..., 1]], -1)
    table = rasterize_faces(uv, SIZE)
    return replace(
        atlas, uv=uv, texel=table.texel.astype(np.int32), face=table.face.astype(np.int32),
        barycentric=table.barycentric.astype(np.float32),
        tangent_weights=tangent_weights(uv)[table.face].astype(np.float32),
    )  # fmt: skip


@pytest.fixture(scope="module", params=[False, True], ids=["plain", "mirrored"])
def made(request, tmp_path_factory):
    """The file, and what it was written from: random poses, matter and normals."""
    atlas, rng = sheet(request.param), np.random.default_rng(6)
    count, vertices = atlas.texel_count, np.asarray(atlas.rest_vertices, np.float64)
    matter = Matter(rng.random((count, 3)), rng.uniform(0.05, 0.9, count), rng.random(count))
    poses = {number: vertices + (k > 0) * rng.normal(0, 0.05, vertices.shape) for k, number in enumerate(FRAMES)}
    axes = texel_frames(atlas, poses[FRAMES[0]])[1]
    normals = axes[:, :, 2] + 0.3 * rng.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    path = tmp_path_factory.mktemp("mesh") / "mesh.glb"
    write_posed_mesh(path, atlas, material_textures(atlas, matter, axes, normals), poses, FPS)
    return path, atlas, matter, poses, normals


def test_trimesh_finds_the_first_frame_and_its_textures(made):
    path, atlas, matter, poses, _ = made
    (mesh,) = trimesh.load(path, process=False).geometry.values()
    first = poses[FRAMES[0]]
    np.testing.assert_allclose(mesh.triangles, first[atlas.faces], atol=1e-7)
    np.testing.assert_allclose(mesh.vertex_normals, [[0, 0, 1]] * len(mesh.vertices), atol=1e-6)
    # trimesh counts v upwards.
    np.testing.assert_allclose(mesh.visual.uv[mesh.faces] * [1, -1] + [0, 1], atlas.uv, atol=1e-6)
    material, (row, column) = mesh.visual.material, atlas.texel.T
    albedo = np.asarray(material.baseColorTexture)[row, column] / 255
    np.testing.assert_allclose(albedo, srgb_from_linear(matter.albedo), atol=0.5 / 255 + 1e-6)
    roughness = np.asarray(material.metallicRoughnessTexture)[row, column] / 255
    np.testing.assert_allclose(roughness[:, 1] ** 2, matter.width, atol=0.005)
    assert material.metallicFactor == 0


def test_normal_map_turns_back_into_the_normals(made):
    """By the tangents that glTF asks readers to find where there are none: along u, and up in the picture."""
    path, atlas, _, poses, normals = made
    (mesh,) = trimesh.load(path, process=False).geometry.values()
    row, column = atlas.texel.T
    local = np.asarray(mesh.visual.material.normalTexture)[row, column] / 127.5 - 1
    corners = poses[FRAMES[0]][atlas.faces]
    # Edges are P_u du + P_v dv: of a flat face, solved for both directions.
    uv_edges, edges = atlas.uv[:, 1:] - atlas.uv[:, :1], corners[:, 1:] - corners[:, :1]
    along = np.linalg.solve(uv_edges.astype(np.float64), edges)
    along /= np.linalg.norm(along, axis=2, keepdims=True)
    right, up, out = along[:, 0], -along[:, 1], np.array([0.0, 0, 1])
    found = local[:, :1] * right[atlas.face] + local[:, 1:2] * up[atlas.face] + local[:, 2:] * out
    np.testing.assert_allclose(found, normals, atol=0.012)


def test_animation_goes_through_all_frames(made):
    path, atlas, _, poses, _ = made
    document = pygltflib.GLTF2().load(str(path))
    blob = document.binary_blob()

    def column(index):
        accessor = document.accessors[index]
        view = document.bufferViews[accessor.bufferView]
        return np.frombuffer(blob, "<f4", view.byteLength // 4, view.byteOffset).reshape(accessor.count, -1)

    (primitive,), (animation,) = document.meshes[0].primitives, document.animations
    (sampler,), (channel,) = animation.samplers, animation.channels
    assert (channel.target.path, document.nodes[channel.target.node].mesh) == ("weights", 0)
    moments, weights = column(sampler.input)[:, 0], column(sampler.output).reshape(len(FRAMES), -1)
    np.testing.assert_allclose(moments, (np.array(FRAMES) - FRAMES[0]) / FPS, rtol=1e-6)
    assert document.meshes[0].extras["targetNames"] == ["frame 8", "frame 10"]
    indices = document.accessors[primitive.indices]
    view = document.bufferViews[indices.bufferView]
    faces = np.frombuffer(blob, "<u4", indices.count, view.byteOffset).reshape(-1, 3)
    targets = np.stack([column(target["POSITION"]) for target in primitive.targets])
    turns = np.stack([column(target["NORMAL"]) for target in primitive.targets])
    for row, pose in zip(weights, poses.values(), strict=True):
        shown = column(primitive.attributes.POSITION) + np.tensordot(row, targets, 1)
        np.testing.assert_allclose(shown[faces], pose[atlas.faces], atol=1e-6)
        # Targets are added, normals as well (glTF 2.0, 3.7.2.2): of this frame's own triangles, nearly across them.
        normals = column(primitive.attributes.NORMAL) + np.tensordot(row, turns, 1)
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-6)
        across = np.cross(
            pose[atlas.faces][:, 1] - pose[atlas.faces][:, 0], pose[atlas.faces][:, 2] - pose[atlas.faces][:, 0]
        )
        assert ((normals[faces] * across[:, None]).sum(2) > 0).all()


def test_one_frame_has_no_animation(made, tmp_path):
    _, atlas, matter, poses, normals = made
    axes = texel_frames(atlas, poses[FRAMES[0]])[1]
    textures = material_textures(atlas, matter, axes, normals)
    write_posed_mesh(tmp_path / "still.glb", atlas, textures, {7: poses[7]}, FPS)
    document = pygltflib.GLTF2().load(str(tmp_path / "still.glb"))
    assert not document.animations and not document.meshes[0].primitives[0].targets
