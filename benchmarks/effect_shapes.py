"""What the scenes of `benchmarks.effect_scenes` show: meshes that move, their textures, and their parts.

Balls, a head without eyes, and a walking figure. A part is what may be of another material than the rest; the template
names it.
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

BROWN, GREY = (0.55, 0.4, 0.3), (0.45, 0.45, 0.45)
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
