"""Plates and balls under lights, for tests of shadow rays and of maps traced with them."""

from __future__ import annotations

import numpy as np
import trimesh

from pipeline.geometry.mesh import area_vectors, unit_or
from pipeline.lighting.light_scene import Lights
from pipeline.lighting.visibility import Occluders

LIGHTS = np.array([[0, 5.0, 0], [3, 4, 1], [-2, 3.5, 2], [0, 6, -4], [4, 5, -3]])

SIDE = 32
TEXEL = np.stack(np.divmod(np.arange(SIDE**2), SIDE), 1)
"""Row and column of each point of `floor_map` on a map of `SIDE` squared."""


def plate(half: float, height: float) -> tuple[np.ndarray, np.ndarray]:
    """A square around the y axis at a height, looking up."""
    corners = np.array([[-half, height, -half], [-half, height, half], [half, height, half], [half, height, -half]])
    return corners, np.array([[0, 1, 2], [0, 2, 3]])


def together(*meshes: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    starts = np.cumsum([0] + [len(vertices) for vertices, _ in meshes])
    faces = [faces + start for (_, faces), start in zip(meshes, starts[:-1], strict=True)]
    return np.concatenate([vertices for vertices, _ in meshes]), np.concatenate(faces)


def sphere(radius: float, center: tuple[float, float, float], subdivisions: int = 5) -> tuple[np.ndarray, np.ndarray]:
    mesh = trimesh.creation.icosphere(subdivisions)
    return np.array(mesh.vertices) * radius + center, np.array(mesh.faces)


def crumpled_sphere(subdivisions: int = 2) -> tuple[np.ndarray, np.ndarray]:
    """A closed surface with folds: many concave corners; twice subdivided, 320 faces."""
    vertices, faces = sphere(1.0, (0, 0, 0), subdivisions)
    return vertices * np.random.default_rng(4).uniform(0.5, 1.5, (len(vertices), 1)), faces


def ball_in_shell() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A ball in a closed shell, 2 % of its radius above it; vertices, faces, middles and normals of the faces."""
    mesh = trimesh.creation.icosphere(3)
    inner, faces = np.array(mesh.vertices), np.array(mesh.faces)
    vertices = np.concatenate([inner, 1.02 * inner])
    faces = np.concatenate([faces, faces + len(inner)])
    return vertices, faces, vertices[faces].mean(1), unit_or(area_vectors(vertices, faces), 0.0)


def random_points(vertices: np.ndarray, faces: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Points inside random faces and the faces' unit normals."""
    rng = np.random.default_rng(8)
    face = rng.integers(len(faces), size=count)
    corners = vertices[faces[face]]
    points = (corners * rng.dirichlet([1, 1, 1], count)[..., None]).sum(1)
    return points, unit_or(area_vectors(vertices, faces), 0.0)[face]


def floor_under_a_ball(scale: float = 1.0) -> tuple[Occluders, np.ndarray, np.ndarray]:
    """Occluders, points on the floor and their normals; a ball of radius 0.7 hangs at height 2."""
    vertices, faces = together(sphere(0.7, (0, 2, 0), 3), plate(9, 0.0))
    points = np.random.default_rng(0).uniform(-3, 3, (300, 3)) * [1, 0, 1]
    return Occluders(vertices * scale, faces), points * scale, np.tile([0, 1.0, 0], (300, 1))


def floor_map() -> tuple[Occluders, np.ndarray, np.ndarray]:
    """A ball over a floor whose points are the texels of a map."""
    across = (TEXEL + 0.5) / SIDE * 6 - 3
    points = np.stack([across[:, 1], np.zeros(len(across)), across[:, 0]], 1)
    return Occluders(*together(plate(9, 0.0), sphere(0.7, (0, 2, 0), 3))), points, np.tile([0, 1.0, 0], (SIDE**2, 1))


def ring_of_lights() -> Lights:
    around = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    places = np.stack([3 * np.cos(around), np.full(12, 4.0), 3 * np.sin(around)], 1)
    return Lights(places, np.linspace(0.5, 2, 12))
