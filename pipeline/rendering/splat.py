"""Differentiable Gaussian splatting.

On the CPU tiled, in parallel, the same numbers on every run; on a GPU by gsplat.

The slow twin that says what it computes is `pipeline.rendering.splat_reference`; the conventions and their constants
are in `pipeline.rendering.splat_conventions`. Tensors on a GPU go to `pipeline.rendering.splat_gsplat`.

Threads: numba's own, `numba.set_num_threads`; one thread per process is best when several processes share the
cores. Start workers by spawn: a child forked after the first parallel region hangs.
"""

from __future__ import annotations

import threading

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.rendering.blending_gradient_kernels import blend_backward
from pipeline.rendering.blending_kernels import blend
from pipeline.rendering.projection_gradient_kernels import project_backward
from pipeline.rendering.projection_kernels import FOOTPRINT_COLUMNS, MOMENT_COLUMNS, TILE, project
from pipeline.rendering.splat_conventions import MIN_DILATION_PX2, Splatted
from pipeline.rendering.splat_types import CameraView, Gaussians, SplatOptions, check_splat_arguments
from pipeline.rendering.tile_kernels import depth_order, list_tiles

ONE_AT_A_TIME = threading.Lock()
"""numba's `workqueue` layer, the only one on some machines, aborts when two Python threads enter parallel regions."""


def splat(
    gaussians: Gaussians, features: Float[Tensor, "g d"], view: CameraView, options: SplatOptions = SplatOptions()
) -> Splatted:
    """Splat Gaussians into one image, with gradients to the Gaussians and their features.

    On the CPU computed in float32, the projection in float64. Gaussians fainter than MIN_ALPHA everywhere (opacity 0:
    culled by the caller) cost next to nothing and have gradient 0. Memory of the backward pass: (d + 7) floats per
    Gaussian and 16 x 16 tile within its bounding box.

    Args:
        gaussians: what is drawn.
        features: blended as they are; any number of channels.
        view: the camera; without gradient.
        options: how the Gaussians are drawn.

    Returns:
        features [h, w, d], alpha [h, w] and depth [h, w]; see `Splatted`.

    Raises:
        ValueError: for lengths or devices that differ, numbers that are not finite, a K with skew.
        InputError: for tensors on a GPU where gsplat is not installed, or with a median depth.
    """
    check_splat_arguments(gaussians, features, view, options)
    if gaussians.means.device.type == "cuda":
        from pipeline.rendering.splat_gsplat import splat_gsplat  # gsplat is only there where a GPU is

        return splat_gsplat(gaussians, features, view, options)
    size = np.array([view.width, view.height], np.float64)
    camera = (*(_float64(a) for a in (view.R, view.t, view.K)), size)
    floats = [tensor.float() for tensor in (*gaussians.named().values(), features)]
    dilation = float(max(options.dilation_px2, MIN_DILATION_PX2))
    modes = (bool(options.compensate_opacity), float(options.near_m), bool(options.median_depth))
    return Splatted(*_Splat.apply(*floats, (*camera, dilation), *modes))


def _float64(tensor: Tensor) -> np.ndarray:
    return np.ascontiguousarray(tensor.detach().numpy(), dtype=np.float64)


class _Splat(torch.autograd.Function):
    """Kernels in the order they run; `view` is (R, t, K, size, dilation) as NumPy arrays."""

    @staticmethod
    def forward(ctx, means, quaternions, scales, opacities, features, view, compensate, near, median):
        gaussians = [a.detach().contiguous().numpy() for a in (means, quaternions, scales, opacities)]
        count = len(means)
        width, height = (int(n) for n in view[3])
        tiles_across, tiles_down = -(-width // TILE), -(-height // TILE)
        footprints, depths = np.zeros((count, FOOTPRINT_COLUMNS)), np.zeros(count)
        tiles = np.empty((count, 4), np.int32)
        with ONE_AT_A_TIME:
            project(*gaussians, *view, compensate, near, footprints, depths, tiles)
            tile_start, entries, slot_start = list_tiles(
                depth_order(depths, tiles[:, 1] >= tiles[:, 0]), tiles, tiles_across, tiles_down
            )
            channels = np.empty((count, features.shape[1] + 1), np.float32)
            channels[:, :-1], channels[:, -1] = features.detach().numpy(), depths
            image = np.empty((height, width, features.shape[1]), np.float32)
            depth, transmittance = np.empty((height, width), np.float32), np.empty((height, width), np.float32)
            ends = np.empty((height, width), np.int32)
            lists = (footprints, channels, tile_start, entries, tiles_across)
            blend(*lists, median, image, depth, transmittance, ends)
        ctx.gaussians, ctx.view, ctx.compensate = gaussians, view, compensate
        ctx.lists, ctx.slots, ctx.pixels = lists, (tiles, slot_start), (transmittance, ends)
        ctx.save_for_backward(means, quaternions, scales, opacities, features)  # complains if changed in place
        images = [torch.from_numpy(array) for array in (image, 1 - transmittance, depth)]
        if median:
            ctx.mark_non_differentiable(images[2])
        return tuple(images)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, grad_features, grad_alpha, grad_depth):
        _ = ctx.saved_tensors
        tiles, slot_start = ctx.slots
        gradients = [np.zeros_like(a) for a in ctx.gaussians]
        footprints, channels = ctx.lists[:2]
        gradients.append(np.zeros((len(channels), channels.shape[1] - 1), np.float32))
        slots = np.zeros((slot_start[-1], channels.shape[1] + MOMENT_COLUMNS), np.float32)
        incoming = (a.contiguous().numpy() for a in (grad_features, grad_depth, grad_alpha))
        with ONE_AT_A_TIME:
            blend_backward(*ctx.lists, tiles, slot_start, *ctx.pixels, *incoming, slots)
            project_backward(*ctx.gaussians, *ctx.view, ctx.compensate, footprints, slot_start, slots, *gradients)
        return *(torch.from_numpy(a) for a in gradients), None, None, None, None
