"""The binding to Embree against embreex, and what it says where there is no Embree."""

from __future__ import annotations

import resource

import numpy as np
import pytest
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from pipeline.lighting import embree
from pipeline.lighting.embree import EmbreeMesh, library_path
from tests.support.meshes.lit_meshes import crumpled_sphere


def single(mesh: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """A mesh with vertices in single precision."""
    return mesh[0].astype(np.float32), mesh[1]


def random_rays(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Origins inside and outside, unit directions, and lengths of which some end too early."""
    rng = np.random.default_rng(0)
    ways = rng.normal(size=(count, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    arrays = rng.uniform(-1.5, 1.5, (count, 3)), ways, rng.uniform(0.1, 3, count)
    return tuple(array.astype(np.float32) for array in arrays)


def test_rays_find_what_embreex_finds() -> None:
    vertices, faces = single(crumpled_sphere(4))
    origins, ways, lengths = random_rays(20_000)
    scene = EmbreeScene(robust=True)
    TriangleMesh(scene, vertices, faces)
    mesh = EmbreeMesh(vertices, faces)

    met = scene.run(origins, ways, dists=lengths.copy(), query="OCCLUDED")
    np.testing.assert_array_equal(mesh.occluded(origins, ways, lengths), met)
    assert 0.2 < (met == 0).mean() < 0.8

    face, distance, at = mesh.nearest(origins, ways, lengths)
    found = scene.run(origins, ways, dists=lengths.copy(), query="INTERSECT", output=True)
    np.testing.assert_array_equal(face, found["primID"])
    np.testing.assert_array_equal(distance, found["tfar"])
    np.testing.assert_array_equal(at[face >= 0], np.stack([found["u"], found["v"]], 1)[face >= 0])
    np.testing.assert_array_equal(distance[face < 0], lengths[face < 0])
    assert not at[face < 0].any()


def test_a_mesh_keeps_the_arrays_that_embree_reads() -> None:
    """Also where its caller writes over them afterwards."""
    vertices, faces = single(crumpled_sphere(3))
    rays, given = random_rays(2000), (vertices.copy(), faces.astype(np.int32))
    mesh = EmbreeMesh(*given)
    given[0][:], given[1][:] = 9, 0
    np.testing.assert_array_equal(mesh.occluded(*rays), EmbreeMesh(vertices, faces).occluded(*rays))


def test_meshes_that_are_dropped_give_their_memory_back() -> None:
    vertices, faces = single(crumpled_sphere(5))
    EmbreeMesh(vertices, faces)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for _ in range(100):
        EmbreeMesh(vertices, faces)
    # Kibibytes. A tree of 20,480 faces is 2 MB or more: kept, they would be 200.
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50 * 1024


def test_what_embree_refuses_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(embree, "THREE_FLOATS", 1)
    with pytest.raises(RuntimeError, match="Embree could not build a tree: its error 3"):
        EmbreeMesh(*single(crumpled_sphere(0)))


def test_without_embree_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(embree.metadata, "files", lambda name: None)
    monkeypatch.setattr(embree, "find_library", lambda name: None)
    with pytest.raises(ImportError, match="reinstall embreex"):
        library_path()


def test_the_library_of_the_system_does_where_the_wheel_has_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(embree.metadata, "files", lambda name: [])
    monkeypatch.setattr(embree, "find_library", lambda name: f"lib{name}.so.4")
    assert library_path() == "libembree4.so.4"
