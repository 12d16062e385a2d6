"""Meshes of other programs' files: order of vertices and triangles, and files that are none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from pipeline.base.errors import InputError
from pipeline.geometry.mesh_files import decode_mesh


def test_an_obj_keeps_its_vertices_through_seams_polygons_and_negative_numbers():
    text = "# quad and triangle\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\n"
    text += "f 1/1 2/2 3/1 4/2\nf -4//1 -3//1 -1//1\n"
    mesh = decode_mesh(text.encode(), Path("a.obj"))
    np.testing.assert_array_equal(mesh.vertices, [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    np.testing.assert_array_equal(mesh.faces, [[0, 1, 2], [0, 2, 3], [0, 1, 3]])


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_a_ply_of_another_program(encoding):
    sphere = trimesh.creation.icosphere(subdivisions=1)
    mesh = decode_mesh(sphere.export(file_type="ply", encoding=encoding), Path("a.ply"))
    np.testing.assert_allclose(mesh.vertices, sphere.vertices, atol=1e-6)
    np.testing.assert_array_equal(mesh.faces, sphere.faces)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.ply", b""), ("a.ply", b"ply\nnonsense"), ("a.obj", b""), ("a.obj", b"v 0 zero 0\n"),
        ("a.obj", b"v nan 0 0\n"), ("a.obj", b"v 0 0 0\nf 1 2 3\n"),
    ],
)  # fmt: skip
def test_what_is_no_mesh_is_refused_by_name(name, content):
    with pytest.raises(InputError, match=r"^a\."):
        decode_mesh(content, Path(name))
