"""Differentiable pictures of volumetric primitives (Lombardi et al. 2021).

On the CPU tiled, in parallel, the same numbers on every run; on a GPU by torch operations. The slow twin that says what
it computes is `pipeline.rendering.volume_reference`; the conventions are in `pipeline.rendering.volume_conventions`.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float, Float64
from torch import Tensor

from pipeline.rendering.projection_kernels import TILE
from pipeline.rendering.splat import ONE_AT_A_TIME
from pipeline.rendering.splat_conventions import Splatted
from pipeline.rendering.splat_types import CameraView
from pipeline.rendering.tile_kernels import list_tiles
from pipeline.rendering.volume_gradient_kernels import BANDS, POSE_COLUMNS, march_backward
from pipeline.rendering.volume_kernels import march_forward
from pipeline.rendering.volume_types import Volumes, check_march_arguments

CORNERS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])

NEAREST_M = 1e-6
"""A box with a corner nearer to the camera plane, or behind it, is listed for all tiles if not all of it is there."""

MARGIN_PX = 1e-3
"""By which a box's outline is widened before its tiles are listed: rounding then leaves out no ray that touches it."""


MARGIN = 1e-9
"""The same for the spheres around boxes, as a share: far above the rounding of float64, far below any box."""


def march(
    volumes: Volumes, features: Float[Tensor, "b rows columns d"], tinted: tuple[int, ...], view: CameraView,
    step_m: float,
) -> Splatted:  # fmt: skip
    """March rays through boxes into one image, differentiable in all but the camera.

    Args:
        volumes: what is drawn.
        features: of columns of voxels; any number of channels.
        tinted: of each channel, the component of the tint that multiplies it; `volume_types.PLAIN`: none.
        view: the camera; without gradient.
        step_m: between samples of a ray, metres.

    Returns:
        features [h, w, d], alpha [h, w], here in [0, 1], and depth [h, w] along the axis of the camera.

    Raises:
        ValueError: for lengths or devices that differ, numbers that are not finite, negative densities, a K with skew.
    """
    check_march_arguments(volumes, features, tinted, view, step_m)
    if volumes.centers.device.type != "cpu":
        from pipeline.rendering.volume_torch import march_torch

        return march_torch(volumes, features, tinted, view, step_m)
    rotation, K = (tensor.detach().double().contiguous().numpy() for tensor in (view.R, view.K))
    tiles = tiles_of(volumes, view)
    # One array of voxels: a sample finds the four numbers of a corner beside each other.
    voxels = torch.cat([volumes.density[..., None], volumes.tint], -1)
    rest = (np.array(tinted, np.int64), *tiles, rotation, K, float(step_m))
    pose = volumes.map(Tensor.double)  # boxes may be thin: float32 would put a sample elsewhere in them
    around = spheres_of(pose.map(Tensor.detach), view.center.detach().double())
    size = (view.height, view.width)
    return Splatted(*_March.apply(pose.from_world(), pose.centers, voxels, features, around, rest, size))


def tiles_of(volumes: Volumes, view: CameraView) -> tuple[np.ndarray, np.ndarray, int]:
    """Boxes that each tile may see.

    Returns where each tile's begin, their indices, and the tiles across the picture.
    """
    across, down = -(-view.width // TILE), -(-view.height // TILE)
    centers, rotations, sizes = (
        tensor.detach().double().numpy() for tensor in (volumes.centers, volumes.rotations, volumes.half_sizes)
    )
    R, t, K = (tensor.detach().double().numpy() for tensor in (view.R, view.t, view.K))
    corners = centers[:, None] + (CORNERS * sizes[:, None]) @ rotations.transpose(0, 2, 1)
    seen = corners @ R.T + t
    behind = seen[..., 2] < NEAREST_M
    depth = np.where(behind, 1.0, seen[..., 2])
    pixels = seen[..., :2] / depth[..., None] * (K[0, 0], K[1, 1]) + K[:2, 2]
    partly = behind.any(1)
    low, high = pixels.min(1) - MARGIN_PX, pixels.max(1) + MARGIN_PX
    low[partly], high[partly] = 0.0, (view.width, view.height)
    visible = volumes.drawn().numpy() & ~behind.all(1) & (high > 0).all(1) & (low < (view.width, view.height)).all(1)
    low, high = (np.floor(edge.clip(0, (view.width - 1, view.height - 1)) / TILE) for edge in (low, high))
    tiles = np.stack([low[:, 0], high[:, 0], low[:, 1], high[:, 1]], 1).astype(np.int32)
    start, entries, _ = list_tiles(np.flatnonzero(visible), np.where(visible[:, None], tiles, (0, -1, 0, -1)).astype(
        np.int32
    ), across, down)  # fmt: skip
    return start, entries, across


def spheres_of(volumes: Volumes, center: Float64[Tensor, " 3"]) -> Float64[np.ndarray, "b 4"]:
    """Spheres around boxes, as the kernels take them.

    From the camera to their centres, and distance squared less radius squared, metres.
    Radii are a little larger, so that rounding leaves out no ray that touches a box.
    """
    toward, radii = volumes.centers - center, volumes.half_sizes.norm(dim=1)
    outside = toward.square().sum(1) * (1 - MARGIN) - (radii * (1 + MARGIN)).square()
    return torch.cat([toward, outside[:, None]], 1).numpy()


class _March(torch.autograd.Function):
    """Kernels on NumPy arrays, all in float64, so that they are compiled once; pictures in the type of the features."""

    @staticmethod
    def forward(ctx, inverses, centers, voxels, features, spheres, rest, size):
        matrices, voxel_array, columns = (
            a.detach().double().contiguous().numpy() for a in (inverses, voxels, features)
        )
        origins = -np.einsum("bij,bj->bi", matrices, spheres[:, :3])
        image, reached, depth = np.empty((*size, features.shape[3])), np.empty(size), np.empty(size)
        ends, before = np.empty(size, np.int64), np.empty(size)
        with ONE_AT_A_TIME:
            ctx.arguments = (matrices, origins, spheres, voxel_array, columns, *rest)
            march_forward(*ctx.arguments, image, reached, depth, ends, before)
        ctx.pixels = (ends, before)
        ctx.save_for_backward(inverses, centers, voxels, features)  # complains if changed in place
        return tuple(torch.from_numpy(a).to(features.dtype) for a in (image, reached, depth))

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, grad_image, grad_reached, grad_depth):
        inverses, _, voxels, features = ctx.saved_tensors
        of_features, of_voxels = (np.zeros((BANDS, *tensor.shape)) for tensor in (features, voxels))
        of_pose = np.zeros((BANDS, len(inverses), POSE_COLUMNS))
        incoming = (a.double().contiguous().numpy() for a in (grad_image, grad_reached, grad_depth))
        with ONE_AT_A_TIME:
            march_backward(*ctx.arguments, *ctx.pixels, *incoming, of_features, of_voxels, of_pose)
        pose = of_pose.sum(0)
        of_centers = -np.einsum("bij,bi->bj", ctx.arguments[0], pose[:, 9:])
        of_poses = (torch.from_numpy(a) for a in (pose[:, :9].reshape(-1, 3, 3), of_centers))
        found = (torch.from_numpy(a.sum(0)).to(features.dtype) for a in (of_voxels, of_features))
        return *of_poses, *found, None, None, None
