"""The comparison of log and images: tables to arrays, and the likelihood, against SciPy."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from pipeline.sync.brightness import DEGREES, log_likelihood, observed_table, read_log
from tests.support.rigs.light_stage import brightness_model, build_stage, photograph, random_groups, white


def test_a_log_is_a_matrix_in_which_unlisted_lights_are_off():
    rows = [(7, "B", 1.0, 2.0, 3.0), (3, "A", 4.0, 4.0, 4.0)]
    table = pd.DataFrame(rows, columns=["frame", "light", "intensity_r", "intensity_g", "intensity_b"])
    log = read_log(table, pd.Series([3, 5]), ["A", "B", "C"])
    assert log.numbers.tolist() == [3, 5, 7]
    assert log.levels[:, :, 1].tolist() == [[4, 0, 0], [0, 0, 0], [0, 2, 0]]
    assert log.rows_for(np.array([[5, 6], [7, 99]])).tolist() == [[1, -1], [2, -1]]


def test_a_missing_image_is_filled_as_bright_as_the_frame_was_for_the_others():
    truth = {0: 1.0, 1: 3.0, 2: 2.0}
    rows = [(c, f, g * b, g * b, 2 * g * b) for c, g in (("c", 1.0), ("d", 7.0)) for f, b in truth.items()]
    means = pd.DataFrame(rows, columns=["camera", "frame", "r", "g", "b"])
    frames, seen = observed_table(means.drop(index=1), ["c", "d"])
    assert frames.tolist() == [0, 1, 2]
    usual = (1.0 + 2.0) / 2
    np.testing.assert_allclose(seen[1, 0], [3 / 2 * usual, 3 / 2 * usual, 3 * usual])
    np.testing.assert_allclose(seen[:, 1, 0], [7, 21, 14])
    assert observed_table(means, ["c", "d"])[1].shape == (3, 2, 3)


def test_coloured_lights_count_by_what_the_subject_reflects():
    stage = build_stage(0, frames=9, cameras=4, lights=8)
    rng = np.random.default_rng(0)
    log = random_groups(stage, rng) * rng.uniform(0, 1, (9, 8, 3))
    model = brightness_model(stage, log, photograph(stage, log, rng))
    np.testing.assert_allclose(model.channel_weights, stage.albedo / stage.albedo.mean(), rtol=0.02)
    gray = brightness_model(stage, white(log[..., 0]), photograph(stage, white(log[..., 0]), rng))
    np.testing.assert_allclose(gray.levels, log[..., 0])


@pytest.mark.parametrize("rows", [1, 4])
def test_the_likelihood_is_students(rows):
    rng = np.random.default_rng(rows)
    root = rng.normal(size=(rows, rows))
    covariance, variance = root @ root.T + np.eye(rows), np.array([0.3, 2.0])
    residuals = rng.normal(size=(2, rows))
    distance = (residuals @ np.linalg.inv(covariance) * residuals).sum(1)
    ours = log_likelihood(distance, variance, rows)
    expected = [
        stats.multivariate_t(shape=v * covariance, df=DEGREES).logpdf(r)
        for r, v in zip(residuals, variance, strict=True)
    ]
    assert np.diff(ours) == pytest.approx(np.diff(expected))
