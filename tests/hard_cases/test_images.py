"""Images that break losses and metrics: black, saturated, constant, not a number; and the transfer function at zero."""

from __future__ import annotations

from pathlib import Path

import mpmath
import numpy as np
import pytest
import torch

from pipeline.avatar.training.losses import photometric, silhouette
from pipeline.base.color import BREAK_LINEAR, SLOPE, linear_from_srgb, srgb_from_linear
from pipeline.base.exr import HALF_MAX, write_exr
from pipeline.capture.crops import cut_crop
from pipeline.capture.images import read_image
from pipeline.capture.index.image_checks import ExpectedImage, inspect_image
from pipeline.capture.undistortion import SPLINE_SUPPORT, undistort_image
from pipeline.geometry.cameras import Camera
from pipeline.metrics.images import flip, psnr_db, ssim
from tests.support.naive.shading import naive_srgb_slope
from tests.support.results.hard_case import HardCase, worst

FLOAT32 = 5e-7
EVERYWHERE = np.ones((16, 16), bool)
C1 = 0.01**2
"""Of Wang et al. 2004, at the range 1."""


def encoded(x: mpmath.mpf) -> mpmath.mpf:
    """IEC 61966-2-1, with its decimal constants."""
    return mpmath.mpf("12.92") * x if x <= mpmath.mpf("0.0031308") else mpmath.mpf("1.055") * x ** (
        1 / mpmath.mpf("2.4")
    ) - mpmath.mpf("0.055")  # fmt: skip


@pytest.mark.parametrize("at", [0.0, -0.01, 1e-12, 0.002, 0.9999 * BREAK_LINEAR, 1.0001 * BREAK_LINEAR, 1.0, 4.0])
def test_srgb(case: HardCase, at: float) -> None:
    linear = torch.tensor(at, requires_grad=True)
    found = srgb_from_linear(linear)
    (slope,) = torch.autograd.grad(found, linear)
    exact = mpmath.mpf(linear.item())
    by_linear = mpmath.diff(encoded, exact) if at else mpmath.mpf("12.92")
    case.check(
        worst(found, encoded(exact), max(float(encoded(exact)), 0.04)), FLOAT32, worst(slope, by_linear), FLOAT32
    )
    assert linear_from_srgb(found.detach()).item() == pytest.approx(at, rel=1e-6)
    if at < BREAK_LINEAR:  # the power alone, without the straight line below it
        case.naive_fails(worst(naive_srgb_slope(at), by_linear), "gradient")
    else:  # as a gamma of 2.2
        case.naive_fails(worst(linear.detach() ** (1 / 2.2 - 1) / 2.2, by_linear), "gradient")


def test_where_alone_does_not_protect_the_slope_of_srgb(case: HardCase) -> None:
    black = torch.zeros(3, requires_grad=True)
    (slope,) = torch.autograd.grad(srgb_from_linear(black).sum(), black)
    case.check(worst(srgb_from_linear(black), np.zeros(3)), 0, worst(slope, np.full(3, SLOPE)), FLOAT32)
    naive = torch.zeros(3, requires_grad=True)
    power = 1.055 * naive ** (1 / 2.4) - 0.055
    torch.where(naive <= BREAK_LINEAR, SLOPE * naive, power).sum().backward()
    case.naive_fails(worst(naive.grad, np.full(3, SLOPE)), "gradient")


def test_loss_of_a_black_picture_of_a_black_capture(case: HardCase) -> None:
    """Nothing to learn: the slope of |x| at its corner is taken as 0."""
    rgb, mask = torch.zeros(9, 9, 3, requires_grad=True), torch.ones(9, 9)
    loss = photometric(rgb, torch.zeros(9, 9, 3), mask, "captured")
    (slope,) = torch.autograd.grad(loss, rgb)
    case.check(float(loss.detach()), 0, float(slope.abs().max()), 0)
    naive = torch.zeros(9, 9, 3, requires_grad=True)
    (naive ** (1 / 2.2)).square().mean().sqrt().backward()
    case.naive_fails(naive.grad.abs().max(), "gradient")


def test_losses_without_a_subject(case: HardCase) -> None:
    """An empty mask: what little is drawn beside it counts, over one pixel instead of none."""
    rgb, alpha = torch.full((9, 9, 3), 1e-3, requires_grad=True), torch.full((9, 9), 0.1, requires_grad=True)
    mask = torch.zeros(9, 9)
    color, outline = photometric(rgb, torch.zeros(9, 9, 3), mask, "captured"), silhouette(alpha, mask)
    slopes = torch.autograd.grad(color + outline, (rgb, alpha))
    exact = 81 * 3 * mpmath.mpf("12.92") * mpmath.mpf("1e-3"), mpmath.mpf("8.1")
    case.check(
        max(worst(color, exact[0]), worst(outline, exact[1])), 5e-6,
        max(worst(slopes[0], np.full((9, 9, 3), 12.92)), worst(slopes[1], np.ones((9, 9)))), FLOAT32,
    )  # fmt: skip
    case.naive_fails(worst(color / (mask.sum() + 1e-8), exact[0]))  # a mean over the mask, guarded as is usual


@pytest.mark.parametrize("edges", ["captured", "ignored"])
def test_loss_of_saturated_pixels(case: HardCase, edges: str) -> None:
    """The sensor clipped where the avatar shines on: a finite pull, as strong as the curve's slope there."""
    rgb = torch.full((9, 9, 3), 50.0, requires_grad=True)
    loss = photometric(rgb, torch.ones(9, 9, 3), torch.ones(9, 9), edges)
    (slope,) = torch.autograd.grad(loss, rgb)
    with mpmath.workdps(30):
        exact = encoded(mpmath.mpf(50)) - 1
        by_rgb = mpmath.diff(encoded, mpmath.mpf(50)) / 243
    case.check(worst(loss, exact), 5e-6, worst(slope, np.full((9, 9, 3), float(by_rgb))), 5e-6)
    shown = rgb.detach().clamp(0, 1)  # compared as it would be shown, where nothing pulls it back
    case.naive_fails(worst(photometric(shown, torch.ones(9, 9, 3), torch.ones(9, 9), edges), exact))


def test_highlights_beyond_half_precision_stay_finite(case: HardCase, tmp_path: Path) -> None:
    image = np.array([[[1e9, HALF_MAX, 7e4]]], np.float32)
    write_exr(tmp_path / "a.exr", image)
    case.check(worst(read_image(tmp_path / "a.exr"), np.full((1, 1, 3), HALF_MAX)), 0)
    with np.errstate(over="ignore"):
        case.naive_fails(np.abs(image.astype(np.float16)).max())


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_pixels_that_are_no_numbers_are_counted_and_named(case: HardCase, tmp_path: Path, value: float) -> None:
    image = np.full((6, 8, 3), 0.5, np.float32)
    image[2, 3:5, 1] = value
    write_exr(tmp_path / "a.exr", {name: image[..., k] for k, name in enumerate("RGB")}, half=False)
    found = inspect_image(tmp_path, ExpectedImage("a.exr", "color", "cam0", (8, 6)))
    assert [(flaw.expected, flaw.found) for flaw in found.flaws] == [
        ("finite numbers", "2 of 48 pixels NaN or infinite")
    ]
    case.check(abs(int(found.flaws[0].found.split()[0]) - 2), 0, unit="pixels")
    if np.isinf(value):
        case.naive_fails(abs(np.isnan(image).any(2).sum() - 2))


def test_a_pixel_that_is_no_number_stays_one_pixel(case: HardCase) -> None:
    """It becomes black and leaves the mask. The lens's correction, a spline, would spread it over rows and columns."""
    K = np.array([[110.0, 0, 46.0], [0, 112.0, 41.5], [0, 0, 1.0]])
    camera = Camera(np.eye(3), np.array([0.0, 0, 3]), K, np.array([-0.2, 0.05, 0.002, -0.001, 0.0]), 96, 80)
    image, mask = np.full((80, 96, 3), 0.5, np.float32), np.zeros((80, 96), np.float32)
    mask[20:60, 20:70] = 1
    image[40, 44] = np.nan
    crop = cut_crop(image, mask, camera, margin_px=2)
    rows, columns = np.mgrid[crop.box.slices]
    # Near the middle of the picture the lens moves nothing by a pixel.
    distance = np.maximum(abs(rows - 40), abs(columns - 44))
    assert np.isfinite(crop.image).all()
    assert crop.mask[distance == 0] == 0
    assert (crop.mask[distance == 2] == 1).all()
    case.check(worst(crop.image[distance > SPLINE_SUPPORT], 0.5), 1e-6)
    spread = undistort_image(image, camera, crop.box)
    case.naive_fails(np.abs(spread[distance > SPLINE_SUPPORT] - 0.5).max())


@pytest.mark.parametrize(("a", "b"), [(0.0, 0.0), (0.0, 1.0), (0.3, 0.3), (0.2, 0.7), (1.0, 1.0)])
def test_ssim_of_constant_images(case: HardCase, a: float, b: float) -> None:
    """Without variance the structure's term is 1 and the means' (2 a b + C1) / (a^2 + b^2 + C1) is left."""
    first, second = np.full((16, 16, 3), a), np.full((16, 16, 3), b)
    exact = (2 * mpmath.mpf(a) * b + C1) / (mpmath.mpf(a) ** 2 + mpmath.mpf(b) ** 2 + C1)
    case.check(worst(ssim(first, second), exact), 1e-9)
    with np.errstate(invalid="ignore"):  # the universal quality index: the same without constants
        covariance, variances = np.float64(0), np.float64(0)
        case.naive_fails(worst(4 * covariance * a * b / (variances * (a * a + b * b)), exact))


@pytest.mark.parametrize("level", [0.0, 0.5, 1.0])
def test_psnr_and_flip_of_equal_images(case: HardCase, level: float) -> None:
    """PSNR is infinite by definition, FLIP is zero."""
    image = np.full((16, 16, 3), level)
    assert psnr_db(image, image, EVERYWHERE) == np.inf
    case.check(flip(image, image), 1e-6)
    guarded = -10 * np.log10(np.mean((image - image) ** 2) + 1e-8)  # 80 dB, and none can be better
    case.naive_fails(abs(guarded - psnr_db(image, image, EVERYWHERE)))


@pytest.mark.parametrize("difference", [1e-12, 1e-4, 1.0])
def test_psnr_of_tiny_and_of_full_differences(case: HardCase, difference: float) -> None:
    """Over the subject alone: the black around it would add 6 dB to a subject on a quarter of the image."""
    captured, subject = np.zeros((16, 16, 3)), np.zeros((16, 16), bool)
    subject[:8, :8] = True
    rendered = np.where(subject[..., None], difference, captured)
    exact = -20 * mpmath.log10(mpmath.mpf(difference))
    case.check(worst(psnr_db(rendered, captured, subject), exact, 1.0), 1e-9, unit="dB")
    case.naive_fails(worst(-10 * np.log10(np.mean((rendered - captured) ** 2)), exact, 1.0))


def test_psnr_without_a_subject_is_no_number() -> None:
    assert np.isnan(psnr_db(np.zeros((4, 4, 3)), np.zeros((4, 4, 3)), np.zeros((4, 4), bool)))
