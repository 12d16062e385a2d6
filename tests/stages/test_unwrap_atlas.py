"""The stage on boxes whose layout is known: with usable coordinates, without, and with unusable ones."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

from pipeline.base.errors import InputError
from pipeline.config.unwrap_atlas import UnwrapAtlas
from pipeline.geometry.cameras import Camera, write_cameras
from pipeline.geometry.template_file import read_template
from pipeline.geometry.texels import read_atlas, texel_frames
from pipeline.stages.unwrap_atlas import measure_atlas, run


def box_capture(folder: Path, uv: str | None, *, inwards: bool = False) -> tuple[Path, Path]:
    """A capture of a 2 m cube, each side with four vertices of its own, and its index.

    uv: "six" gives each side a cell of a 3 x 2 grid, "one" gives all the same cell, None leaves coordinates out.
    """
    sides, faces, coordinates = [], [], []
    for number, (axis, sign) in enumerate((a, s) for a in range(3) for s in (1.0, -1.0)):
        normal, right = np.zeros(3), np.roll([0, 1.0, 0], axis)
        normal[axis] = sign
        up = np.cross(normal, right)
        sides += [normal + x * right + y * up for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        faces += [[4 * number + i for i in triangle] for triangle in ((0, 1, 2), (0, 2, 3))]
        cell = np.array([number % 3 / 3, number // 3 / 2]) if uv == "six" else np.zeros(2)
        coordinates += [cell + np.array([x, y]) * [0.3, 0.45] + 0.01 for x, y in ((0, 1), (1, 1), (1, 0), (0, 0))]
    triangles = np.array(faces)[:, ::-1] if inwards else np.array(faces)
    # trimesh keeps v pointing up.
    visual = trimesh.visual.TextureVisuals(np.array(coordinates) * [1, -1] + [0, 1]) if uv else None
    mesh = trimesh.Trimesh(np.array(sides), triangles, visual=visual, process=False)
    (folder / "index").mkdir()
    (folder / "box.glb").write_bytes(mesh.export(file_type="glb"))
    (folder / "index/capture.json").write_text(
        json.dumps({"template": {"mesh": "box.glb", "scale_to_m": 0.5}, "images": {"downsample_from_sensor": 2}})
    )
    return folder, folder / "index"


def test_own_coordinates_are_used(tmp_path: Path) -> None:
    capture, index = box_capture(tmp_path, "six")
    run(capture=capture, index=index, out=tmp_path / "out", settings=UnwrapAtlas(size=60))
    atlas, template = read_atlas(tmp_path / "out/atlas.safetensors"), read_template(capture / "box.glb", 0.5)
    np.testing.assert_array_equal(atlas.uv, template.uv.astype(np.float32)[template.faces])
    # Six sides of 18 x 27 texels, each 1 m wide: 1 / 18 m by 1 / 27 m per texel.
    assert atlas.texel_count == 6 * 18 * 27
    measures = measure_atlas(atlas)
    assert measures.charts == 6
    assert measures.mean_texel_mm == pytest.approx(1000 / np.sqrt(18 * 27), rel=1e-3)
    assert measures.stretch_95 == pytest.approx(1.5, rel=1e-3)
    assert measures.uncovered == 0
    points, frames = texel_frames(atlas, atlas.rest_vertices)
    assert np.abs(points).max(1) == pytest.approx(0.5, abs=1e-6)
    # Welded over its seams, the cube's smooth normals point away from the centre.
    assert ((points / np.linalg.norm(points, axis=1, keepdims=True) * frames[..., 2]).sum(1) > 0.9).all()
    assert len(np.unique(atlas.weld)) == 8


def test_without_coordinates_new_ones_are_cut(tmp_path: Path) -> None:
    capture, index = box_capture(tmp_path, None)
    for out in ("a", "b"):
        run(capture=capture, index=index, out=tmp_path / out, settings=UnwrapAtlas(size=64))
    files = [(tmp_path / out / "atlas.safetensors").read_bytes() for out in ("a", "b")]
    assert files[0] == files[1]
    measures = measure_atlas(read_atlas(tmp_path / "a/atlas.safetensors"))
    assert measures.charts == 6
    assert measures.stretch_95 < 1.2
    assert measures.use > 0.4


def test_shared_coordinates_are_refused_or_replaced(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    capture, index = box_capture(tmp_path, "one")
    with pytest.raises(InputError, match="several faces"):
        run(capture=capture, index=index, out=tmp_path / "out", settings=UnwrapAtlas(size=32, layout="template"))
    assert not (tmp_path / "out").exists()
    with caplog.at_level("INFO"):
        run(capture=capture, index=index, out=tmp_path / "out", settings=UnwrapAtlas(size=32))
    assert "several faces" in caplog.text
    assert measure_atlas(read_atlas(tmp_path / "out/atlas.safetensors")).charts == 6


def test_the_written_mesh_and_picture_show_the_map(tmp_path: Path) -> None:
    capture, index = box_capture(tmp_path, None)
    run(capture=capture, index=index, out=tmp_path / "out", settings=UnwrapAtlas(size=48))
    atlas, written = read_atlas(tmp_path / "out/atlas.safetensors"), read_template(tmp_path / "out/template.glb", 1.0)
    np.testing.assert_allclose(written.uv[written.faces], atlas.uv, atol=1e-6)
    np.testing.assert_allclose(written.vertices_rest[written.faces], atlas.rest_vertices[atlas.faces], atol=1e-6)
    assert min(cv2.imread(str(tmp_path / "out/atlas.png")).shape[:2]) > 500


def test_faces_that_look_inwards_are_refused(tmp_path: Path) -> None:
    capture, index = box_capture(tmp_path, "six", inwards=True)
    with pytest.raises(InputError, match="look outwards"):
        run(capture=capture, index=index, out=tmp_path / "out", settings=UnwrapAtlas(size=256))


@pytest.mark.parametrize(("uv", "within"), [("six", 0.05), (None, 0.3)])
def test_size_follows_what_a_pixel_covers(tmp_path: Path, uv: str | None, within: float) -> None:
    """Three cameras 4 m away: a pixel of their images, two of the sensor's, covers 2 * 4 m / 400 = 2 cm."""
    capture, index = box_capture(tmp_path, uv)
    turns = [np.eye(3), np.roll(np.eye(3), 1, 0), np.roll(np.eye(3), 2, 0)]
    K = np.array([[400.0, 0, 200], [0, 400, 200], [0, 0, 1]])
    cameras = {str(n): Camera(R, np.array([0, 0, 4.0]), K, np.zeros(5), 400, 400) for n, R in enumerate(turns)}
    write_cameras(tmp_path / "cameras.json", cameras)
    given = {"capture": capture, "index": index, "cameras": tmp_path / "cameras.json"}
    run(**given, out=tmp_path / "out", settings=UnwrapAtlas(texel_pixels=0.5))
    atlas = read_atlas(tmp_path / "out/atlas.safetensors")
    assert measure_atlas(atlas).mean_texel_mm == pytest.approx(10, rel=within)
    run(**given, out=tmp_path / "most", settings=UnwrapAtlas(texel_pixels=0.01, most=96))
    assert read_atlas(tmp_path / "most/atlas.safetensors").size == 96
    with pytest.raises(InputError, match=r"unwrap_atlas.size: expected a number, as --cameras is not given"):
        run(capture=capture, index=index, out=tmp_path / "none")
