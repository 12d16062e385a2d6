"""Posed balls with texels, lights on a dome, and the rays between them, for measurements of irradiance."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import trimesh
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from scipy.spatial import KDTree

from pipeline.geometry.texel_surface import texel_surface
from pipeline.geometry.texels import Atlas
from pipeline.lighting.irradiance import IrradianceMap, Samples, draw_lights
from pipeline.lighting.irradiance import trace_irradiance as trace
from pipeline.lighting.light_sampling import pattern_numbers
from pipeline.lighting.light_scene import Lights, light_scene
from pipeline.lighting.shadow_rays import Rays, light_blocks
from pipeline.lighting.standard_error import TexelBlocks
from pipeline.lighting.visibility import Occluders

SUBDIVISIONS = 5
"""Of the icosahedron: 20,480 faces, a body's template."""


@dataclass(frozen=True)
class Pose:
    """A dented ball, and points spread over it row by row as the texels of a chart are: each in a face's middle."""

    vertices: np.ndarray
    atlas: Atlas
    points: np.ndarray
    face_normals: np.ndarray

    @property
    def faces(self) -> np.ndarray:
        return self.atlas.faces

    def occluders(self) -> Occluders:
        return Occluders(self.vertices, self.faces)


def make_pose(side: int, phase: float = 0.0) -> Pose:
    """`side` squared texels; `phase` moves the dents from frame to frame."""
    ball = trimesh.creation.icosphere(SUBDIVISIONS)
    unit, faces = np.array(ball.vertices), np.array(ball.faces)
    vertices = unit * (1 + 0.3 * np.sin(5 * unit + phase).prod(1, keepdims=True)) * [0.5, 0.9, 0.4]
    height = 1 - 2 * (np.arange(side * side) + 0.5) / (side * side)
    around = np.arange(side * side) * (2 * np.pi / side)
    toward = np.stack([np.sqrt(1 - height**2) * np.cos(around), height, np.sqrt(1 - height**2) * np.sin(around)], 1)
    face = KDTree(unit[faces].mean(1)).query(toward)[1]
    texel = np.stack(np.divmod(np.arange(side * side), side), 1).astype(np.int32)
    thirds, none = np.full((len(face), 3), 1 / 3, np.float32), np.zeros((len(faces), 3, 2), np.float32)
    atlas = Atlas(
        side, faces.astype(np.int32), none, np.arange(len(vertices), dtype=np.int32), unit.astype(np.float32), texel,
        face.astype(np.int32), thirds, np.zeros(len(face), np.int32), np.zeros_like(thirds),
    )  # fmt: skip
    points, _, normals = texel_surface(atlas, vertices)
    return Pose(vertices, atlas, points, normals)


def dome(count: int) -> Lights:
    """Lights spread evenly over a sphere of 2.4 m, of one brightness."""
    height = 1 - 2 * (np.arange(count) + 0.5) / count
    around = np.arange(count) * np.pi * (3 - np.sqrt(5))
    across = np.sqrt(1 - height**2)
    return Lights(2.4 * np.stack([across * np.cos(around), height, across * np.sin(around)], 1), np.ones(count))


@functools.cache
def blocks_of(side: int) -> TexelBlocks:
    """Where the texels of a map lie: known once for all frames."""
    return TexelBlocks(np.stack(np.divmod(np.arange(side * side), side), 1).astype(np.int32))


def trace_map(pose: Pose, occluders: Occluders, lights: Lights, samples: int | None) -> IrradianceMap:
    """Ray set-up, tracing and reduction."""
    drawn = None
    if samples is not None:
        drawn = Samples(samples, "power", "low_discrepancy", blocks_of(pose.atlas.size), np.random.default_rng(0))
    return trace(occluders, pose.points, pose.face_normals, lights, samples=drawn)


@dataclass(frozen=True)
class ReadyRays:
    """A pose's rays made beforehand, and the scene of embreex that answers them.

    Attributes:
        occluders: of the same pose, ours.
    """

    occluders: Occluders
    scene: EmbreeScene
    rays: list[Rays]

    @property
    def count(self) -> int:
        """Number of rays."""
        return sum(len(some.rows) for some in self.rays)

    def answers(self) -> list[np.ndarray]:
        """embreex's answer per ray: -1 where it meets nothing."""
        return [
            self.scene.run(some.origins, some.directions, dists=some.lengths, query="OCCLUDED") for some in self.rays
        ]


def ready_rays(pose: Pose, lights: Lights, samples: int | None, robust: bool = True) -> ReadyRays:
    """The rays that `trace_map` traces; embreex's scene without `robust` may let rays slip between two faces."""
    occluders, scene = pose.occluders(), EmbreeScene(robust=robust)
    TriangleMesh(scene, occluders.scaled(pose.vertices).astype(np.float32), pose.faces)
    return ReadyRays(occluders, scene, rays_of(pose, occluders, lights, samples))


def rays_of(pose: Pose, occluders: Occluders, lights: Lights, samples: int | None) -> list[Rays]:
    """The rays that `trace_map` traces."""
    scene = light_scene(occluders, pose.points, pose.face_normals, lights, None)
    aim = occluders.aim
    if samples is None:
        blocks = light_blocks(len(pose.points), len(scene.lights))
        return [aim(scene.receivers, scene.lights, block=block) for block in blocks]
    rng, rays = np.random.default_rng(0), []
    for n in range(samples):
        uniform = (n + pattern_numbers("low_discrepancy", pose.atlas.texel, rng)) / samples
        chosen, _ = draw_lights(scene, "power", uniform)
        rays.append(aim(scene.receivers, scene.lights, chosen=chosen))
    return rays
