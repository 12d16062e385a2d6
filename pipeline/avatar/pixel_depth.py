"""How far away the point is that a pixel shows: what deferred shading takes for the surface (RFGCA 11-12).

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
from jaxtyping import Float
from torch import Tensor

from pipeline.config.train_avatar import DepthSource
from pipeline.geometry.cameras import Camera
from pipeline.geometry.depth_maps import draw_depth
from pipeline.rendering.splat_conventions import MIN_ALPHA, Splatted


@torch.no_grad()
def depth_of_pixels(
    source: DepthSource,
    picture: Splatted,
    mesh: tuple[np.ndarray, np.ndarray] | None,
    R: Float[Tensor, "3 3"],
    center: Float[Tensor, "3"],
    K: Float[Tensor, "3 3"],
) -> Float[Tensor, "h w"]:
    """Camera depth of every pixel in metres; where nothing is drawn, 0.

    Args:
        picture: with the median depth for "median".
        mesh: posed vertices [V, 3] in metres and faces [F, 3], for "traced".
        R, center, K: camera from world, centre of projection in metres, intrinsics in pixels.
    """
    if source == "expected":
        return picture.depth.detach()
    depth = picture.depth / picture.alpha.clamp_min(MIN_ALPHA)
    if source != "traced":
        return depth
    height, width = depth.shape
    R64, K64, center64 = (a.detach().cpu().numpy().astype(np.float64) for a in (R, K, center))
    camera = Camera(R=R64, t=-R64 @ center64, K=K64, dist=np.zeros(5), width=width, height=height)
    surface = torch.as_tensor(draw_depth(camera, *mesh), dtype=depth.dtype, device=depth.device)
    return torch.where(torch.isfinite(surface), surface, depth)
