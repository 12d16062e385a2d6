"""The rows of image metrics, and MS-SSIM against a transcription of its definition."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import get_args

import numpy as np
import pytest
from scipy.signal import correlate2d

from pipeline.config.evaluate_avatar import EvaluateAvatar
from pipeline.metrics.evaluation import PSNR_CEILING_DB, evaluate, region, summarize
from pipeline.metrics.image_metrics import (
    DEFAULT_METRICS,
    IMAGE_METRICS,
    ImagePair,
    asked_metrics,
    metrics_in,
)
from pipeline.metrics.images import MS_SSIM_SMALLEST_SIDE, ms_ssim

WEIGHTS = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)


def scene(seed: int, height: int = 170, width: int = 181) -> np.ndarray:
    """Shades and stripes of several widths, with noise: something on every scale."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width]
    waves = [np.sin(x / period + y / (2 * period) + rng.uniform(0, 6)) for period in (1.5, 4, 15, 50)]
    channels = [0.5 + 0.1 * sum(waves) + 0.02 * rng.standard_normal((height, width)) for _ in range(3)]
    return np.stack(channels, 2).clip(0, 1)


def reference_ms_ssim(x: np.ndarray, y: np.ndarray) -> float:
    """Wang, Simoncelli and Bovik 2003, equation 7, of one channel: windows inside the image, 2 x 2 means in between."""
    axis = np.arange(-5, 6)
    window = np.exp(-(axis[:, None] ** 2 + axis[None] ** 2) / (2 * 1.5**2))
    window /= window.sum()

    def local_mean(image):
        return correlate2d(image, window, mode="valid")

    c1, c2, product = 0.01**2, 0.03**2, 1.0
    for scale, weight in enumerate(WEIGHTS):
        mean_x, mean_y = local_mean(x), local_mean(y)
        variance_x, variance_y = local_mean(x * x) - mean_x**2, local_mean(y * y) - mean_y**2
        covariance = local_mean(x * y) - mean_x * mean_y
        term = (2 * covariance + c2) / (variance_x + variance_y + c2)
        if scale == 4:
            term = term * (2 * mean_x * mean_y + c1) / (mean_x**2 + mean_y**2 + c1)
        product *= term.mean() ** weight
        x, y = (
            correlate2d(np.pad(image, ((0, 1), (0, 1)), mode="edge"), np.full((2, 2), 0.25), mode="valid")[::2, ::2]
            for image in (x, y)
        )
    return product


@pytest.mark.parametrize("size", [(161, 161), (170, 181), (200, 163)])
def test_ms_ssim_is_its_transcription(size):
    captured = scene(0, *size)
    rendered = (0.9 * captured + 0.1 * scene(1, *size)).clip(0, 1)
    expected = np.mean([reference_ms_ssim(rendered[..., c], captured[..., c]) for c in range(3)])
    assert ms_ssim(rendered, captured) == pytest.approx(expected, abs=1e-9)
    assert 0.5 < expected < 0.999


def test_ms_ssim_of_equal_images_is_one():
    assert ms_ssim(scene(2), scene(2)) == pytest.approx(1, abs=1e-12)


def test_ms_ssim_of_flat_images_is_the_luminance_term_of_the_coarsest_scale():
    a, b, c1 = 0.3, 0.6, 0.01**2
    found = ms_ssim(np.full((161, 170, 3), a), np.full((161, 170, 3), b))
    assert found == pytest.approx(((2 * a * b + c1) / (a * a + b * b + c1)) ** WEIGHTS[4], abs=1e-9)


def test_ms_ssim_of_an_inverted_image_counts_zero():
    captured = scene(3)
    assert ms_ssim(1 - captured, captured) == 0


def test_ms_ssim_needs_161_pixels_a_side():
    assert MS_SSIM_SMALLEST_SIDE == 161
    assert math.isnan(ms_ssim(scene(4, 160, 200), scene(4, 160, 200)))


def test_extra_metrics_of_the_setting_are_the_rows_that_are_off_by_default():
    (names,) = {get_args(annotation) for annotation in get_args(EvaluateAvatar.model_fields["metrics"].annotation)[:1]}
    assert names == tuple(metric.name for metric in IMAGE_METRICS if not metric.by_default)


def test_rows_have_names_of_their_own():
    assert len({metric.name for metric in IMAGE_METRICS}) == len(IMAGE_METRICS)
    expected = [
        "PSNR [dB]",
        "SSIM",
        "LPIPS",
        "FLIP",
        "MS-SSIM",
        "ST-LPIPS",
        "PSNR of the image [dB]",
        "PSNR of the face [dB]",
    ]
    assert [metric.heading for metric in IMAGE_METRICS] == expected


@pytest.mark.parametrize(
    "metric", DEFAULT_METRICS + asked_metrics(["ms_ssim", "st_lpips"])[-2:], ids=lambda metric: metric.name
)
def test_score_gets_worse_with_the_error(metric):
    captured, foreground = scene(5), np.ones((170, 181), bool)
    if metric.name == "lpips":
        assert math.isnan(metric.measure(ImagePair(captured, captured, foreground)))
        return
    near, far = (metric.measure(ImagePair((captured * k).clip(0, 1), captured, foreground)) for k in (0.95, 0.6))
    assert (near > far) == metric.higher_is_better
    assert math.isnan(metric.measure(ImagePair(captured, captured, ~foreground)))


def test_protocol_of_the_default_metrics_names_their_boxes():
    assert region(DEFAULT_METRICS) == (
        f"psnr: pixels with mask >= 0.5, per image, then mean over images (exact matches count {PSNR_CEILING_DB:g} dB);"
        " ssim, lpips, flip: box around these pixels (ssim, flip at least 11, lpips at least 32 px a side), mean over "
        "images; captured x mask and rendering, both over black, the ring of pixels beside the subject black in both"
    )


def held_out(height: int, width: int) -> SimpleNamespace:
    """An image record of a camera that training never saw, all subject."""
    flags = dict.fromkeys(("test_frame", "test_segment", "test_pattern", "validation", "fully_lit"), False)
    image, mask = scene(6, height, width).astype(np.float32), np.ones((height, width), np.float32)
    return SimpleNamespace(image=image, mask=mask, camera="cam00", frame=0, test_camera=True, **flags)


def test_metric_that_is_asked_for_has_a_column_and_a_word_in_the_protocol():
    def render(frame, image):
        return 0.9 * image.image, image.mask

    asked, images = asked_metrics(["ms_ssim"]), [held_out(170, 181), held_out(50, 181)]
    table = evaluate(render, images, {0: None}, metrics=asked)
    assert 0 < table.ms_ssim[0] < 1 and math.isnan(table.ms_ssim[1])
    assert summarize(table).ms_ssim[0] == table.ms_ssim[0]
    assert metrics_in(table) == asked
    assert "ms_ssim at least 161 px a side; ms_ssim: five scales, empty for smaller images)" in region(asked)
    assert "ms_ssim" not in evaluate(render, images[1:], {0: None})


def test_psnr_of_the_image_is_that_of_both_images_masked_and_whole():
    """As programs have it that multiply the difference by the mask, and take the mean over all pixels."""
    captured, foreground = scene(6, 40, 50), np.zeros((40, 50), bool)
    foreground[10:30, 15:40] = True
    rendered = (0.9 * captured).clip(0, 1)
    whole = np.zeros((200, 100, 3))
    whole[80:120, 30:80] = (rendered - captured) * foreground[..., None]
    (metric,) = [metric for metric in IMAGE_METRICS if metric.name == "psnr_image"]
    found = metric.measure(ImagePair(rendered, captured, foreground, image_pixels=200 * 100))
    assert found == pytest.approx(-10 * np.log10((whole**2).mean()), abs=1e-6)
    assert math.isnan(metric.measure(ImagePair(rendered, captured, foreground)))


def test_psnr_of_the_face_counts_what_shows_it_and_is_subject():
    captured, foreground = np.full((9, 8, 3), 0.5), np.zeros((9, 8), bool)
    foreground[1:7], face = True, np.zeros((9, 8), bool)
    face[5:9, 2:6] = True  # two rows of it lie beside the subject
    rendered = captured.copy()
    rendered[5, 2] += 0.1  # one of eight pixels that count
    rendered[8, 3] = rendered[2] = 1
    (metric,) = asked_metrics(["psnr_face"])[-1:]
    assert metric.measure(ImagePair(rendered, captured, foreground, face=face)) == pytest.approx(20 + 10 * np.log10(8))
    assert math.isnan(metric.measure(ImagePair(rendered, captured, foreground)))
    assert math.isnan(metric.measure(ImagePair(rendered, captured, foreground, face=face & ~foreground)))
