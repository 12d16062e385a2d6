"""What is said of charts: each flaw alone, and nothing of the others."""

from __future__ import annotations

import numpy as np

from pipeline.calibration.color.color_chart import Patches, find_chart
from pipeline.calibration.color.color_response import Response, fit_response
from pipeline.calibration.color.color_verdicts import light_flaws, patch_flaws, response_flaws
from pipeline.config.calibrate_color import CalibrateColor
from tests.support.drawings.chart import RESPONSE, VALUES, chart_pixels, draw_chart

SETTINGS = CalibrateColor()
LAYOUT = np.stack([np.tile([k % 6, k // 6], (4, 1)) for k in range(24)]).astype(float)


def response(matrix: np.ndarray = RESPONSE, squares: np.ndarray = LAYOUT, values: np.ndarray = VALUES) -> Response:
    noise = np.random.default_rng(0).normal(0, 2e-4, VALUES.shape)
    return fit_response(Patches(values @ matrix.T + noise, np.ones(24, bool), squares), VALUES)


def test_image_turned_by_180_degrees_has_its_patches_turned_about_its_middle():
    """Whatever draws the detector aside turns along, a wrong origin of pixels does not: it would shift all alike."""
    image = draw_chart(noise=0.0)
    middles = [find_chart(np.ascontiguousarray(each)).mean((0, 1)) for each in (image, image[::-1, ::-1])]
    true = chart_pixels(*((k % 6 + 0.5, k // 6 + 0.5) for k in range(24))).mean(0)
    assert np.abs(middles[0] - true).max() < 0.5
    assert np.abs((middles[0] + middles[1]) / 2 - [image.shape[1] / 2, image.shape[0] / 2]).max() < 0.2


def test_sound_chart_has_no_flaw_and_each_other_has_its_own():
    assert not patch_flaws(response().patches, 0.0, SETTINGS) and not response_flaws(response(), SETTINGS)
    (other,) = response_flaws(response(values=VALUES[np.random.default_rng(1).permutation(24)]), SETTINGS)
    assert other.grade == "failed" and "fit the chart's values" in other.expected
    mirrored = LAYOUT * [-1, 1]
    (flaw,) = response_flaws(response(squares=mirrored), SETTINGS)
    assert flaw.found == "a mirrored chart" and not response(squares=mirrored[..., ::-1]).patches.mirrored()
    few = Patches(np.zeros((24, 3)), np.arange(24) < 8, LAYOUT)
    assert patch_flaws(few, 0.0, SETTINGS)[0].found == "8 of 24"


def test_one_bright_camera_leaves_the_others_good():
    """Judged against the median: a mean would make the four sound ones dark."""
    responses = {f"cam{k}": response(RESPONSE * (40.0 if k == 0 else 1.0)) for k in range(5)}
    flawed = {name: [flaw.found for flaw in flaws] for name, flaws in light_flaws(responses, SETTINGS).items()}
    assert flawed == {"cam0": ["40.00 times brighter"], **{f"cam{k}": [] for k in range(1, 5)}}
