"""The mesh with a skin: what a few lines of skinning find in the file are the tracked vertices."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from pipeline.avatar.matter import Matter
from pipeline.base.errors import InputError
from pipeline.base.files import write_arrays, write_json
from pipeline.export.atlas_textures import material_textures
from pipeline.export.rigged_motion import read_rigged_motion
from pipeline.export.skinned_mesh import write_skinned_mesh
from pipeline.geometry.texels import texel_frames
from tests.support.avatars.sheet import make_sheet
from tests.support.meshes.glb_files import GlbFile
from tests.support.meshes.shown_gltf import ShownGltf

FPS, FRAMES, SIZE = 12.0, [7, 8, 10], 12
SCALE_TO_M = 0.01

ROUNDING = 3e-6
"""Metres. A float32 number is off by 6e-8 of itself. A chain of six joints turns by quaternions, each of which moves
what hangs a metre below it by twice that of its four numbers, 5e-7; places, bind matrices and weights of about a metre
are off by 1e-7 at most."""


def turned(*rotation_vector):
    return Rotation.from_rotvec(rotation_vector).as_quat().tolist()


NODES = [
    {"name": "body", "mesh": 0, "skin": 0, "translation": [900.0, 0.0, 0.0]},
    {"name": "armature", "children": [2], "translation": [1, 2, 0], "rotation": turned(-1.5, 0, 0), "scale": [2.0] * 3},
    {"name": "root", "children": [3, 6], "translation": [0.0, 0.0, 10.0], "rotation": turned(0.1, -0.4, 0.2)},
    {"name": "between", "children": [4], "translation": [3.0, 0.0, 0.0], "rotation": turned(0, 0.5, 0)},
    {"name": "arm", "children": [5], "translation": [0.0, 8.0, 0.0], "scale": [1.0, 1.5, 0.8]},
    {"children": [7], "translation": [0.0, 5.0, 0.0], "rotation": turned(0.3, 0, 0.1)},
    {"name": "hip", "matrix": [1, 0, 0, 0, 0.2, 1.1, 0, 0, 0, 0, 0.9, 0, -4, -6, 0, 1]},
    {"name": "finger", "translation": [0.0, 4.0, 1.0]},
]  # fmt: skip
"""In centimetres. Node 3 is no joint, node 5 has no name, node 6 is sheared."""

JOINTS = [5, 2, 4, 6, 7]
"""Children before parents."""


@pytest.fixture(scope="module", params=[True, False], ids=["offsets", "pose alone"])
def tracked(request, tmp_path_factory):
    """A capture with a sheet that five joints move, and what track_mesh found of it, by the definition of a skin."""
    folder, rng, atlas = tmp_path_factory.mktemp("capture"), np.random.default_rng(3), make_sheet(SIZE)
    glb, bind = GlbFile(), (np.asarray(atlas.rest_vertices) / SCALE_TO_M).astype(np.float32)
    glb.content["nodes"] = NODES
    inverse_bind = np.stack([np.eye(4) + 0.05 * rng.normal(size=(4, 4)) for _ in JOINTS])
    inverse_bind[:, 3], inverse_bind[:, :3, 3] = [0, 0, 0, 1], rng.normal(0, 5, (5, 3))
    joints, weights = np.zeros((2, 4, 4), np.uint16), np.zeros((2, 4, 4), np.float32)
    joints[0], joints[1, :, 0], weights[0], weights[1, :, 0] = [0, 1, 2, 3], 4, rng.uniform(0.1, 1, (4, 4)), 0.3
    weights /= weights.sum((0, 2))[:, None]
    names = (
        {"POSITION": bind} | {f"JOINTS_{k}": joints[k] for k in (0, 1)} | {f"WEIGHTS_{k}": weights[k] for k in (0, 1)}
    )
    primitive = {"attributes": {name: glb.accessor(value) for name, value in names.items()},
                 "indices": glb.accessor(atlas.faces.reshape(-1).astype(np.uint32))}  # fmt: skip
    columns = inverse_bind.transpose(0, 2, 1).reshape(5, 16).astype(np.float32)
    glb.content["meshes"] = [{"primitives": [primitive]}]
    glb.content["skins"] = [{"joints": JOINTS, "inverseBindMatrices": glb.accessor(columns)}]
    glb.write(folder / "template.glb")
    write_json(folder / "capture.json", {"template": {"mesh": "template.glb", "scale_to_m": SCALE_TO_M}})
    turns = Rotation.random(len(FRAMES) * 5, rng=rng).as_quat().reshape(-1, 5, 4).astype(np.float32)
    turns[1] = -turns[1]  # the same rotations, on the other side
    roots, places = Rotation.random(len(FRAMES), rng=rng), rng.normal(0, 1, (len(FRAMES), 3)).astype(np.float32)
    offsets = request.param * rng.normal(0, 0.01, (len(FRAMES), 4, 3)).astype(np.float32)
    wxyz = lambda quaternions: np.roll(quaternions, 1, axis=-1).astype(np.float32)  # noqa: E731
    tables = {
        "frames": np.array(FRAMES), "joint_rotations": wxyz(turns), "root_rotation": wxyz(roots.as_quat()),
        "root_translation": places, "offsets": offsets.astype(np.float32),
    }  # fmt: skip
    write_arrays(folder / "0000.safetensors", {name: rows[:2] for name, rows in tables.items()})
    write_arrays(folder / "0001.safetensors", {name: rows[2:] for name, rows in tables.items()})
    expected = []
    for frame in range(len(FRAMES)):
        shown = 0.0
        palette = [world(node, dict(zip(JOINTS, turns[frame], strict=True))) for node in JOINTS] @ inverse_bind
        for k in (0, 1):
            place = np.concatenate([bind + offsets[frame] / SCALE_TO_M, np.ones((4, 1))], 1)
            shown = shown + np.einsum("vk,vkab,vb->va", weights[k], palette[joints[k]], place)
        expected.append(roots[frame].apply(SCALE_TO_M * shown[:, :3]) + places[frame])
    return folder, atlas, expected, bool(request.param)


def world(node, turns):
    """Global transform of a node of the template; of a joint's matrix, what is not rotation stays."""
    one, matrix = NODES[node], np.eye(4)
    if "matrix" in one:
        matrix = np.array(one["matrix"], float).reshape(4, 4).T
        u, _, vt = np.linalg.svd(matrix[:3, :3])
        stretched, rotation = (u @ vt).T @ matrix[:3, :3], u @ vt
    else:
        matrix[:3, 3] = one.get("translation", [0, 0, 0])
        stretched, rotation = (
            np.diag(one.get("scale", [1, 1, 1])),
            Rotation.from_quat(one.get("rotation", [0, 0, 0, 1])).as_matrix(),
        )
    matrix[:3, :3] = (Rotation.from_quat(turns[node]).as_matrix() if node in turns else rotation) @ stretched
    above = [k for k, other in enumerate(NODES) if node in other.get("children", [])]
    return world(above[0], turns) @ matrix if above else matrix


@pytest.fixture(scope="module")
def written(tracked):
    folder, atlas, _, _ = tracked
    chunks = [folder / "0000.safetensors", folder / "0001.safetensors"]
    motion = read_rigged_motion(folder, folder, chunks, FRAMES)
    count, axes = atlas.texel_count, texel_frames(atlas, np.asarray(atlas.rest_vertices, np.float64))[1]
    matter = Matter(np.full((count, 3), 0.5), np.full(count, 0.3), np.ones(count))
    write_skinned_mesh(folder / "mesh.glb", atlas, material_textures(atlas, matter, axes, axes[..., 2]), motion, FPS)
    return folder / "mesh.glb"


def test_skinned_by_hand_the_file_has_the_tracked_vertices(tracked, written):
    _, atlas, expected, corrected = tracked
    shown = ShownGltf(written)
    np.testing.assert_allclose(shown.seconds, (np.array(FRAMES) - FRAMES[0]) / FPS, rtol=1e-6)
    for key, vertices in enumerate(expected):
        np.testing.assert_allclose(shown.vertices(key)[shown.faces], vertices[atlas.faces], atol=ROUNDING)
    # What does not play shows the first frame.
    np.testing.assert_allclose(shown.vertices()[shown.faces], expected[0][atlas.faces], atol=ROUNDING)
    assert len(shown.primitive.targets) == corrected * len(FRAMES)


def test_joints_are_those_of_the_template(tracked, written):
    document = ShownGltf(written).document
    (skin,) = document.skins
    names = [document.nodes[node].name for node in skin.joints]
    assert names == ["joint 0", "root", "arm", "hip shape", "finger"]
    assert document.nodes[skin.skeleton].name == "skeleton"
    assert document.scenes[0].nodes == [skin.skeleton, ShownGltf(written).node]


def test_weights_and_rotations_are_as_the_specification_asks(written):
    shown = ShownGltf(written)
    weights = sum(shown.attribute(f"WEIGHTS_{k}").sum(1) for k in (0, 1))
    np.testing.assert_allclose(weights, 1, atol=2e-7 * 8)
    (animation,) = shown.document.animations
    turns = [shown.column(animation.samplers[channel.sampler].output) for channel in animation.channels
             if channel.target.path == "rotation"]  # fmt: skip
    assert len(turns) == 1 + len(JOINTS)
    for rows in turns:
        np.testing.assert_allclose(np.linalg.norm(rows, axis=1), 1, atol=1e-6)
        assert ((rows[1:] * rows[:-1]).sum(1) >= 0).all()  # the shorter way round


def test_trimesh_finds_the_bind_pose(tracked, written):
    """It reads no skins: the mesh as it lies, in metres."""
    _, atlas, _, _ = tracked
    (mesh,) = trimesh.load(written, process=False).geometry.values()
    np.testing.assert_allclose(mesh.triangles, np.asarray(atlas.rest_vertices)[atlas.faces], atol=1e-7)


def test_frame_that_was_not_tracked_is_named(tracked):
    folder = tracked[0]
    with pytest.raises(InputError, match=r"--tracking: expected all frames of the shards, found none of 10; track"):
        read_rigged_motion(folder, folder, [folder / "0000.safetensors"], FRAMES)


def test_without_joints_or_template_there_is_no_motion(tracked, tmp_path, caplog):
    folder = tracked[0]
    write_arrays(tmp_path / "given.safetensors", {"frames": np.array(FRAMES), "vertices": np.zeros((3, 4, 3))})
    assert read_rigged_motion(folder, folder, [tmp_path / "given.safetensors"], FRAMES) is None
    assert read_rigged_motion(tmp_path, folder, [folder / "0000.safetensors"], FRAMES) is None
    assert "no such template" in caplog.text
