"""D-SSIM against the index that scores pictures; the scores' code is scikit-image's."""

import numpy as np
import pytest
import torch
from skimage.metrics import structural_similarity

from pipeline.avatar.training.head_losses import structural_dissimilarity
from pipeline.base.color import srgb_from_linear
from pipeline.metrics.images import SSIM_SIGMA, SSIM_WINDOW


@pytest.fixture
def pictures():
    """Rendered and captured, a subject amid more black than a window is wide, and its mask."""
    generator = np.random.default_rng(0)
    captured = generator.uniform(0.05, 0.8, (40, 36, 3))
    mask = np.zeros((40, 36), np.float32)
    mask[SSIM_WINDOW:-SSIM_WINDOW, SSIM_WINDOW:-SSIM_WINDOW] = 1
    rendered = (captured + generator.normal(0, 0.2, captured.shape)).clip(0, 1)
    return *((image * mask[..., None]).astype(np.float32) for image in (rendered, captured)), mask


def test_index_is_that_of_scikit_image(pictures):
    found = structural_dissimilarity(*(torch.tensor(image) for image in pictures))
    *srgb, mask = (srgb_from_linear(image).astype(np.float64) for image in pictures)
    _, index = structural_similarity(
        *srgb, data_range=1.0, channel_axis=2, gaussian_weights=True, sigma=SSIM_SIGMA, use_sample_covariance=False,
        full=True,
    )  # fmt: skip
    expected = ((1 - index.mean(2)) / 2)[mask > 0].mean()
    assert expected > 0.02
    assert found.item() == pytest.approx(expected, rel=1e-4)


def test_equal_pictures_differ_by_nothing_and_gradients_are_finite(pictures):
    captured = torch.tensor(pictures[1])
    mask = torch.ones(40, 36)
    assert structural_dissimilarity(captured, captured, mask).item() == pytest.approx(0, abs=1e-6)
    for start in (torch.zeros_like(captured), captured.clone(), 2 * captured):
        rgb = start.requires_grad_()
        slope = torch.autograd.grad(structural_dissimilarity(rgb, captured, mask), rgb)[0]
        assert torch.isfinite(slope).all()
    rgb = torch.zeros_like(captured).requires_grad_()
    slope = torch.autograd.grad(structural_dissimilarity(rgb, torch.zeros_like(captured), 0 * mask), rgb)[0]
    assert torch.isfinite(slope).all()  # nothing to see at all
