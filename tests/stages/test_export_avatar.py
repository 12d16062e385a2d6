"""The stage from an avatar to files of other programs: which are written, and that Blender opens them."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys

import numpy as np
import pygltflib
import pytest
import trimesh
from scipy.spatial import cKDTree

from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.relighting.film import view_independent_color
from pipeline.avatar.training.checkpoint import load_avatar
from pipeline.base.errors import InputError
from pipeline.base.files import write_arrays, write_json
from pipeline.capture.shards import read_frame_shards, write_frame_shard
from pipeline.config.export_avatar import ExportAvatar
from pipeline.geometry.camera_paths import orbit
from pipeline.geometry.cameras import write_cameras
from pipeline.geometry.texels import read_atlas
from pipeline.rendering.splat_ply import read_splats
from pipeline.stages import export_avatar
from tests.support.meshes.glb_files import GlbFile
from tests.support.meshes.shown_gltf import ShownGltf
from tests.support.viewer.ball_avatar import LAMPS, MIDDLE, write_ball


@pytest.fixture(scope="module")
def ball(tmp_path_factory):
    """The stage's arguments but `out`, of a ball over a floor in two frames."""
    folder = tmp_path_factory.mktemp("ball")
    found = write_ball(folder)
    cameras = orbit(MIDDLE, 8.0, 1.0, 0.3, 40.0, 40, 48, 2)
    write_cameras(folder / "cameras.json", {f"cam {k}": camera for k, camera in enumerate(cameras)})
    write_json(folder / "index/capture.json", {"fps": 12.0})
    return found | {"cameras": folder / "cameras.json", "index": folder / "index"}


@pytest.fixture(scope="module")
def exported(ball, tmp_path_factory):
    pytest.importorskip("pxr", reason="the Python package usd-core is not installed")
    folder = tmp_path_factory.mktemp("exported") / "export"
    export_avatar.run(**ball, out=folder, settings=ExportAvatar(splat_frames=2, exposure=0.5))
    return folder


def test_all_formats_are_written(ball, exported):
    written = {str(path.relative_to(exported)) for path in exported.rglob("[!.]*") if path.is_file()}
    splats = {f"splats/{frame:06d}.{name}" for frame in (10, 11) for name in ("ply", "spz", "sog", "glb")}
    assert written == splats | {"mesh.glb", "stage.glb", "stage.usda", "open_in_blender.py"}
    # Lit as each frame was, by what all sides share.
    loaded = load_avatar(ball["avatar"], ball["atlas"])
    frame = read_frame_shards([ball["shards"] / "frames"])[11]
    prepared = loaded.avatar.prepare(FrameInputs(loaded.atlas, frame))
    found = read_splats(exported / "splats/000011.ply")
    np.testing.assert_allclose(found.means, prepared.gaussians.means.detach(), atol=1e-6)
    expected = (0.5 * view_independent_color(prepared)).clamp(0, 1).detach()
    np.testing.assert_allclose(found.rgb_linear, expected, atol=1e-5)
    (mesh,) = trimesh.load(exported / "mesh.glb", process=False).geometry.values()
    first = read_frame_shards([ball["shards"] / "frames"])[10].vertices
    np.testing.assert_allclose(mesh.triangles, first[loaded.atlas.faces], atol=1e-6)
    lights = pygltflib.GLTF2().load(str(exported / "stage.glb")).extensions["KHR_lights_punctual"]["lights"]
    assert [light["name"] for light in lights] == list(LAMPS)


@pytest.fixture
def rigged(ball, tmp_path):
    """The arguments of a template with a joint, which stands still: offsets before skinning move the ball."""
    atlas, records = read_atlas(ball["atlas"]), read_frame_shards([ball["shards"] / "frames"])
    rest, numbers = np.asarray(atlas.rest_vertices, np.float32), sorted(records)
    file = GlbFile()
    file.content["nodes"] = [{"mesh": 0, "skin": 0}, {"name": "root"}]
    first, still = np.zeros((len(rest), 4), np.uint16), np.eye(4, dtype=np.float32)
    columns = {"POSITION": rest, "JOINTS_0": first, "WEIGHTS_0": np.float32([1, 0, 0, 0]) + np.zeros_like(first, "f4")}
    attributes = {name: file.accessor(values) for name, values in columns.items()}
    indices = file.accessor(np.asarray(atlas.faces, np.uint32).reshape(-1))
    file.content["meshes"] = [{"primitives": [{"attributes": attributes, "indices": indices}]}]
    file.content["skins"] = [{"joints": [1], "inverseBindMatrices": file.accessor(still.reshape(1, 16))}]
    file.write(tmp_path / "template.glb")
    described = {"fps": 12.0, "template": {"mesh": "template.glb", "scale_to_m": 1.0}}
    write_json(tmp_path / "index/capture.json", described)
    turn = np.tile(np.float32([1, 0, 0, 0]), (len(numbers), 1))
    write_arrays(tmp_path / "0000.safetensors", {
        "frames": np.array(numbers), "root_rotation": turn, "joint_rotations": turn[:, None],
        "root_translation": np.zeros((len(numbers), 3), np.float32),
        "offsets": np.stack([records[number].vertices - rest for number in numbers]),
    })  # fmt: skip
    given = {"capture": tmp_path, "index": tmp_path / "index", "tracking": (tmp_path / "0000.safetensors",)}
    return ball | given, atlas, records


@pytest.mark.parametrize("animation", ["auto", "targets"])
def test_joints_of_the_template_are_a_skin_unless_it_is_not_wanted(rigged, tmp_path, animation):
    arguments, atlas, records = rigged
    settings = ExportAvatar(formats=("mesh",), animation=animation)
    export_avatar.run(**arguments, out=tmp_path / "export", settings=settings)
    shown = ShownGltf(tmp_path / "export/mesh.glb")
    assert len(shown.document.skins) == (animation == "auto")
    for key, number in enumerate(sorted(records)):
        expected = records[number].vertices[atlas.faces]
        np.testing.assert_allclose(shown.vertices(key)[shown.faces], expected, atol=1e-6)


def test_only_what_is_asked_for_is_written(ball, tmp_path):
    export_avatar.run(**ball, out=tmp_path / "export", settings=ExportAvatar(formats=("spz", "stage")))
    written = {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("[!.]*") if path.is_file()}
    names = ("splats/000010.spz", "stage.glb", "open_in_blender.py")
    assert written == {f"export/{name}" for name in names}


def test_capture_without_frames_is_refused(ball, tmp_path):
    write_frame_shard(tmp_path / "none/0000.arrow", [])
    with pytest.raises(InputError, match="expected at least one frame, found none"):
        export_avatar.run(**ball, frames=tmp_path / "none", out=tmp_path / "export")
    assert not (tmp_path / "export").exists()


SEEN_BY_BLENDER = """
import json, runpy, sys
runpy.run_path(sys.argv[1], run_name="__main__")
import bpy
scene, mesh = bpy.context.scene, next(o for o in bpy.data.objects if o.type == "MESH")
scene.frame_set(scene.frame_end)
shown = mesh.evaluated_get(bpy.context.evaluated_depsgraph_get())
heights = [(shown.matrix_world @ v.co).z for v in shown.data.vertices]
links = [node.image.name for node in mesh.data.materials[0].node_tree.nodes if node.type == "TEX_IMAGE"]
print("FOUND", json.dumps({
    "types": sorted(o.type for o in bpy.data.objects), "camera": scene.camera.name, "images": sorted(links),
    "size": [scene.render.resolution_x, scene.render.resolution_y], "height": max(heights),
    "keys": len(mesh.data.shape_keys.key_blocks), "shift": scene.camera.data.shift_x}))
"""


SKINNED_IN_BLENDER = """
import json, runpy, sys
runpy.run_path(sys.argv[1], run_name="__main__")
import bpy
(rig,) = [o for o in bpy.data.objects if o.type == "ARMATURE"]
(mesh,) = [o for o in bpy.data.objects if o.type == "MESH" and o.parent is rig]
found = []
for frame in (0, bpy.context.scene.frame_end):
    bpy.context.scene.frame_set(frame)
    shown = mesh.evaluated_get(bpy.context.evaluated_depsgraph_get())
    found.append([list(shown.matrix_world @ v.co) for v in shown.data.vertices])
print("FOUND", json.dumps({"bones": [bone.name for bone in rig.data.bones], "vertices": found}))
"""


def told_by_blender(script, opened):
    if importlib.util.find_spec("bpy") is None:
        pytest.skip("the Python package bpy, which is Blender, is not installed")
    printed = subprocess.run([sys.executable, "-c", script, opened], check=True, capture_output=True, text=True).stdout
    return json.loads(printed.partition("FOUND")[2].splitlines()[0])


def test_blender_moves_the_skin_to_the_tracked_vertices(rigged, tmp_path):
    arguments, _, records = rigged
    export_avatar.run(**arguments, out=tmp_path / "export", settings=ExportAvatar(formats=("mesh",)))
    found = told_by_blender(SKINNED_IN_BLENDER, tmp_path / "export/open_in_blender.py")
    assert found["bones"] == ["root"]
    # Blender counts 24 pictures a second, of which the second frame of 12 is the third; and its z is up.
    for shown, number in zip(np.array(found["vertices"]), sorted(records), strict=True):
        nearest, _ = cKDTree(shown @ [[1, 0, 0], [0, 0, -1], [0, 1, 0]]).query(records[number].vertices)
        assert nearest.max() < 1e-5


def test_blender_opens_mesh_cameras_and_lights(exported):
    found = told_by_blender(SEEN_BY_BLENDER, exported / "open_in_blender.py")
    assert found["types"] == ["CAMERA", "CAMERA", "LIGHT", "LIGHT", "LIGHT", "MESH"]
    assert (found["camera"], found["size"], found["keys"], found["shift"]) == ("cam 0", [40, 48], 2, 0)
    assert found["images"] == ["base_color", "metallic_roughness", "normal", "specular"]
