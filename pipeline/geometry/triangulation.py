"""Robust triangulation of many points from many cameras.

Hypotheses from camera pairs, then reweighted refinement.

Observations are normalised image coordinates (`Camera.undistort`), so lens distortion is out of the way; residuals
are normalised coordinates times the focal length: pixels of an undistorted image. Hypotheses are scored as in MSAC
(Torr and Zisserman 2000): a truncated squared residual, so one wrong camera costs the same however wrong it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

from pipeline.base.seeds import generator_for
from pipeline.geometry.cameras import Camera

MAX_PAIRS = 200
"""Camera pairs tried. With 20 % of wrong observations a pair is clean with probability 0.64: a handful would do; many
more are there because a point is seen by some cameras only."""

REFINEMENTS = 10
"""Gauss-Newton steps; the start is within a pixel, where three suffice."""

SMALLEST_SINE2 = 1e-12
"""Squared sine of the angle between two rays, below which their pair gives no hypothesis: rays are good to 1e-12
(undistortion), so the distance is, at this angle, to 1e-6 of it. Noise says much earlier that nothing is known."""

MOST_RELATIVE_SIGMA = 0.2
"""Largest standard deviation of a point, over its distance from the nearest camera that sees it. What has normal errors
is the inverse distance: at 0.2 it is five of them from zero, so that points infinitely far away, of which 3 in ten
million are taken for nearer ones, stay out, and the standard deviation stated for the others means what it says."""

SMALLEST_DEPTH_M = 1e-3
"""Points nearer to a camera's plane than this, or behind it, cannot be seen by it."""


@dataclass(frozen=True)
class Triangulation:
    """Triangulated points; NaN where fewer than two cameras agree.

    Attributes:
        points: world, metres; NaN also where the rays are too near parallel to tell how far away they meet.
        sigma_m: standard deviation per point, root mean square over the three axes, metres.
        inlier: observations within the threshold of their point.
        residual_px: length of the reprojection residual, undistorted pixels; NaN where nothing was observed.
        noise_px: standard deviation of one coordinate of an inlying observation, from the residuals of all points.
    """

    points: Float64[np.ndarray, "points 3"]
    sigma_m: Float64[np.ndarray, " points"]
    inlier: Bool[np.ndarray, "cameras points"]
    residual_px: Float64[np.ndarray, "cameras points"]
    noise_px: float


def triangulate(
    cameras: Sequence[Camera],
    observed: Float64[np.ndarray, "cameras points 2"],
    confidence: Float64[np.ndarray, "cameras points"],
    inlier_px: float,
) -> Triangulation:
    """Triangulate points from normalised coordinates, weighted by `confidence`.

    `observed` is NaN where a point is not seen.
    """
    seen = np.isfinite(observed).all(-1) & (confidence > 0)
    weight = np.where(seen, confidence, 0.0)
    points = _best_hypothesis(cameras, np.where(seen[..., None], observed, 0.0), weight, inlier_px)
    inlier = seen & (reprojection(cameras, observed, points)[0] < inlier_px)
    normal = np.full((len(points), 3, 3), np.nan)
    for _ in range(REFINEMENTS):
        length, residual, jacobian = reprojection(cameras, observed, points)
        inlier = seen & (length < inlier_px)
        w = np.where(inlier, weight, 0.0)
        r, j = np.where(inlier[..., None], residual, 0.0), np.where(inlier[..., None, None], jacobian, 0.0)
        normal = np.einsum("cn,cnia,cnib->nab", w, j, j)
        gradient = np.einsum("cn,cnia,cni->na", w, j, r)
        enough = inlier.sum(0) >= 2
        normal[~enough] = np.nan
        points = np.where(enough[:, None], points, np.nan)
        step = np.linalg.pinv(np.nan_to_num(normal), hermitian=True) @ gradient[..., None]
        points = points - step[..., 0]
    length, residual, _ = reprojection(cameras, observed, points)
    inlier = seen & (length < inlier_px)
    noise_px = _noise(residual, inlier)
    # Not pinv, which takes the direction along nearly parallel rays for known: its eigenvalue is that small.
    axes = np.linalg.eigvalsh(np.nan_to_num(normal))
    with np.errstate(divide="ignore"):
        spread = noise_px**2 / np.maximum(axes, 0) if noise_px else np.zeros_like(axes)
    variance = spread.mean(1)
    finite = np.isfinite(points).all(1) & (inlier.sum(0) >= 2)
    finite &= np.sqrt(spread.max(1)) <= MOST_RELATIVE_SIGMA * _nearest(cameras, points, inlier)
    return Triangulation(
        points=np.where(finite[:, None], points, np.nan),
        sigma_m=np.where(finite, np.sqrt(variance), np.nan),
        inlier=inlier & finite,
        residual_px=np.where(seen, length, np.nan),
        noise_px=noise_px,
    )


def _nearest(cameras: Sequence[Camera], points: np.ndarray, inlier: np.ndarray) -> Float64[np.ndarray, " points"]:
    """Distance of each point from the nearest camera that it is an inlier of, metres."""
    away = np.linalg.norm(points - np.stack([camera.center for camera in cameras])[:, None], axis=-1)
    return np.where(inlier, away, np.inf).min(0)


def _noise(residual: np.ndarray, inlier: np.ndarray) -> float:
    """Standard deviation of one coordinate: median absolute residual, corrected for the three numbers fitted."""
    per_point = inlier.sum(0)
    used = inlier & (per_point >= 3)
    if used.any():
        count = 2.0 * np.broadcast_to(per_point, inlier.shape)[used]
        left = np.abs(residual[used]) / np.sqrt((count - 3) / count)[:, None]
    else:
        # Of the four numbers of two rays, one is left, across their common plane; single coordinates may well be zero.
        pairs = per_point == 2
        left = np.sqrt((np.where(inlier[..., None], residual, 0.0)[:, pairs] ** 2).sum((0, 2)))
    return float(np.median(left) / 0.6744897501960817) if left.size else 0.0  # median of |N(0, 1)|


def reprojection(
    cameras: Sequence[Camera],
    observed: Float64[np.ndarray, "cameras points 2"],
    points: Float64[np.ndarray, "points 3"],
) -> tuple[
    Float64[np.ndarray, "cameras points"],
    Float64[np.ndarray, "cameras points 2"],
    Float64[np.ndarray, "cameras points 2 3"],
]:
    """Reprojection residuals in undistorted pixels: length, vector, and derivative by the point.

    The length is infinite for a point behind the camera.
    """
    rotation, translation = np.stack([c.R for c in cameras]), np.stack([c.t for c in cameras])
    focal = np.stack([np.diag(c.K)[:2] for c in cameras])[:, None]
    in_camera = np.einsum("cij,nj->cni", rotation, points) + translation[:, None]
    depth = in_camera[..., 2:]
    front = depth[..., 0] > SMALLEST_DEPTH_M
    safe = np.where(front[..., None], depth, 1.0)
    projected = in_camera[..., :2] / safe
    residual = focal * (projected - observed)
    length = np.where(front, np.linalg.norm(residual, axis=-1), np.inf)
    jacobian = focal[..., None] / safe[..., None] * (
        rotation[:, None, :2] - projected[..., None] * rotation[:, None, 2:]
    )  # fmt: skip
    return length, residual, jacobian


def camera_pairs(count: int) -> list[tuple[int, int]]:
    """All pairs of cameras, or `MAX_PAIRS` drawn from them with a fixed seed."""
    pairs = [(a, b) for a in range(count) for b in range(a + 1, count)]
    if len(pairs) <= MAX_PAIRS:
        return pairs
    chosen = generator_for("camera_pairs", count).choice(len(pairs), MAX_PAIRS, replace=False)
    return [pairs[i] for i in sorted(chosen)]


def _best_hypothesis(
    cameras: Sequence[Camera], observed: np.ndarray, weight: np.ndarray, inlier_px: float
) -> Float64[np.ndarray, "points 3"]:
    """Per point, the two-camera midpoint with the least truncated residual over all cameras."""
    count = observed.shape[1]
    best, best_cost = np.full((count, 3), np.nan), np.full(count, np.inf)
    homogeneous = np.concatenate([observed, np.ones((*observed.shape[:2], 1))], -1)
    rays = np.stack([h @ c.R for h, c in zip(homogeneous, cameras, strict=True)])
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    for a, b in camera_pairs(len(cameras)):
        usable = np.flatnonzero((weight[a] > 0) & (weight[b] > 0))
        points = _midpoint(cameras[a].center, rays[a, usable], cameras[b].center, rays[b, usable])
        length = reprojection(cameras, observed[:, usable], np.nan_to_num(points))[0]
        cost = (weight[:, usable] * np.minimum(length / inlier_px, 1.0) ** 2).sum(0)
        cost = np.where(np.isfinite(points).all(1), cost, np.inf)
        better = cost < best_cost[usable]
        best[usable[better]], best_cost[usable[better]] = points[better], cost[better]
    return best


def _midpoint(center_a: np.ndarray, rays_a: np.ndarray, center_b: np.ndarray, rays_b: np.ndarray) -> np.ndarray:
    """Midpoints of the shortest segment between two rays [N, 3]; NaN for rays nearly parallel."""
    between = center_b - center_a
    cosine = (rays_a * rays_b).sum(-1)
    sine2 = (np.cross(rays_a, rays_b) ** 2).sum(-1)  # 1 - cosine^2 would lose half of the digits.
    safe = np.where(sine2 < SMALLEST_SINE2, np.nan, sine2)
    along_a, along_b = rays_a @ between, rays_b @ between
    s = (along_a - cosine * along_b) / safe
    t = (cosine * along_a - along_b) / safe
    return 0.5 * (center_a + s[:, None] * rays_a + center_b + t[:, None] * rays_b)
