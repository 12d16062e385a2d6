"""Lights of environments that images of single lights tell, and where these tell nothing."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from pipeline.datasets.environment_weights import StageImages, environment_patterns, fit_weights
from pipeline.datasets.imported_capture import Provenance

FULL, ENVIRONMENT = 14, 3


def test_weights_of_lights_that_differ_are_found():
    rng = np.random.default_rng(0)
    lit, true = rng.uniform(0, 0.05, (6, 400, 3)), rng.uniform(0, 2, (6, 3))
    weights, misfit = fit_weights(lit, np.einsum("lbc,lc->bc", lit, true))
    np.testing.assert_allclose(weights, true, atol=0.02)
    assert misfit < 1e-3


@pytest.fixture
def stage(tmp_path):
    """A stage with one camera that saw all lights, one light alone, and an environment that is black."""
    numbers = {FULL: 120, 15: 60, ENVIRONMENT: 0}
    for number, value in numbers.items():
        cv2.imwrite(str(tmp_path / f"{number}.png"), np.full((8, 8, 3), value, np.uint8))
    return StageImages(tmp_path, {"a": {number: f"{number}.png" for number in numbers}}, {15: "L000"}, FULL)


def test_environment_without_light_is_left_out_and_named(stage):
    provenance = Provenance()
    with np.errstate(divide="ignore"):
        assert environment_patterns(stage, ["a"], [ENVIRONMENT], {"L000": 1.0}, provenance).empty
    assert provenance.left_out["images that single lights do not explain"].startswith(f"{ENVIRONMENT} ")


def test_environments_without_images_of_single_lights_are_not_taken(stage):
    alone = StageImages(stage.root, stage.paths, {}, FULL)
    assert environment_patterns(alone, ["a"], [ENVIRONMENT], {}, Provenance()).empty
