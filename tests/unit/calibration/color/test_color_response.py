"""Planted responses from patches without an image."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.calibration.color.color_chart import Patches
from pipeline.calibration.color.color_response import corrections, fit_response
from tests.support.drawings.chart import RESPONSE, VALUES

CORNERS = np.zeros((24, 4, 2))


def test_a_dirty_patch_does_not_tint_the_camera():
    color = VALUES @ RESPONSE.T + np.random.default_rng(0).normal(0, 2e-4, (24, 3))
    color[7] += [0.2, 0.1, 0.0]
    response = fit_response(Patches(color, np.ones(24, bool), CORNERS), VALUES)
    assert response.matrix == pytest.approx(RESPONSE, abs=1e-3)
    assert response.weight[7] < 0.01
    assert response.residual[7] == pytest.approx([0.2, 0.1, 0.0], abs=2e-3)
    assert np.nanargmax(response.relative_residual()) == 7


def test_standard_deviations_are_those_of_repeated_fits():
    rng = np.random.default_rng(2)
    used = np.arange(24) > 2
    fits = [
        fit_response(Patches(VALUES @ RESPONSE.T + rng.normal(0, 0.01, (24, 3)), used, CORNERS), VALUES)
        for _ in range(50)
    ]
    spread = np.std([fit.matrix for fit in fits], axis=0)
    sigma = np.mean([fit.sigma for fit in fits], axis=0)
    # 50 repeats know a spread to 10 %, and the largest error of nine is twice that; so does the noise from 21 patches.
    assert sigma == pytest.approx(spread, rel=0.35)


def test_an_unused_patch_has_no_residual_and_no_weight():
    used = np.arange(24) != 5
    color = np.where(used[:, None], VALUES @ RESPONSE.T, np.nan)
    response = fit_response(Patches(color, used, CORNERS), VALUES)
    assert response.matrix == pytest.approx(RESPONSE, abs=1e-9)
    assert np.isnan(response.residual[5]).all()
    assert response.weight[5] == 0


def test_corrected_cameras_agree_on_the_average_camera():
    rng = np.random.default_rng(1)
    responses = {f"cam{c}": np.eye(3) * 0.7 + rng.normal(0, 0.03, (3, 3)) for c in range(5)}
    average = np.mean(list(responses.values()), axis=0)
    for name, matrix in corrections(responses).items():
        assert matrix @ responses[name] == pytest.approx(average)
    only = corrections({"cam0": responses["cam0"]})["cam0"]
    assert only == pytest.approx(np.eye(3))
