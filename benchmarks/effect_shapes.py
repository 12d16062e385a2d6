"""What the scenes of `benchmarks.effect_scenes` show: meshes that move, their textures, and their parts.

Balls, a head without eyes, and a walking figure, which thresholds of plan_effects were set on; and a ring, two linked
rings and a cup, which none was set on. A part is what may be of another material than the rest; the template names it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from pipeline.synthesis.appearance import Unwrapped, bake, mottle, unwrap
from pipeline.synthesis.figure import build_figure
from pipeline.synthesis.head_shape import head_mesh

TEXTURE_SIZE = 128
BALL_RADIUS_M = 0.15
SMALL_RADIUS_M, APART_M = 0.07, 0.074
"""Of two balls side by side: radius, and how far each middle is from that of the stage. They nearly touch."""

RING_RADIUS_M, TUBE_RADIUS_M = 0.1, 0.045
"""Of a ring: from its middle to that of its tube, and of the tube."""
LINK_RADIUS_M, LINK_TUBE_M = 0.085, 0.03
"""The same of two linked ones, which leave 2.5 cm of air between them."""
CUP_M = ((0.0, -0.12), (0.07, -0.12), (0.11, 0.12), (0.095, 0.12), (0.06, -0.1), (0.0, -0.1))
"""Half a cut through a cup: distances from its axis and heights, from the outside below to the inside."""
SPACING_M = 0.02
"""Between a cup's rings of vertices, that shading varies along its wall."""

BROWN, GREY, WHITE = (0.55, 0.4, 0.3), (0.45, 0.45, 0.45), (0.75, 0.72, 0.68)
"""Linear albedo, which a mottle makes darker and brighter."""


@dataclass(frozen=True)
class Shape:
    """A mesh, its texture, and its vertices (and local joint rotations, if it has joints) over time.

    Attributes:
        parts: name -> faces of it; the template names them.
    """

    faces: np.ndarray
    unwrapped: Unwrapped
    texture: np.ndarray
    at: Callable[[float, str], tuple[np.ndarray, np.ndarray | None]]
    parts: Mapping[str, np.ndarray] = field(default_factory=dict)


def turning(name: str, vertices: np.ndarray, faces: np.ndarray, color: tuple[float, float, float] = BROWN) -> Shape:
    """A rigid thing that turns and shifts as a whole, of mottled colour."""
    unwrapped = unwrap(vertices, faces, TEXTURE_SIZE)

    def albedo(corners: np.ndarray, barycentric: np.ndarray) -> np.ndarray:
        points = np.einsum("kc,kcd->kd", barycentric, vertices[corners])
        return (np.array(color) * mottle(points, name, 0.06, 0.16)[:, None]).clip(0.02, 0.9)

    def at(time_s: float, segment: str) -> tuple[np.ndarray, None]:
        turn = Rotation.from_euler("yx", [40 * np.sin(2 * time_s + (segment == "b")), 10 * np.cos(3 * time_s)], True)
        return turn.apply(vertices) + np.array([0.01 * np.sin(time_s), 0, 0]), None

    return Shape(faces, unwrapped, bake(unwrapped, TEXTURE_SIZE, albedo), at)


def with_part(shape: Shape, name: str, belongs: Callable[[np.ndarray], np.ndarray]) -> Shape:
    """A shape of which the faces whose middles, at rest, fulfil a condition are a part."""
    middles = shape.at(0.0, "a")[0][shape.faces].mean(1)
    return replace(shape, parts={**shape.parts, name: np.flatnonzero(belongs(middles))})


def ball(color: tuple[float, float, float] = BROWN) -> Shape:
    """A sphere."""
    sphere = trimesh.creation.icosphere(3, BALL_RADIUS_M)
    return turning("ball", np.array(sphere.vertices), np.array(sphere.faces, np.int64), color)


def halves() -> Shape:
    """A sphere whose lower half is a part."""
    return with_part(ball(), "lower", lambda middles: middles[:, 1] < 0)


def pair() -> Shape:
    """Two spheres that nearly touch; the one on the left, as the stage has it, is a part."""
    sphere = trimesh.creation.icosphere(3, SMALL_RADIUS_M)
    moved = [sphere.vertices + np.array([side * APART_M, 0.0, 0.0]) for side in (1, -1)]
    faces = np.array(sphere.faces, np.int64)
    shape = turning("pair", np.concatenate(moved), np.concatenate([faces, faces + len(sphere.vertices)]), GREY)
    return replace(shape, parts={"left": np.arange(len(faces))})


def ring() -> Shape:
    """A torus."""
    torus = trimesh.creation.torus(RING_RADIUS_M, TUBE_RADIUS_M, 48, 24)
    return turning("ring", np.array(torus.vertices), np.array(torus.faces, np.int64))


def links() -> Shape:
    """Two tori through one another, as in a chain; the one that stands upright is a part."""
    torus = trimesh.creation.torus(LINK_RADIUS_M, LINK_TUBE_M, 40, 16)
    lying = Rotation.from_euler("x", 90, True).apply(torus.vertices)
    apart = np.array([LINK_RADIUS_M / 2, 0.0, 0.0])
    faces = np.array(torus.faces, np.int64)
    vertices = np.concatenate([torus.vertices + apart, lying - apart])
    shape = turning("links", vertices, np.concatenate([faces, faces + len(torus.vertices)]), GREY)
    return replace(shape, parts={"upright": np.arange(len(faces))})


def cup() -> Shape:
    """An empty cup, bright, so that much of the light inside has come from its wall."""
    corners = np.array(CUP_M)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    fine = np.union1d(along, np.arange(0.0, along[-1], SPACING_M))
    cut = np.stack([np.interp(fine, along, corner) for corner in corners.T], axis=1)
    turned = trimesh.creation.revolve(cut, sections=96)
    upright = Rotation.from_euler("x", -90, True).apply(turned.vertices)
    return turning("cup", upright, np.array(turned.faces, np.int64), WHITE)


def bust() -> Shape:
    """The procedural head's skin, which keeps its face."""
    return turning("bust", *head_mesh(0.012))


def capped() -> Shape:
    """The same, whose upper head is a part, as under a cap."""
    return with_part(bust(), "cap", lambda middles: middles[:, 1] > CAP_ABOVE_M)


CAP_ABOVE_M = 0.04
"""Height above the ears."""


def body() -> Shape:
    """The procedural figure, which walks."""
    figure = build_figure("body", 0.06, 256, 0.25)

    def at(time_s: float, segment: str) -> tuple[np.ndarray, np.ndarray]:
        moment = figure.at(time_s, segment)
        return moment.vertices, moment.truth["joint_rotations"]

    return Shape(figure.faces, figure.unwrapped, figure.texture, at)


def dressed() -> Shape:
    """The same, of which all below the neck is a part."""
    figure, shape = build_figure("body", 0.06, 256, 0.25), body()
    head = figure.skeleton.names.index("head")
    on_head = figure.weights.argmax(1)[shape.faces] == head
    return replace(shape, parts={"clothes": np.flatnonzero(~on_head.all(1))})
