"""Normals, rays of lenses, shadow rays and footprints, as they are usually written."""

from __future__ import annotations

import math

import cv2
import numpy as np
import torch
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from torch import Tensor

from pipeline.rendering.splat_conventions import MAX_ALPHA, MIN_ALPHA

NAIVE_OFFSET_M = 1e-4


def naive_normal(corners: Tensor) -> Tensor:
    """Unit normal of a triangle [3, 3] by PyTorch's own division, which keeps zero from being divided by zero."""
    return torch.nn.functional.normalize(torch.linalg.cross(corners[1] - corners[0], corners[2] - corners[0]), dim=0)


def opencv_rays(pixels: np.ndarray, K: np.ndarray, terms: np.ndarray) -> np.ndarray:
    """Unit rays by cv2.fisheye, whose first pixel centre is (0, 0): it knows a pinhole's only, up to 90 degrees."""
    K = K - [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]
    xy = cv2.fisheye.undistortPoints((pixels - 0.5)[:, None], K, np.array(terms))[:, 0]
    rays = np.concatenate([xy, np.ones((len(xy), 1))], 1)
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def naive_visible(
    vertices: np.ndarray, faces: np.ndarray, points: np.ndarray, normals: np.ndarray, light: np.ndarray,
    offset: float = NAIVE_OFFSET_M,
) -> np.ndarray:  # fmt: skip
    """Mask of points that see the light: the mesh as it is, rays that start a tenth of a millimetre above it."""
    scene = EmbreeScene(robust=True)
    TriangleMesh(scene, vertices.astype(np.float32), faces.astype(np.int32))
    origins = points + offset * normals
    ways = light - origins
    lengths = np.linalg.norm(ways, axis=1)
    hits = scene.run(
        origins.astype(np.float32), (ways / lengths[:, None]).astype(np.float32), dists=lengths.astype(np.float32),
        query="OCCLUDED",
    )  # fmt: skip
    return (hits == -1) & (((light - points) * normals).sum(1) > 0)


def naive_alphas(
    size: int, opacity: float, scales_px: tuple[float, float], degrees: float, dilation: float,
    dtype: torch.dtype = torch.float32,
) -> Tensor:  # fmt: skip
    """Alphas [size, size] of a Gaussian in the middle: its covariance multiplied out, inverted by its determinant."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    V = torch.tensor([[c, -s], [s, c]], dtype=dtype)
    cov = V @ torch.diag(torch.tensor(scales_px, dtype=dtype).square()) @ V.T + dilation * torch.eye(2, dtype=dtype)
    determinant = cov[0, 0] * cov[1, 1] - cov[0, 1] ** 2
    y, x = torch.meshgrid(*[torch.arange(size, dtype=dtype) + 0.5 - size / 2] * 2, indexing="ij")
    q = (cov[1, 1] * x * x - 2 * cov[0, 1] * x * y + cov[0, 0] * y * y) / determinant
    alphas = opacity * torch.exp(-q / 2)
    return torch.where(alphas >= MIN_ALPHA, alphas.clamp(max=MAX_ALPHA), torch.where(alphas.isnan(), alphas, 0.0))
