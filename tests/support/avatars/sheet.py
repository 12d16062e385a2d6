"""A flat square sheet as atlas, and its analytic picture under a point light."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pipeline.capture.records import FrameRecord, ImageRecord
from pipeline.geometry.texels import Atlas

SIDE_M = 0.4
"""The sheet spans [-SIDE/2, SIDE/2]^2 in the plane z = 0 and faces +z."""


def make_sheet(size: int) -> Atlas:
    """Two triangles that fill the whole map; row 0 (v = 0) is at the top, y = +SIDE / 2."""
    half = SIDE_M / 2
    corners = np.array([[-half, half, 0], [half, half, 0], [half, -half, 0], [-half, -half, 0]], np.float32)
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
    faces = np.array([[0, 2, 1], [0, 3, 2]], np.int32)
    row, column = np.mgrid[:size, :size].reshape(2, -1)
    u, v = (column + 0.5) / size, (row + 0.5) / size
    upper = u >= v  # face 0 has the corners (0, 0), (1, 1), (1, 0)
    barycentric = np.where(upper[:, None], np.stack([1 - u, v, u - v], 1), np.stack([1 - v, v - u, u], 1))
    tangent_weights = np.where(upper[:, None], [-1.0, 0, 1], [0, -1.0, 1])
    return Atlas(
        size=size, faces=faces, uv=uv[faces], weld=np.arange(4, dtype=np.int32), rest_vertices=corners,
        texel=np.stack([row, column], 1).astype(np.int32), face=np.where(upper, 0, 1).astype(np.int32),
        barycentric=barycentric.astype(np.float32), chart=np.zeros(size * size, np.int32),
        tangent_weights=tangent_weights.astype(np.float32),
    )  # fmt: skip


def labelled(sheet: Atlas) -> Atlas:
    """The same, whose right half is a region of the name `cloth`."""
    x = sheet.rest_vertices[:, 0]
    return replace(sheet, regions={"cloth": np.flatnonzero(np.median(x) <= x)})


def make_frame(atlas: Atlas, lights: np.ndarray, intensities: np.ndarray, number: int = 0) -> FrameRecord:
    """The sheet at rest, all of it lit."""
    return FrameRecord(
        frame=number, segment="a", fully_lit=True, vertices=atlas.rest_vertices,
        irradiance=np.ones(atlas.texel_count, np.float32),
        cosine_visibility=np.ones(atlas.texel_count, np.float32), light_positions=np.asarray(lights, np.float32),
        light_intensities=np.asarray(intensities, np.float32),
    )  # fmt: skip


def make_image(frame: FrameRecord, albedo: np.ndarray, shift_x: float = 0.0, pixels: int = 24) -> ImageRecord:
    """Analytic image of a Lambertian sheet by a camera at z = 1 m that looks along -z.

    The sheet shows albedo / pi * sum of I cos / d^2, evaluated at each pixel's centre.
    """
    R = np.diag([1.0, -1.0, -1.0])
    center = np.array([shift_x, 0.0, 1.0])
    focal = 1.4 * pixels
    K = np.array([[focal, 0, pixels / 2], [0, focal, pixels / 2], [0, 0, 1]])
    y, x = np.mgrid[:pixels, :pixels] + 0.5
    points = np.stack([center[0] + (x - pixels / 2) / focal, -(y - pixels / 2) / focal, np.zeros_like(x)], -1)
    mask = (np.abs(points[..., :2]) < SIDE_M / 2).all(-1)
    to_light = frame.light_positions[:, None, None] - points
    distance = np.linalg.norm(to_light, axis=-1)
    falloff = to_light[..., 2].clip(0) / distance**3
    radiance = np.einsum("lhw,lc->hwc", falloff, frame.light_intensities) * albedo / np.pi
    return ImageRecord(
        camera=f"x{shift_x}", frame=frame.frame, test_camera=False, test_frame=False, test_segment=False,
        test_pattern=False,
        fully_lit=True, x0=0, y0=0, width=pixels, height=pixels, image=(radiance * mask[..., None]).astype(np.float32),
        mask=mask.astype(np.float32), K=K, R=R, t=-R @ center,
    )  # fmt: skip
