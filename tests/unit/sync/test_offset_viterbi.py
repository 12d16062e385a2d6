"""How much neighbouring frames tell anew, where the answer is known."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.sync.brightness import BrightnessModel, PatternLog
from pipeline.sync.offset_viterbi import independent_share

CAMERAS, FRAMES = 8, 2000


def any_model() -> BrightnessModel:
    """Cameras all around; only how their errors belong together is asked for."""
    rng = np.random.default_rng(1)
    around = rng.normal(size=(CAMERAS, 3))
    around /= np.linalg.norm(around, axis=1, keepdims=True)
    log = PatternLog(np.arange(FRAMES), ["A"], np.ones((FRAMES, 1, 3)))
    return BrightnessModel(
        log, np.arange(FRAMES), np.ones((FRAMES, CAMERAS, 3)), np.ones((CAMERAS, 1)), around, around[:1]
    )


@pytest.mark.parametrize("correlation", [0.0, 0.5, 0.9])
def test_errors_that_go_on_count_by_the_variance_of_their_sum(correlation: float) -> None:
    """The sum of n draws of an AR(1) process varies as that of n (1 - r) / (1 + r) independent ones."""
    rng, model = np.random.default_rng(2), any_model()
    root = np.linalg.cholesky(model.camera_correlation)
    errors = np.empty((FRAMES, CAMERAS))
    errors[0] = root @ rng.normal(size=CAMERAS)
    for frame in range(1, FRAMES):
        new = root @ rng.normal(size=CAMERAS)
        errors[frame] = correlation * errors[frame - 1] + np.sqrt(1 - correlation**2) * new
    distances, variance = model.squared_distance(errors), np.ones(FRAMES)
    found = independent_share(errors, distances, variance, model)
    # 2000 frames of 8 cameras know a correlation to 0.01; where it is negative by chance, it counts as none.
    assert found == pytest.approx((1 - correlation) / (1 + correlation), abs=0.03)
