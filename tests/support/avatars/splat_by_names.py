"""Splatting functions called with tensors by name, as tests have them: scenes and cameras are dictionaries there."""

from __future__ import annotations

from collections.abc import Callable

from torch import Tensor

from pipeline.rendering import splat as kernels
from pipeline.rendering import splat_comparison as comparison
from pipeline.rendering import splat_gsplat as gpu
from pipeline.rendering import splat_reference as reference
from pipeline.rendering import supersample
from pipeline.rendering.splat_types import CameraView, Gaussians, SplatOptions, Supersampling

SAMPLING = ("factor", "filter", "filter_std_px")


def by_names(function: Callable) -> Callable:
    """`function` with keywords means, ..., features, R, t, K, width, height, and those of its options."""

    def call(*, R: Tensor, t: Tensor, K: Tensor, width: int, height: int, features: Tensor, **rest):
        gaussians = Gaussians(*(rest.pop(name) for name in ("means", "quaternions", "scales", "opacities")))
        sampling = {name: rest.pop(name) for name in SAMPLING if name in rest}
        arguments = [gaussians, features, CameraView(R, t, K, width, height), SplatOptions(**rest)]
        return function(*arguments, *([Supersampling(**sampling)] if sampling else []))

    return call


splat, splat_reference = by_names(kernels.splat), by_names(reference.splat_reference)
splat_gsplat, splat_supersampled = by_names(gpu.splat_gsplat), by_names(supersample.splat_supersampled)
compare_with_reference = by_names(comparison.compare_with_reference)
