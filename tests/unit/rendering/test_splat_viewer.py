"""Splat files as a viewer shows them, against the pictures of this project's renderer."""

from __future__ import annotations

import numpy as np
import torch

from pipeline.base.color import srgb_from_linear
from pipeline.geometry.camera_paths import look_at
from pipeline.rendering.splat import splat
from pipeline.rendering.splat_ply import Splats, write_splats
from pipeline.rendering.splat_types import CameraView, Gaussians, SplatOptions
from tests.support.avatars.splat_viewer import VIEWERS_DILATION_PX2, view

CAMERA = look_at(np.array([0.4, 0.3, 2.0]), np.array([0.05, 0.0, 0.0]), 40.0, 48, 40)
BYTE = 1 / 255


def some_splats(count: int = 60) -> Splats:
    """Needles, discs and balls, faint and strong, dark and bright."""
    draws = torch.Generator().manual_seed(4)
    means, normals = 0.35 * torch.randn(count, 3, generator=draws), torch.randn(count, 3, generator=draws)
    quaternions = torch.randn(count, 4, generator=draws)
    rgb, opacities = torch.rand(count, 3, generator=draws), 0.05 + 0.9 * torch.rand(count, generator=draws)
    scales = 0.01 + 0.15 * torch.rand(count, 3, generator=draws) ** 3
    return Splats(means, normals, rgb, opacities, scales, quaternions)


def splatted(splats: Splats, colors: torch.Tensor):
    R, t, K = (torch.tensor(array, dtype=torch.float32) for array in (CAMERA.R, CAMERA.t, CAMERA.K))
    gaussians = Gaussians(splats.means, splats.quaternions, splats.scales, splats.opacities)
    seen_by = CameraView(R, t, K, CAMERA.width, CAMERA.height)
    return splat(gaussians, colors, seen_by, SplatOptions(dilation_px2=VIEWERS_DILATION_PX2))


def test_a_viewer_draws_the_same_gaussians(tmp_path):
    """Where they are, how they lie, how wide, how dense and in which order; the viewer blends what it shows, sRGB."""
    splats = some_splats()
    write_splats(tmp_path / "a.ply", splats)
    picture, alpha = view(tmp_path / "a.ply", CAMERA)
    expected = splatted(splats, srgb_from_linear(splats.rgb_linear))
    assert alpha.max() > 0.9
    # A pixel may fall to either side of the viewers' cut at 1/255.
    assert np.quantile(np.abs(picture - expected.features.numpy()), 0.99) < 1e-4
    assert np.abs(picture - expected.features.numpy()).max() < BYTE
    assert np.abs(alpha - expected.alpha.numpy()).max() < BYTE


def test_a_viewer_shows_the_colours_that_a_still_has(tmp_path):
    """One linear colour per surface comes out as its sRGB value: encoded once, not twice, and not left linear."""
    y, x = np.mgrid[-12:13, -12:13].reshape(2, -1) * 0.03
    count = len(x)
    sheet = Splats(
        means=torch.tensor(np.stack([x, y, np.zeros(count)], 1), dtype=torch.float32),
        normals=torch.tensor([[0.0, 0, 1]]).repeat(count, 1),
        rgb_linear=torch.where(torch.tensor(x)[:, None] < 0, torch.tensor([0.02, 0.2, 0.7]), torch.tensor([0.9] * 3)),
        opacities=torch.full((count,), 0.95),
        scales=torch.tensor([[0.02, 0.02, 0.002]]).repeat(count, 1),
        quaternions=torch.tensor([[1.0, 0, 0, 0]]).repeat(count, 1),
    )
    write_splats(tmp_path / "a.ply", sheet)
    picture, alpha = view(tmp_path / "a.ply", CAMERA)
    blended = splatted(sheet, sheet.rgb_linear)
    still = srgb_from_linear(blended.features.numpy())
    left, right = (slice(18, 22), slice(15, 19)), (slice(18, 22), slice(29, 33))
    for side, linear in ((left, [0.02, 0.2, 0.7]), (right, [0.9] * 3)):
        assert alpha[side].min() > 0.99
        np.testing.assert_allclose(picture[side], still[side], atol=2 * BYTE)
        np.testing.assert_allclose(still[side].mean((0, 1)), srgb_from_linear(np.array(linear)), atol=2 * BYTE)
