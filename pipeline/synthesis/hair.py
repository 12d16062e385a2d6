"""Hair of the procedural head: strands that grow out of the skull, combed back over it.

The template's surface is the outside of the hair, as a coarse mesh that is tracked has it. In pictures the skull lies
deeper, and strands fill what is between; some stand out. A strand is as thick as a lock of thirty hairs, for images in
which a hair is a hundredth of a pixel.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float64, Int64
from scipy.spatial import cKDTree

from pipeline.base.seeds import generator_for
from pipeline.synthesis.head_appearance import hair_share
from pipeline.synthesis.mitsuba_scenes import coated_mesh
from pipeline.synthesis.subject import Strands, vertex_normals

DEPTH_M = 0.008
"""Thickness of the layer of hair: what the skull lies below the template."""

ROOT_M = 0.002
"""Depth of a root below the skull."""

RADIUS_M = 0.0005

STEPS, STEP_M = 7, 0.006
"""Pieces of a strand and their length: 42 mm."""

TOP_M = 0.010
"""Mean height above the skull at which a strand goes on along it, 2 mm beyond the template."""

WAVE_M, WAVE_STEPS = 0.0015, 3.0
"""Amplitude of a strand's waves, and their length in steps."""

COMBED = np.array([0.0, -0.35, -1.0])
"""Direction that hair is combed in, before it bends around the skull: back and a little down."""

COLOR, GLOSS_ALPHA = (0.30, 0.17, 0.08), 0.2
"""Linear albedo of a strand, light brown, and the width of its gloss."""

SIDES = 4
"""Of a tube, whose normals are smooth: a strand is half a pixel wide."""


def skull(vertices: Float64[np.ndarray, "v 3"], faces: Int64[np.ndarray, "f 3"]) -> Float64[np.ndarray, "v 3"]:
    """The skin below the hair: vertices at rest, moved in where hair grows."""
    return vertices - DEPTH_M * hair_share(vertices)[:, None] * vertex_normals(vertices, faces)


def grow(
    subject: str, count: int, vertices: Float64[np.ndarray, "v 3"], faces: Int64[np.ndarray, "f 3"]
) -> Float64[np.ndarray, "strands points 3"]:
    """Strands at rest, metres, their roots first; equal arguments give equal hair.

    Args:
        vertices, faces: the skin of the template.
    """
    random, inner = generator_for(subject, "hair"), skull(vertices, faces)
    normals, tree = vertex_normals(inner, faces), cKDTree(inner)
    points = _roots(random, count, vertices, inner, faces)
    height = np.maximum(random.normal(TOP_M, 0.2 * TOP_M, count), 0.2 * TOP_M)[:, None]
    phase, side = random.uniform(0, 2 * np.pi, count), random.normal(0, 0.25, (count, 3))
    strands = [points - ROOT_M * normals[tree.query(points)[1]], points]
    for step in range(STEPS):
        nearest = tree.query(points)[1]
        normal = normals[nearest]
        above = ((points - inner[nearest]) * normal).sum(1, keepdims=True)
        along = COMBED + side
        along = _unit(along - (along * normal).sum(1, keepdims=True) * normal)
        points = points + STEP_M * _unit(along + np.clip((height - above) / STEP_M, -1.0, 1.5) * normal)
        wave = WAVE_M * np.sin(phase + 2 * np.pi * step / WAVE_STEPS)[:, None]
        strands.append(points + wave * np.cross(normal, along))
    return np.stack(strands, 1)


def _roots(
    random: np.random.Generator, count: int, outer: np.ndarray, inner: np.ndarray, faces: np.ndarray
) -> np.ndarray:
    """Points drawn evenly over the skull where hair grows."""
    corners = inner[faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    weight = area * hair_share(outer[faces].mean(1))
    chosen = random.choice(len(faces), count, p=weight / weight.sum())
    one, two = np.sort(random.random((2, count)), axis=0)
    shares = np.stack([one, two - one, 1 - two], 1)
    return np.einsum("nc,ncd->nd", shares, corners[chosen])


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-12)


def tubes(
    strands: Strands,
) -> tuple[Float64[np.ndarray, "v 3"], Float64[np.ndarray, "v 3"], Int64[np.ndarray, "f 3"]]:
    """Open tubes along the strands: vertices, unit normals, faces outward."""
    points = strands.points
    count, length = points.shape[:2]
    along = _unit(np.gradient(points, axis=1).reshape(-1, 3))
    # No strand goes along the axis that it follows least.
    least = np.abs(along).reshape(count, length, 3).mean(1).argmin(1)
    aside = np.repeat(np.eye(3)[least], length, axis=0)
    across = _unit(np.cross(along, aside))
    turns = 2 * np.pi * np.arange(SIDES) / SIDES
    normals = np.cos(turns)[:, None] * across[:, None] + np.sin(turns)[:, None] * np.cross(along, across)[:, None]
    vertices = points.reshape(-1, 1, 3) + strands.radius_m * normals
    ring = np.arange(count * length).reshape(count, length)[:, :-1].reshape(-1, 1) * SIDES
    here, next_ = ring + np.arange(SIDES), ring + np.roll(np.arange(SIDES), -1)
    faces = [np.stack([here, next_, here + SIDES], -1), np.stack([next_, next_ + SIDES, here + SIDES], -1)]
    return vertices.reshape(-1, 3), normals.reshape(-1, 3), np.concatenate(faces).reshape(-1, 3)


def hair_mesh(strands: Strands) -> Any:
    """Mitsuba's mesh of the strands."""
    vertices, normals, faces = tubes(strands)
    color = np.array(COLOR, np.float32).reshape(1, 1, 3)
    return coated_mesh(color, GLOSS_ALPHA, vertices, normals, faces, np.zeros((len(vertices), 2)))
