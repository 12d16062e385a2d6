"""Frames without a mesh: between two they move evenly, beside one they hold it, and takes do not mix."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from pipeline.geometry.template_file import read_template
from pipeline.tracking.given_meshes import read_given

FRAMES = pd.DataFrame({"frame": [3, 4, 5, 6, 7, 8], "segment": list("aaaabb")})
"""Meshes at 3, 6 and 8: 4 and 5 lie between two, 7 beside one of its own take."""


@pytest.fixture
def head(tmp_path):
    ball = trimesh.creation.icosphere(subdivisions=1)
    ball.vertices *= [0.08, 0.12, 0.1]
    ball.export(tmp_path / "template.glb")
    return tmp_path, read_template(tmp_path / "template.glb", 1.0)


def motion(frame):
    R = Rotation.from_rotvec([0.0, 0.3 * (frame - 3) / 3, 0.0]).as_matrix()
    return R, np.array([0.1 * (frame - 3), 0.0, 0.0])


@pytest.mark.parametrize("kind", ["given", "fitted"])
def test_frames_between_beside_and_at_meshes(head, kind):
    folder, template = head
    rest, rows = template.vertices_rest, []
    for frame in (3, 6, 8):
        R, t = motion(frame)
        pose = np.concatenate([R, t[:, None]], 1) if kind == "given" else np.eye(3, 4)
        points = 1000 * (rest if kind == "given" else rest @ R.T + t)
        trimesh.Trimesh(points, template.faces, process=False).export(folder / f"{frame}.ply")
        rows.append((frame, f"{frame}.ply", pose.ravel()))
    meshes = pd.DataFrame(rows, columns=["frame", "path", "world_from_mesh"])
    found = read_given(folder, meshes, {"scale_to_m": 0.001, "motion": kind}, template, FRAMES, slice(1, 6))
    assert found.status == ["between", "between", "given", "held", "given"]
    for row, frame in enumerate((4, 5, 6, 8, 8)):
        R, t = motion(frame)
        np.testing.assert_allclose(found.vertices[row], rest @ R.T + t, atol=1e-6)
    np.testing.assert_allclose(found.offsets, 0, atol=1e-6)
