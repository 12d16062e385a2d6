"""The template file, read back with pygltflib and skinned by the letter of the glTF specification."""

import numpy as np
import pygltflib
import pytest

from pipeline.synthesis.figure import build_figure
from pipeline.synthesis.gltf_writer import FIRST_JOINT_NODE, Skin, write_glb
from pipeline.synthesis.subject import vertex_normals

COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
TYPES = {5126: np.float32, 5123: np.uint16, 5125: np.uint32}


def read(gltf, index):
    accessor = gltf.accessors[index]
    view = gltf.bufferViews[accessor.bufferView]
    data = gltf.binary_blob()[view.byteOffset : view.byteOffset + view.byteLength]
    return np.frombuffer(data, TYPES[accessor.componentType]).reshape(accessor.count, COMPONENTS[accessor.type])


@pytest.mark.parametrize(("uvs", "units_per_m"), [(True, 1.0), (False, 100.0)])
def test_file_holds_the_rest_mesh_and_a_consistent_skin(tmp_path, uvs, units_per_m):
    figure = build_figure("test", 0.045, 128, 0.25)
    cut = figure.unwrapped
    source = cut.source if uvs else np.arange(len(figure.vertices))
    faces = cut.faces if uvs else figure.faces
    write_glb(
        tmp_path / "t.glb", vertices=figure.vertices[source], faces=faces, uv=cut.uv if uvs else None,
        normals=vertex_normals(figure.vertices, figure.faces)[source],
        skin=Skin(figure.weights[source], figure.skeleton), units_per_m=units_per_m,
    )  # fmt: skip
    gltf = pygltflib.GLTF2().load(str(tmp_path / "t.glb"))
    assert not gltf.animations and not gltf.images and len(gltf.skins) == 1
    attributes = gltf.meshes[0].primitives[0].attributes
    assert (attributes.TEXCOORD_0 is not None) == uvs
    rest = figure.vertices[source] * units_per_m
    positions = read(gltf, attributes.POSITION)
    np.testing.assert_allclose(positions, rest, rtol=1e-6, atol=1e-6 * units_per_m)
    np.testing.assert_array_equal(read(gltf, gltf.meshes[0].primitives[0].indices).reshape(-1, 3), faces)
    joints, weights = read(gltf, attributes.JOINTS_0), read(gltf, attributes.WEIGHTS_0)
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-6)
    dense = np.zeros_like(figure.weights[source])
    np.add.at(dense, (np.arange(len(source))[:, None], joints), weights)
    np.testing.assert_allclose(dense, figure.weights[source], atol=1e-6)
    # At rest, world * inverse bind is the identity for every joint.
    parents = {child: i for i, node in enumerate(gltf.nodes) for child in node.children}
    inverse_bind = read(gltf, gltf.skins[0].inverseBindMatrices).reshape(-1, 4, 4).transpose(0, 2, 1)
    for joint, node in enumerate(gltf.skins[0].joints):
        assert node == FIRST_JOINT_NODE + joint
        world = np.zeros(3)
        while node is not None:
            world += gltf.nodes[node].translation or np.zeros(3)
            node = parents.get(node)
        np.testing.assert_allclose(inverse_bind[joint][:3, 3], -world, atol=1e-5 * units_per_m)


def test_mesh_without_a_skin_has_no_joints(tmp_path):
    vertices = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0]])
    faces = np.array([[0, 1, 2]])
    write_glb(tmp_path / "t.glb", vertices=vertices, normals=vertices, faces=faces, uv=None, units_per_m=10.0)
    gltf = pygltflib.GLTF2().load(str(tmp_path / "t.glb"))
    assert not gltf.skins and len(gltf.nodes) == 1
    attributes = gltf.meshes[0].primitives[0].attributes
    assert attributes.JOINTS_0 is None and attributes.WEIGHTS_0 is None
    np.testing.assert_array_equal(read(gltf, attributes.POSITION), 10 * vertices)
    np.testing.assert_array_equal(read(gltf, gltf.meshes[0].primitives[0].indices).reshape(-1, 3), faces)
