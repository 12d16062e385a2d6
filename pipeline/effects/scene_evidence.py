"""Evidence for effects of geometry, light and cameras: cheap measurements without images."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import numpy as np
from jaxtyping import Float, Float64, Int64
from scipy.spatial.transform import Rotation

from pipeline.base.color import POLYNOMIALS
from pipeline.base.errors import InputError
from pipeline.base.files import read_json
from pipeline.effects.appearance_evidence import FEWEST_OBSERVATIONS, Evidence
from pipeline.effects.light_evidence import PosedFrame, facing_pairs, falloff_spread
from pipeline.geometry.cameras import Camera
from pipeline.geometry.rotations import (
    conjugate_quaternion,
    multiply_quaternions,
    quaternion_from_matrix,
    rotation_vector_from_quaternion,
)
from pipeline.geometry.texels import Atlas, texel_frames
from pipeline.geometry.tracked import TrackedChunk

PERCENTILE = 95.0
"""Evidence is taken at this percentile, not the maximum: one frame tracked badly must not switch an effect on."""

GRID = 33
"""Points per image side at which distortion is evaluated, corners included: it is smooth, and largest at the
corners."""

SURFACE_FRAMES, SURFACE_TEXELS = 32, 1024
"""Frames and texels at which the surface of a template without joints is looked at, evenly spread."""


def shadow_evidence(
    atlas: Atlas, frames: list[PosedFrame], local_radius_percent: float, rays: int, random: np.random.Generator,
    regions: Mapping[str, Int64[np.ndarray, " _"]] = MappingProxyType({}),
) -> Evidence:  # fmt: skip
    """Share, in percent, of facing texel-light pairs that a distant surface blocks.

    Args:
        regions: texels of each part of the surface that is judged by itself, too.
    """
    if not frames:
        return Evidence(0.0, "no tracked frame has a light on")
    extent = float(np.ptp(atlas.rest_vertices, axis=0).max())
    radius = local_radius_percent / 100 * extent
    pairs = facing_pairs(atlas, frames, radius, -(-rays // len(frames)), random)
    facing = len(pairs.texels)
    share = float(pairs.blocked.sum()) / max(facing, 1)
    error = np.sqrt(share * (1 - share) / max(facing, 1))
    text = (
        f"{100 * share:.2f} % (standard error {100 * error:.2f}) of {facing} facing texel-light pairs in {len(frames)} "
        f"frames are blocked by a surface further than {1e3 * radius:.0f} mm"
    )
    inside = {name: pairs.blocked[np.isin(pairs.texels, texels)] for name, texels in regions.items()}
    of_regions = {
        name: 100 * float(blocked.mean()) if len(blocked) >= FEWEST_OBSERVATIONS else 100 * share
        for name, blocked in inside.items()
    }
    return Evidence(100 * share, text, of_regions, "%")


def near_field_evidence(atlas: Atlas, frames: list[PosedFrame], rays: int, random: np.random.Generator) -> Evidence:
    """Change of I / d^2 over the subject against its centre, in percent."""
    if not frames:
        return Evidence(0.0, "no tracked frame has a light on")
    spread = 100 * falloff_spread(atlas, frames, -(-rays // len(frames)), random, PERCENTILE)
    text = f"{PERCENTILE:g} % of the light arriving at texels is within {spread:.1f} % of that at the subject's centre"
    return Evidence(spread, text)


def articulation_evidence(chunks: Sequence[TrackedChunk], atlas: Atlas) -> Evidence:
    """Spread of local rotations around their means, in degrees.

    Of the liveliest joint, or of the surface where the template has no joints.
    """
    if any(chunk.joint_rotations is None or not chunk.joint_rotations.shape[1] for chunk in chunks):
        return surface_articulation(np.concatenate([chunk.vertices for chunk in chunks]), atlas)
    spreads = rotation_spread_deg(np.concatenate([chunk.joint_rotations for chunk in chunks]))
    joint = int(spreads.argmax())
    spread = float(spreads[joint])
    text = f"{PERCENTILE:g} % of rotations of joint {joint}, the liveliest, are within {spread:.1f} degrees of its mean"
    return Evidence(spread, text)


def surface_articulation(vertices: Float[np.ndarray, "frames v 3"], atlas: Atlas) -> Evidence:
    """Root mean square turn of tangent frames against the whole body, degrees (Kabsch 1976)."""
    some = np.unique(np.linspace(0, len(vertices) - 1, SURFACE_FRAMES).astype(int))
    texels = np.unique(np.linspace(0, atlas.texel_count - 1, SURFACE_TEXELS).astype(int))
    rest = atlas.rest_vertices.astype(np.float64)
    rest -= rest.mean(0)
    turned = []
    for mesh in vertices[some].astype(np.float64):
        body = Rotation.align_vectors(rest, mesh - mesh.mean(0))[0].as_matrix()
        turned.append(quaternion_from_matrix(body @ texel_frames(atlas, mesh)[1][texels]))
    spread = float(np.sqrt((rotation_spread_deg(np.stack(turned)) ** 2).mean()))
    text = (
        f"the template has no joints; {PERCENTILE:g} % of rotations of a part of its surface are within {spread:.1f} "
        "degrees of its mean"
    )
    return Evidence(spread, text)


def rotation_spread_deg(rotations: Float[np.ndarray, "frames joints 4"]) -> Float64[np.ndarray, " joints"]:
    """Percentile of the angle between each joint's rotations and their mean, degrees.

    The mean is the eigenvector of the largest eigenvalue of sum q q^T (Markley et al. 2007, Averaging Quaternions),
    blind to the sign of q.
    """
    q = rotations.astype(np.float64)
    mean = np.linalg.eigh(np.einsum("fji,fjk->jik", q, q))[1][..., -1]
    away = rotation_vector_from_quaternion(multiply_quaternions(conjugate_quaternion(mean), q))
    return np.percentile(np.degrees(np.linalg.norm(away, axis=-1)), PERCENTILE, axis=0)


def distortion_evidence(cameras: dict[str, Camera], downsample: float) -> Evidence:
    """Largest displacement by lens distortion inside any image, in pixels of the images used."""
    sizes = {name: largest_displacement_px(camera) / downsample for name, camera in cameras.items()}
    worst = max(sizes, key=lambda name: sizes[name])
    text = f"the lens of {worst} moves a point of the image by up to {sizes[worst]:.2f} image pixels"
    return Evidence(sizes[worst], text)


def largest_displacement_px(camera: Camera) -> float:
    """Largest distance between a pinhole's and this lens's image of a point, camera pixels."""
    x, y = np.meshgrid(np.linspace(0, camera.width, GRID), np.linspace(0, camera.height, GRID))
    pinhole = np.stack([x, y, np.ones_like(x)], -1).reshape(-1, 3)
    in_camera = np.linalg.solve(camera.K, pinhole.T).T
    pixels, _ = camera.project((in_camera - camera.t) @ camera.R)
    return float(np.linalg.norm(pixels - pinhole[:, :2], axis=1).max())


def read_colors(path: Path) -> dict[str, Float64[np.ndarray, "3 columns"]]:
    """Corrected-from-raw of each camera that has one (`corrected`).

    Raises:
        InputError: naming all cameras without a matrix of finite numbers.
    """
    matrices = {name: np.array(matrix, np.float64) for name, matrix in read_json(path).get("cameras", {}).items()}
    wrong = sorted(
        name
        for name, matrix in matrices.items()
        if matrix.shape not in [(3, columns) for columns in POLYNOMIALS] or not np.isfinite(matrix).all()
    )
    if wrong:
        raise InputError(
            f"{path}: cameras {wrong}: expected 3 rows of 3 finite numbers, 4, or a polynomial's, found others; run "
            "calibrate_color again"
        )
    return matrices


def color_evidence(path: Path) -> Evidence:
    """Largest deviation of a camera's colour matrix from the identity, in percent."""
    sizes = {name: 100 * float(np.abs(m - np.eye(*m.shape)).max()) for name, m in read_colors(path).items()}
    if not sizes:
        return Evidence(0.0, "no camera has a colour matrix")
    worst = max(sizes, key=lambda name: sizes[name])
    return Evidence(
        sizes[worst], f"the colour matrix of {worst} departs from the identity by up to {sizes[worst]:.2f} %"
    )
