"""Texture coordinates and procedural albedo of the figure.

It has skin, a striped shirt, checked trousers, shoes and a face. The albedo is a function of the rest position, baked
into a texture that only the renderer sees: the template carries coordinates but no colours.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32, Float64, Int64

from pipeline.base.seeds import generator_for
from pipeline.geometry.chart_packing import cut_and_pack
from pipeline.synthesis.skeleton import Skeleton

ATLAS_PADDING = 4
"""Texels between charts at the baked resolution. Bilinear look-ups and 2x minification stay within a chart."""

CHART_ITERATIONS = 4
"""Rounds in which xatlas grows charts anew: more make rounder ones."""

MOTTLE_M, MOTTLE = 0.02, 0.16
"""Shortest wavelength and standard deviation of the figure's brightness variation."""

SKIN = (0.52, 0.30, 0.20)
SHIRT = (0.10, 0.22, 0.45)
SHIRT_STRIPE = (0.70, 0.66, 0.55)
TROUSERS = (0.16, 0.17, 0.12)
TROUSERS_CHECK = (0.34, 0.30, 0.20)
SHOES = (0.35, 0.07, 0.05)
HAIR = (0.07, 0.045, 0.03)
BELT = (0.55, 0.36, 0.10)
EYES = (0.03, 0.03, 0.05)
LIPS = (0.42, 0.10, 0.10)


@dataclass(frozen=True)
class Unwrapped:
    """A mesh cut along texture seams.

    Attributes:
        source: for each vertex, the vertex of the uncut mesh it is a copy of.
        faces: triangles in the order of the uncut mesh.
        uv: texture coordinates, glTF convention (v points down).
    """

    source: Int64[np.ndarray, " u"]
    faces: Int64[np.ndarray, "f 3"]
    uv: Float64[np.ndarray, "u 2"]


def unwrap(vertices: Float64[np.ndarray, "v 3"], faces: Int64[np.ndarray, "f 3"], size: int) -> Unwrapped:
    """Cut the mesh into charts and pack them into a square of `size` texels."""
    cut = cut_and_pack(vertices, faces, size, ATLAS_PADDING, CHART_ITERATIONS)
    return Unwrapped(cut.source.astype(np.int64), cut.faces.astype(np.int64), cut.uv.astype(np.float64))


def albedo_at(
    points: Float64[np.ndarray, "n 3"], owner: Int64[np.ndarray, " n"], skeleton: Skeleton, subject: str
) -> Float32[np.ndarray, "n 3"]:
    """Linear albedo at rest positions (metres), given the joint that mostly moves each point."""
    x, y, z = points.T
    name = np.array(skeleton.names)[owner]
    part = np.char.partition(name.astype(str), "_l")[:, 0]
    part = np.char.partition(part, "_r")[:, 0]
    arm_along = np.abs(x)
    albedo = np.tile(np.array(SKIN), (len(points), 1))

    def paint(where: np.ndarray, color: tuple[float, float, float]) -> None:
        albedo[where] = color

    shirt = np.isin(part, ["spine", "chest", "upper_arm"]) & (arm_along < 0.34)
    paint(shirt, SHIRT)
    on_arm = np.isin(part, ["upper_arm"])
    stripe = np.where(on_arm, np.sin(2 * np.pi * arm_along / 0.055), np.sin(2 * np.pi * y / 0.075))
    paint(shirt & (stripe > 0.35), SHIRT_STRIPE)
    paint(shirt & (np.hypot(x - 0.06, y - 1.27) < 0.045) & (z > 0), BELT)
    trousers = np.isin(part, ["pelvis", "thigh", "shin"]) | (np.isin(part, ["spine"]) & (y < 1.0))
    paint(trousers, TROUSERS)
    angle = np.arctan2(z, np.abs(x) - 0.125)
    check = (np.sin(2 * np.pi * y / 0.11) > 0.2) ^ (np.sin(4 * angle) > 0.2)
    paint(trousers & check, TROUSERS_CHECK)
    paint((np.abs(y - 1.0) < 0.022) & np.isin(part, ["pelvis", "spine"]), BELT)
    paint(np.isin(part, ["foot", "toe"]), SHOES)
    head = np.isin(part, ["head"])
    paint(head & (y > 1.64 + 0.35 * z), HAIR)
    paint(head & (z > 0) & (np.hypot(np.abs(x) - 0.04, y - 1.625) < 0.016), EYES)
    paint(head & (z > 0) & (((x / 0.035) ** 2 + ((y - 1.53) / 0.011) ** 2) < 1), LIPS)
    return (albedo * mottle(points, subject, MOTTLE_M, MOTTLE)[:, None]).clip(0.01, 0.9).astype(np.float32)


def mottle(
    points: Float64[np.ndarray, "n 3"], subject: str, shortest_m: float, deviation: float
) -> Float64[np.ndarray, " n"]:
    """Fine brightness variation about 1, a sum of seeded plane waves.

    Their wavelengths are `shortest_m` to 7.5 times that; the sum has the standard deviation `deviation`.
    """
    random = generator_for(subject, "albedo")
    directions = random.normal(size=(48, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    wavelengths = shortest_m * 7.5 ** random.random(48)
    phases = 2 * np.pi * random.random(48)
    waves = np.sin(points @ (2 * np.pi * directions / wavelengths[:, None]).T + phases)
    return 1.0 + deviation * waves.sum(axis=1) / np.sqrt(24)


def bake(
    unwrapped: Unwrapped, size: int, albedo: Callable[[np.ndarray, np.ndarray], np.ndarray]
) -> Float32[np.ndarray, "size size 3"]:
    """Linear albedo texture, row 0 at v = 0.

    Texels outside the charts repeat the nearest chart's colour.

    Args:
        albedo: linear colours [k, 3] from corners [k, 3] (vertices of the uncut mesh) and barycentric coordinates.
    """
    texel, face, barycentric = rasterize(unwrapped, size)
    texture = np.zeros((size, size, 3), dtype=np.float32)
    covered = np.zeros((size, size), dtype=bool)
    texture[texel[:, 0], texel[:, 1]] = albedo(unwrapped.source[unwrapped.faces[face]], barycentric)
    covered[texel[:, 0], texel[:, 1]] = True
    _, labels = cv2.distanceTransformWithLabels(
        (~covered).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
    )
    color_of_label = np.zeros((labels.max() + 1, 3), dtype=np.float32)
    color_of_label[labels[covered]] = texture[covered]
    return color_of_label[labels]


FACES_TOGETHER = 4096
"""Faces that are rasterized at once: few enough for some ten megabytes of texels."""

SLIVER_TEXELS = 1e-12
"""Twice the area of a triangle, in texels, below which it has none."""


def rasterize(
    unwrapped: Unwrapped, size: int
) -> tuple[Int64[np.ndarray, "k 2"], Int64[np.ndarray, " k"], Float64[np.ndarray, "k 3"]]:
    """Texels (row, column) inside triangles, their triangles, and barycentric coordinates."""
    corners = unwrapped.uv[unwrapped.faces] * size
    blocks = np.array_split(np.arange(len(corners)), max(1, len(corners) // FACES_TOGETHER))
    texels, faces, weights = zip(*(_rasterize(corners, block, size) for block in blocks), strict=True)
    return np.concatenate(texels), np.concatenate(faces), np.concatenate(weights)


def _rasterize(corners: np.ndarray, block: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`rasterize` some faces: all texels of their boxes are tried."""
    low = np.floor(corners[block].min(axis=1) - 0.5).astype(np.int64).clip(0, size - 1)
    high = np.ceil(corners[block].max(axis=1) + 0.5).astype(np.int64).clip(1, size)
    width, height = (high - low).T
    tried = width * height
    within = np.arange(tried.sum()) - np.repeat(np.cumsum(tried) - tried, tried)
    of, width = np.repeat(np.arange(len(block)), tried), np.repeat(width, tried)
    row, column = low[of, 1] + within // width, low[of, 0] + within % width
    a, b, c = corners[block].swapaxes(0, 1)
    area = _cross(b - a, c - a)
    area[np.abs(area) < SLIVER_TEXELS] = np.nan  # A sliver covers no texel.
    center = np.stack([column, row], axis=1) + 0.5
    second, third = (_cross(center - a[of], (c - a)[of]) / area[of], _cross((b - a)[of], center - a[of]) / area[of])
    barycentric = np.stack([1 - second - third, second, third], axis=1)
    inside = (barycentric >= 0).all(axis=1)
    return np.stack([row, column], axis=1)[inside], block[of[inside]], barycentric[inside]


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
