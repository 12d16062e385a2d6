"""Reading .glb templates and skinning them, against a plain recursive implementation and planted numbers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.base.errors import InputError
from pipeline.geometry.skin import posed, skinned
from pipeline.geometry.template_file import read_template
from tests.support.meshes.glb_files import GlbFile

FLOAT32 = 1e-6
"""What float32 numbers of about one in the file are good to, after a few products."""

Z_UP = [1, 0, 0, 0, 0, 0, -1, 0, 0, 1, 0, 0, 0, 0, 0, 1]


def quaternion(*rotation_vector: float) -> list[float]:
    return Rotation.from_rotvec(rotation_vector).as_quat().tolist()


NODES = [
    {"name": "up", "children": [1, 5], "matrix": Z_UP},
    {"name": "armature", "children": [3], "translation": [0.1, 0.2, 0.3], "scale": [2.0, 2.0, 2.0]},
    {"name": "hand", "translation": [0.0, 0.5, 0.0], "rotation": quaternion(0.3, 0.0, 0.1)},
    {"name": "root", "children": [4], "translation": [0.0, 0.0, 1.0], "rotation": quaternion(0.1, -0.4, 0.2)},
    {"name": "between", "children": [6], "translation": [0.05, 0.0, 0.0], "rotation": quaternion(0.0, 0.5, 0.0)},
    {"name": "body", "mesh": 0, "skin": 0, "translation": [9.0, 9.0, 9.0]},
    {"name": "arm", "children": [2], "translation": [0.0, 0.4, 0.0], "scale": [1.0, 1.5, 0.8]},
]
JOINTS = [2, 3, 6]  # not in topological order; node 4 lies between two joints and is none
PARENT_NODE = {child: parent for parent, node in enumerate(NODES) for child in node.get("children", [])}


def local_matrix(node: dict, turn: np.ndarray | None = None) -> np.ndarray:
    if "matrix" in node:
        return np.array(node["matrix"], float).reshape(4, 4).T
    matrix = np.eye(4)
    rotation = Rotation.from_quat(node.get("rotation", [0, 0, 0, 1])).as_matrix() if turn is None else turn
    matrix[:3, :3] = rotation @ np.diag(node.get("scale", [1, 1, 1]))
    matrix[:3, 3] = node.get("translation", [0, 0, 0])
    return matrix


def global_matrix(node: int, turns: dict[int, np.ndarray]) -> np.ndarray:
    matrix = local_matrix(NODES[node], turns.get(node))
    return global_matrix(PARENT_NODE[node], turns) @ matrix if node in PARENT_NODE else matrix


def skinned_by_hand(positions, joints, weights, inverse_bind, turns) -> np.ndarray:
    out = np.zeros_like(positions)
    for v, position in enumerate(positions):
        for joint, weight in zip(joints[v], weights[v] / weights[v].sum(), strict=True):
            matrix = global_matrix(JOINTS[joint], turns) @ inverse_bind[joint]
            out[v] += weight * (matrix @ np.append(position, 1.0))[:3]
    return out


@pytest.fixture
def figure(tmp_path: Path) -> dict:
    rng = np.random.default_rng(5)
    positions = rng.normal(size=(20, 3)).astype(np.float32)
    joints = np.stack([rng.permutation(3) for _ in range(20)])
    joints = np.concatenate([joints, np.zeros((20, 1), int)], 1)
    weights = np.concatenate([rng.integers(1, 100, (20, 3)), np.zeros((20, 1), int)], 1)
    inverse_bind = np.stack([np.linalg.inv(global_matrix(n, {})) + 0.05 * rng.normal(size=(4, 4)) for n in JOINTS])
    inverse_bind[:, 3] = [0, 0, 0, 1]
    inverse_bind = inverse_bind.astype(np.float32)
    return {"positions": positions, "joints": joints, "weights": weights, "inverse_bind": inverse_bind,
            "uv": rng.random((20, 2)).astype(np.float32), "faces": rng.permutation(18).reshape(6, 3)}  # fmt: skip


def build(figure: dict, weight_dtype: type = np.float32, index_dtype: type = np.uint16, pad: int = 0) -> GlbFile:
    file = GlbFile()
    file.content["nodes"] = NODES
    weights = figure["weights"].astype(weight_dtype)
    normalized = weight_dtype is not np.float32
    attributes = {
        "POSITION": file.accessor(figure["positions"], pad=pad),
        "TEXCOORD_0": file.accessor(figure["uv"], pad=pad),
        "JOINTS_0": file.accessor(figure["joints"].astype(np.uint8 if pad else index_dtype), pad=pad),
        "WEIGHTS_0": file.accessor(weights, normalized=normalized, pad=pad),
    }
    indices = file.accessor(figure["faces"].reshape(-1, 1).astype(index_dtype))
    file.content["meshes"] = [{"primitives": [{"attributes": attributes, "indices": indices}]}]
    matrices = file.accessor(figure["inverse_bind"].transpose(0, 2, 1).copy())
    file.content["skins"] = [{"joints": JOINTS, "inverseBindMatrices": matrices}]
    return file


@pytest.mark.parametrize(
    ("weight_dtype", "index_dtype", "pad"),
    [(np.float32, np.uint16, 0), (np.uint8, np.uint8, 0), (np.uint16, np.uint16, 0), (np.float32, np.uint16, 4)],
)
def test_rest_and_posed_vertices_match_a_plain_implementation(
    figure: dict, tmp_path: Path, weight_dtype: type, index_dtype: type, pad: int
) -> None:
    template = read_template(build(figure, weight_dtype, index_dtype, pad).write(tmp_path / "t.glb"), 0.01)
    by_hand = [figure[k] for k in ("positions", "joints", "weights", "inverse_bind")]
    assert np.abs(template.vertices_rest - 0.01 * skinned_by_hand(*by_hand, {})).max() < 0.1 * FLOAT32
    turns = Rotation.random(3, rng=np.random.default_rng(1))
    expected = 0.01 * skinned_by_hand(*by_hand, dict(zip(JOINTS, turns.as_matrix(), strict=True)))
    rotations = np.roll(turns.as_quat(), 1, axis=-1)[None]
    assert np.abs(skinned(template, rotations)[0] - expected).max() < 0.1 * FLOAT32
    root, shift = Rotation.from_rotvec([0.3, 2.0, -1.0]), np.array([[1.0, -2.0, 3.0]])
    moved = posed(template, np.roll(root.as_quat(), 1)[None], shift, rotations)
    assert np.abs(moved[0] - (root.apply(expected) + shift)).max() < FLOAT32
    assert np.array_equal(template.faces, figure["faces"])
    assert np.array_equal(template.uv, figure["uv"])
    assert template.joint_nodes.tolist() == JOINTS
    assert template.parents.tolist() == [2, -1, 1]
    assert np.allclose(template.joints_rest, [0.01 * global_matrix(n, {})[:3, 3] for n in JOINTS], atol=FLOAT32)


def test_sparse_accessor_replaces_elements(figure: dict, tmp_path: Path) -> None:
    file = build(figure)
    rows, values = np.array([3, 7], np.uint16), np.array([[1, 2, 3], [4, 5, 6]], np.float32)
    sparse = {"count": 2, "indices": {"bufferView": file.view(rows.tobytes()), "componentType": 5123},
              "values": {"bufferView": file.view(values.tobytes())}}  # fmt: skip
    file.content["accessors"][0]["sparse"] = sparse
    template = read_template(file.write(tmp_path / "t.glb"), 1.0)
    expected = figure["positions"].copy()
    expected[rows] = values
    assert np.array_equal(template.vertices_bind, expected.astype(np.float64))


def test_primitives_are_concatenated_and_unskinned_ones_follow_their_node(figure: dict, tmp_path: Path) -> None:
    file = build(figure)
    hat = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
    file.content["meshes"].append({"primitives": [{"attributes": {"POSITION": file.accessor(hat)}}]})
    file.content["nodes"] = [*NODES, {"mesh": 1, "translation": [0.0, 0.1, 0.0]}]
    file.content["nodes"][2] = NODES[2] | {"children": [len(NODES)]}
    template = read_template(file.write(tmp_path / "t.glb"), 1.0)
    assert len(template.vertices_rest) == 23
    assert template.faces[-1].tolist() == [20, 21, 22]
    assert template.uv is None
    in_scene = global_matrix(2, {}) @ np.c_[hat + np.array([0.0, 0.1, 0.0]), np.ones(3)].T
    assert np.abs(template.vertices_rest[20:] - in_scene[:3].T).max() < FLOAT32
    assert template.weights[20:].tolist() == [[1.0, 0.0, 0.0]] * 3


def test_unrigged_template_takes_its_nodes_transform(tmp_path: Path) -> None:
    file, triangle = GlbFile(), np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
    file.content["meshes"] = [{"primitives": [{"attributes": {"POSITION": file.accessor(triangle)}}]}]
    file.content["nodes"] = [{"children": [1], "matrix": Z_UP}, {"mesh": 0, "translation": [0, 0, 5]}]
    template = read_template(file.write(tmp_path / "t.glb"), 0.1)
    assert not template.rigged
    assert template.weights.shape == (3, 0)
    assert np.allclose(template.vertices_rest, [[0, 0.5, 0], [0.1, 0.5, 0], [0, 0.5, -0.1]], atol=FLOAT32)
    half_turn, none = np.array([[0.0, 0.0, 1.0, 0.0]]), np.zeros((1, 0, 4))
    moved = posed(template, half_turn, np.array([[0.0, 1.0, 0.0]]), none)
    assert np.allclose(moved[0], [[0, 1.5, 0], [-0.1, 1.5, 0], [0, 1.5, 0.1]], atol=FLOAT32)


def test_bad_files_are_named(figure: dict, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_template(tmp_path / "absent.glb", 1.0)
    (tmp_path / "text.glb").write_text("not a mesh at all")
    with pytest.raises(InputError, match=r"text\.glb: expected a glTF"):
        read_template(tmp_path / "text.glb", 1.0)
    strip = build(figure)
    strip.content["meshes"][0]["primitives"][0]["mode"] = 5
    with pytest.raises(InputError, match="mode 5"):
        read_template(strip.write(tmp_path / "strip.glb"), 1.0)
    packed = build(figure)
    packed.content["extensionsRequired"] = ["KHR_draco_mesh_compression"]
    with pytest.raises(InputError, match="draco"):
        read_template(packed.write(tmp_path / "packed.glb"), 1.0)
    figure["weights"][4] = 0
    with pytest.raises(InputError, match="1 of 20 vertices"):
        read_template(build(figure).write(tmp_path / "loose.glb"), 1.0)
