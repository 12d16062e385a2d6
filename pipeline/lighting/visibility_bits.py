"""Visibility of every texel to every light, one bit each.

Traced once per pose, then any pattern costs no rays.

A light's bits say which texels see it. Changing which lights are on, or how bright they are, then is a masked sum
(`irradiance_from_bits`); only moving the mesh or a light calls for new rays. Bits may be kept in files, found again by
what they were traced from, and the code that did: never stale, and safe to delete.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Float64, UInt8

from pipeline.base.code_digest import code_digest
from pipeline.base.files import digest_bytes, read_arrays, write_arrays
from pipeline.lighting.irradiance import IrradianceMap, exact_map, unlit_map
from pipeline.lighting.light_scene import Lights, light_scene
from pipeline.lighting.ray_kernels import add_seen_bits
from pipeline.lighting.shadow_rays import Receivers, light_blocks
from pipeline.lighting.visibility import LIGHT_CLEARANCE, ORIGIN_OFFSET, Occluders

RAY_NS, PAIR_NS, BIT_NS = 130.0, 2.0, 1.5
"""Cost of a shadow ray with its set-up, of adding a light at a point, and of adding it by its bit. Measured on two
cores by benchmarks/bench_irradiance.py, which compares the choice made with them to what each way took."""

FACING = 0.5
"""Share of a closed surface that faces any one light: of a convex one, half (Cauchy's formula averages to the same)."""


@dataclass(frozen=True)
class VisibilityBits:
    """Row j: the points that see light j, packed as np.packbits does. `rays`: what it took to trace."""

    bits: UInt8[np.ndarray, "m bytes"]
    points: int
    rays: int

    def seen(self, light: int) -> np.ndarray:
        """Mask of the points that see a light."""
        return np.unpackbits(self.bits[light], count=self.points).astype(bool)


def trace_bits(
    occluders: Occluders,
    points: Float[np.ndarray, "t 3"],
    face_normals: Float[np.ndarray, "t 3"],
    places: Float64[np.ndarray, "m 3"],
    distant: bool = False,
) -> VisibilityBits:
    """Visibility of all points to all lights, lit or not.

    `places` are their positions, or directions of distant ones.
    """
    points, face_normals, places = (np.ascontiguousarray(a, np.float64) for a in (points, face_normals, places))
    receivers, count = Receivers(points, face_normals), len(points)
    bits, traced = np.zeros((len(places), (count + 7) // 8), np.uint8), 0
    for block in light_blocks(count, len(places)):
        rays = occluders.aim(receivers, places, distant, block=block)
        seen = np.zeros((len(block), count), bool)
        seen[rays.rows[:, 1] - block.start, rays.rows[:, 0]] = occluders.occluded(rays) == -1
        bits[block.start : block.stop], traced = np.packbits(seen, axis=1), traced + len(rays.rows)
    return VisibilityBits(bits, count, traced)


def trace_some_bits(
    occluders: Occluders,
    points: Float[np.ndarray, "t 3"],
    face_normals: Float[np.ndarray, "t 3"],
    places: Float64[np.ndarray, "m 3"],
    some: Bool[np.ndarray, " t"],
) -> UInt8[np.ndarray, "m bytes"]:
    """Bits of `trace_bits` for some points; the others see all lights.

    No ray is traced for those.
    """
    traced = trace_bits(occluders, points[some], face_normals[some], places)
    bits, seen = np.empty((len(places), (len(points) + 7) // 8), np.uint8), np.ones(len(points), bool)
    for light in range(len(places)):
        seen[some] = traced.seen(light)
        bits[light] = np.packbits(seen)
    return bits


def irradiance_from_bits(
    visibility: VisibilityBits,
    occluders: Occluders,
    points: Float[np.ndarray, "t 3"],
    face_normals: Float[np.ndarray, "t 3"],
    lights: Lights,
    normals: Float[np.ndarray, "t 3"] | None = None,
) -> IrradianceMap:
    """The exact map of a pattern, without a ray.

    Args:
        lights: all lights that the bits were traced for, in their order; those at zero are off.
        normals: of the smooth surface, for the cosine; the faces' if not given.
    """
    scene = light_scene(occluders, points, face_normals, lights, normals)
    if scene is None:
        return unlit_map(len(points))
    arrived, cosine_arrived = np.zeros(len(points)), np.zeros(len(points))
    for place, luminance, light in zip(
        scene.lights, scene.luminances, np.flatnonzero(lights.luminances > 0), strict=True
    ):
        add_seen_bits(
            scene.receivers.points, scene.normals, place, luminance, scene.distant, scene.least2,
            visibility.bits[light], arrived, cosine_arrived,
        )  # fmt: skip
    return exact_map(scene, arrived, cosine_arrived, 0, 0)


def bits_are_cheaper(lights: int, lit: list[int], samples: int | None) -> bool:
    """Bits pay for the patterns of one pose.

    Args:
        lights: of the stage, all of which get bits.
        lit: number of lit lights of each pattern.
        samples: lights drawn per texel, or None for all that are lit.
    """
    traced = sum(FACING * RAY_NS * (n if samples is None else samples) + PAIR_NS * n for n in lit)
    cached = FACING * RAY_NS * lights + sum(BIT_NS * n + PAIR_NS * n for n in lit)
    return cached < traced


def visibility_key(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray, places: np.ndarray) -> str:
    """Digest of all that visibility depends on. Points and mesh, lights, the offsets of the rays, and the code here."""
    offsets = np.array([ORIGIN_OFFSET, LIGHT_CLEARANCE])
    parts = [np.ascontiguousarray(array, dtype) for array, dtype in (
        (points, np.float64), (vertices, np.float64), (faces, np.int64), (places, np.float64), (offsets, np.float64)
    )]  # fmt: skip
    content = b"".join(str(part.shape).encode() + part.tobytes() for part in parts)
    return digest_bytes(code_digest(__name__).encode() + content)


def load_bits(folder: Path, key: str) -> VisibilityBits | None:
    """The bits of that key, if they were kept."""
    path = folder / f"{key}.safetensors"
    if not path.is_file():
        return None
    arrays = read_arrays(path)
    return VisibilityBits(arrays["bits"], int(arrays["points"][0]), int(arrays["points"][1]))


def keep_bits(folder: Path, key: str, visibility: VisibilityBits) -> None:
    """Write the bits under their key."""
    counts = np.array([visibility.points, visibility.rays], np.int64)
    write_arrays(folder / f"{key}.safetensors", {"bits": visibility.bits, "points": counts})
