"""The arithmetic behind the picture of the charts, on planted responses."""

from __future__ import annotations

import cv2
import numpy as np
import pandas as pd
import pytest

from pipeline.figures.charts import CELL_PX, average_colors, difference, upright

RNG = np.random.default_rng(3)
VALUES = RNG.uniform(0.05, 0.9, (24, 3))
RESPONSES = {f"cam{c}": 0.8 * np.eye(3) + RNG.normal(0, 0.05, (3, 3)) for c in range(4)}
AVERAGE = np.mean(list(RESPONSES.values()), axis=0)
CORRECTIONS = {name: AVERAGE @ np.linalg.inv(response) for name, response in RESPONSES.items()}


def residuals():
    """Rows of residuals_color.parquet whose noise is also their residual; the order of the rows is no matter."""
    rows = []
    for name, response in RESPONSES.items():
        for k, value in enumerate(VALUES):
            noise = RNG.normal(0, 0.01, 3)
            rows.append((name, k + 1, *(response @ value + noise), *noise))
    table = pd.DataFrame(rows, columns=["camera", "patch", "r", "g", "b", "residual_r", "residual_g", "residual_b"])
    return table.sample(frac=1, random_state=0, ignore_index=True)


def test_average_camera_sees_the_mean_response():
    assert average_colors(residuals(), CORRECTIONS) == pytest.approx(VALUES @ AVERAGE.T, abs=1e-12)


def test_patches_that_some_cameras_could_not_measure():
    table = residuals()
    table.loc[(table.patch == 19) & (table.camera != "cam2"), ["r", "residual_r"]] = np.nan
    table.loc[table.patch == 4, ["g", "residual_g"]] = np.nan
    found, expected = average_colors(table, CORRECTIONS), VALUES @ AVERAGE.T
    assert found[18] == pytest.approx(expected[18], abs=1e-12)
    assert np.isnan(found[3]).any()
    assert np.delete(found, 3, 0) == pytest.approx(np.delete(expected, 3, 0), abs=1e-12)
    # What is not known is left out of the difference, which stays a number.
    assert difference(expected, found) == pytest.approx(0, abs=1e-9)


def test_difference_of_greys_is_that_of_their_lightness():
    """White at 0.9 has L* = 116 cbrt(0.9) - 16 = 96.0, grey at 0.45 has 72.9. For greys CIEDE2000 is
    dL / S_L, S_L = 1 + 0.015 (L - 50)^2 / sqrt(20 + (L - 50)^2), L the mean (Sharma et al. 2005)."""
    white, gray = np.full((24, 3), 0.5), np.full((24, 3), 0.25)
    high, low = (116 * np.cbrt(level) - 16 for level in (0.9, 0.45))
    offset = ((high + low) / 2 - 50) ** 2
    expected = (high - low) / (1 + 0.015 * offset / np.sqrt(20 + offset))
    assert difference(gray, white) == pytest.approx(expected, rel=1e-3)


def test_chart_seen_askew_is_put_upright():
    """A chart drawn flat, warped by a homography that OpenCV is told, with centres warped by the same."""
    flat = np.zeros((440, 640, 3), np.float32)
    centers = np.array([[70 + 100 * (k % 6), 70 + 100 * (k // 6)] for k in range(24)], np.float64)
    for color, (x, y) in zip(VALUES, centers, strict=True):
        flat[int(y) - 40 : int(y) + 40, int(x) - 40 : int(x) + 40] = color
    corners = np.array([[0, 0], [640, 0], [640, 440], [0, 440]], np.float32)
    seen = np.array([[600, 80], [560, 640], [90, 560], [60, 30]], np.float32)  # Turned by a quarter and tilted.
    homography = cv2.getPerspectiveTransform(corners, seen)
    image = cv2.warpPerspective(flat, homography, (660, 700))
    # Squares of an even number of pixels: their middle (x, y) lies between pixels, at - 0.5 for OpenCV.
    moved = cv2.perspectiveTransform(centers[:, None] - 0.5, homography)[:, 0] + 0.5
    found = upright(image, moved)
    assert found.shape == (4 * CELL_PX, 6 * CELL_PX, 3)
    middles = found[CELL_PX // 2 :: CELL_PX, CELL_PX // 2 :: CELL_PX].reshape(24, 3)
    assert middles == pytest.approx(VALUES, abs=1e-3)
