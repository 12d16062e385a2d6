"""Depth of the point that a pixel shows, the surface of deferred shading (RFGCA 11-12).

"expected": the splatted depth, sum of w_i z_i. A pixel that is covered in part seems too near, up to the camera itself.
"normalised": the same divided by alpha; between a limb and what is behind it, a mean of both.
"median": the depth at which half of the light is gone; never between two surfaces, but in steps of one Gaussian.
"traced": the posed mesh's, as a ray through the pixel's centre hits it first. Where it misses: as "normalised".

Against the true surface of the synthesised subjectA, those of its avatar are off by 61, 4.1, 3.9 and 1.0 mm (median;
`python -m benchmarks.bench_depth`): "traced", the default, takes a ms or two a picture.

The depth only says where the pixel's point is; sharpening it is not the lobe's business, so none has a gradient.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from pipeline.config.trained_model import DepthSource
from pipeline.geometry.cameras import Camera
from pipeline.geometry.depth_maps import draw_depth
from pipeline.rendering.splat_conventions import MIN_ALPHA, Splatted
from pipeline.rendering.splat_types import CameraView


@torch.no_grad()
def depth_of_pixels(
    source: DepthSource, picture: Splatted, mesh: tuple[np.ndarray, np.ndarray] | None, camera: CameraView
) -> Float[Tensor, "h w"]:
    """Camera depth of every pixel in metres; where nothing is drawn, 0.

    Args:
        picture: with the median depth for "median".
        mesh: posed vertices [V, 3] in metres and faces [F, 3], for "traced".
    """
    if source == "expected":
        return picture.depth.detach()
    depth = picture.depth / picture.alpha.clamp_min(MIN_ALPHA)
    if source != "traced":
        return depth
    height, width = depth.shape
    tensors = (camera.R, camera.K, camera.center)
    R64, K64, center64 = (a.detach().cpu().numpy().astype(np.float64) for a in tensors)
    traced = Camera(R=R64, t=-R64 @ center64, K=K64, dist=np.zeros(5), width=width, height=height)
    surface = torch.as_tensor(draw_depth(traced, *mesh), dtype=depth.dtype, device=depth.device)
    return torch.where(torch.isfinite(surface), surface, depth)


def points_of_pixels(
    row: Int[Tensor, " pixels"], column: Int[Tensor, " pixels"], depth: Float[Tensor, " pixels"], camera: CameraView
) -> Float[Tensor, "pixels 3"]:
    """World points, metres, at the given depths along the axis of the camera."""
    K = camera.K
    x, y = (column + 0.5 - K[0, 2]) / K[0, 0], (row + 0.5 - K[1, 2]) / K[1, 1]
    return depth[:, None] * torch.stack([x, y, torch.ones_like(depth)], -1) @ camera.R + camera.center
