"""A drawn 24-patch chart with planted responses."""

import cv2
import numpy as np
import pytest

from pipeline.capture.color_chart import Patches, corrections, find_chart, fit_response, measure_patches

# Linear Rec. 709 of the classic chart, to two digits: any 24 distinct colours in its order would do for the fit, but
# OpenCV's detector knows the real ones.
VALUES = np.array([
    [0.17, 0.08, 0.06], [0.54, 0.30, 0.22], [0.11, 0.19, 0.34], [0.10, 0.15, 0.05],
    [0.23, 0.21, 0.43], [0.12, 0.51, 0.40], [0.69, 0.20, 0.03], [0.06, 0.10, 0.38],
    [0.53, 0.09, 0.12], [0.11, 0.04, 0.14], [0.34, 0.50, 0.05], [0.75, 0.36, 0.03],
    [0.03, 0.05, 0.30], [0.06, 0.29, 0.06], [0.43, 0.03, 0.04], [0.81, 0.57, 0.01],
    [0.50, 0.09, 0.30], [0.00, 0.24, 0.37], [0.90, 0.90, 0.88], [0.58, 0.59, 0.58],
    [0.35, 0.36, 0.36], [0.19, 0.19, 0.19], [0.09, 0.09, 0.09], [0.03, 0.03, 0.03],
])  # fmt: skip

RESPONSE = np.array([[0.8, 0.05, 0.0], [0.03, 0.75, 0.04], [0.0, 0.02, 0.7]])
TO_IMAGE = np.array([[52.0, -7.0, 130.0], [6.0, 54.0, 60.0], [0.004, 0.002, 1.0]])
"""From patches (column, row) to pixels."""


def chart_image(response, upside_down=False, noise=0.003):
    """Patches 0.8 wide on a dark frame, in perspective."""
    rows, columns = np.mgrid[0:400, 0:560]
    at = np.linalg.inv(TO_IMAGE) @ np.stack([columns.ravel(), rows.ravel(), np.ones(columns.size)])
    x, y = at[:2] / at[2]
    if upside_down:
        x, y = 6 - x, 4 - y
    column, row = np.floor(x).astype(int), np.floor(y).astype(int)
    in_chart = (x > -0.2) & (x < 6.2) & (y > -0.2) & (y < 4.2)
    inside = (column >= 0) & (column < 6) & (row >= 0) & (row < 4) & (abs(x % 1 - 0.5) < 0.4) & (abs(y % 1 - 0.5) < 0.4)
    patch = np.clip(6 * row + column, 0, 23)
    color = np.where(inside[:, None], VALUES[patch], np.where(in_chart[:, None], 0.025, 0.0))
    image = (color @ response.T).reshape(400, 560, 3)
    image = cv2.GaussianBlur(image, (0, 0), 0.8) + np.random.default_rng(0).normal(0, noise, image.shape)
    return image.astype(np.float32)


@pytest.mark.parametrize("upside_down", [False, True])
def test_response_of_a_drawn_chart(upside_down):
    image = chart_image(RESPONSE, upside_down)
    patches = measure_patches(image, find_chart(image), 0.8, 1.0)
    assert patches.used.all()
    # Median of about 500 pixels of 0.003: 1.7e-4 per patch, and 24 patches for three numbers a row.
    assert fit_response(patches, VALUES).matrix == pytest.approx(RESPONSE, abs=2e-3)


def test_no_chart_is_none():
    assert find_chart(np.full((200, 300, 3), 0.1, np.float32)) is None


def test_saturated_patches_are_left_out():
    image = chart_image(RESPONSE)
    squares = find_chart(image)
    # White, and the yellow's red, reach 0.6; the next patch stays below.
    patches = measure_patches(np.minimum(image, 0.6), squares, 0.8, 0.6)
    assert not patches.used[18]
    assert patches.used.sum() >= 20
    assert np.isnan(patches.color[18]).all()
    assert fit_response(patches, VALUES).matrix == pytest.approx(RESPONSE, abs=2e-3)


def test_a_dirty_patch_does_not_tint_the_camera():
    color = VALUES @ RESPONSE.T + np.random.default_rng(0).normal(0, 2e-4, (24, 3))
    color[7] += [0.2, 0.1, 0.0]
    response = fit_response(Patches(color, np.ones(24, bool)), VALUES)
    assert response.matrix == pytest.approx(RESPONSE, abs=1e-3)
    assert response.weight[7] < 0.01
    assert response.residual[7] == pytest.approx([0.2, 0.1, 0.0], abs=2e-3)


def test_corrected_cameras_agree_on_the_average_camera():
    rng = np.random.default_rng(1)
    responses = {f"cam{c}": np.eye(3) * 0.7 + rng.normal(0, 0.03, (3, 3)) for c in range(5)}
    average = np.mean(list(responses.values()), axis=0)
    for name, matrix in corrections(responses).items():
        assert matrix @ responses[name] == pytest.approx(average)
    only = corrections({"cam0": responses["cam0"]})["cam0"]
    assert only == pytest.approx(np.eye(3))
