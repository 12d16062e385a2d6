"""gsplat's projection, as its own PyTorch implementation states it, against ours: on a CPU, on random scenes."""

from __future__ import annotations

import pytest
import torch
from scipy.spatial.transform import Rotation

from pipeline.rendering.splat_conventions import MIN_DILATION_PX2
from pipeline.rendering.splat_reference import project_footprints
from pipeline.rendering.splat_types import CameraView, Gaussians, SplatOptions

stated = pytest.importorskip(
    "gsplat.cuda._torch_impl", reason="no gsplat: pip install --no-deps gsplat==1.5.3, which needs no GPU for this"
)

RTOL = 1e-9
"""Both in float64: roundings of 1e-16 times the condition of a footprint, up to 1e4 here, and as much again of its
gradient."""

NEAR_M = 0.2
COUNT = 400


def scene(seed: int) -> tuple[Gaussians, CameraView]:
    """Gaussians around a camera, also behind it and far outside its picture, whose axes do not meet in its middle."""
    draws = torch.Generator().manual_seed(seed)
    means = 2.0 * torch.randn(COUNT, 3, generator=draws, dtype=torch.float64)
    quaternions = torch.randn(COUNT, 4, generator=draws, dtype=torch.float64)
    scales = torch.exp(torch.empty(COUNT, 3, dtype=torch.float64).uniform_(-6, -1, generator=draws))
    opacities = torch.rand(COUNT, generator=draws, dtype=torch.float64)
    turn = Rotation.from_rotvec(torch.randn(3, generator=draws).numpy()).as_matrix()
    fx, fy, cx, cy = (torch.tensor([80.0, 60, 20, 12]) + 20 * torch.rand(4, generator=draws)).tolist()
    K = torch.tensor([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], dtype=torch.float64)
    t = torch.randn(3, generator=draws, dtype=torch.float64)
    return Gaussians(means, quaternions, scales, opacities), CameraView(torch.tensor(turn), t, K, 64, 48)


def ours(gaussians, view, options):
    """Rows of those in front: index, centre, inverse covariance as (xx, xy, yy), depth and opacity."""
    found = project_footprints(gaussians, view, options)
    covariance = found.factor @ found.factor.mT + found.dilation_px2 * torch.eye(2, dtype=torch.float64)
    inverse = torch.linalg.inv(covariance)
    conic = torch.stack([inverse[:, 0, 0], inverse[:, 0, 1], inverse[:, 1, 1]], 1)
    return found.index, found.center_px, conic, found.depth_m, found.opacity


def theirs(gaussians, view, options, index):
    """The same rows of gsplat's."""
    camera_from_world = torch.eye(4, dtype=torch.float64)
    camera_from_world[:3, :3], camera_from_world[:3, 3] = view.R, view.t
    covariances, _ = stated._quat_scale_to_covar_preci(gaussians.quaternions, gaussians.scales, True, False)
    _, centers, depths, conics, compensations = stated._fully_fused_projection(
        gaussians.means, covariances, camera_from_world[None], view.K[None], view.width, view.height,
        eps2d=max(options.dilation_px2, MIN_DILATION_PX2), near_plane=options.near_m,
        calc_compensations=options.compensate_opacity,
    )  # fmt: skip
    kept = 1.0 if compensations is None else compensations[0]
    rows = (centers[0], conics[0][:, [0, 1, 2]], depths[0], gaussians.opacities * kept)
    return tuple(row[index] for row in rows)


@pytest.mark.parametrize("compensate", [False, True])
@pytest.mark.parametrize("dilation_px2", [0.05, 0.3])
@pytest.mark.parametrize("seed", range(5))
def test_footprints_and_their_gradients_are_gsplats(seed, dilation_px2, compensate):
    options = SplatOptions(dilation_px2=dilation_px2, compensate_opacity=compensate, near_m=NEAR_M)
    plain, view = scene(seed)
    first, second = (Gaussians(*(a.clone().requires_grad_() for a in plain.named().values())) for _ in range(2))
    index, *found = ours(first, view, options)
    expected = theirs(second, view, options, index)
    depth = plain.means @ view.R[2] + view.t[2]
    assert sorted(index.tolist()) == torch.nonzero(depth >= NEAR_M)[:, 0].tolist()
    assert 0.2 * COUNT < len(index) < 0.8 * COUNT
    for mine, other in zip(found, expected, strict=True):
        torch.testing.assert_close(mine, other, rtol=RTOL, atol=RTOL)
    draws = torch.Generator().manual_seed(9)
    upstream = [torch.randn(row.shape, generator=draws, dtype=torch.float64) for row in found]
    torch.autograd.backward(found, upstream)
    torch.autograd.backward(list(expected), upstream)
    for name, leaf in first.named().items():
        other = second.named()[name].grad
        assert other.norm() > 0
        assert (leaf.grad - other).norm() <= RTOL * other.norm(), name
