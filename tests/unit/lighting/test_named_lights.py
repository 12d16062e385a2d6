"""Lights of the stage by name: what refinement found changes all that they shine in."""

import numpy as np
import pandas as pd

from pipeline.lighting.named_lights import NamedLights


def test_brighter_lights_are_brighter_in_all_patterns():
    patterns = pd.DataFrame(
        {"frame": [0, 0, 1], "light": [0, 1, 1], "intensity_r": [1.0, 2.0, 4.0], "intensity_g": 1.0, "intensity_b": 0.5}
    )
    stage = NamedLights(["a", "b"], np.eye(2, 3), np.ones((2, 3)), patterns)
    brighter = stage.brightened(np.array([1.5, 0.5], np.float32))
    assert brighter.pattern(0) == [[0, 1.5, 1.5, 0.75], [1, 1.0, 0.5, 0.25]]
    assert brighter.pattern(1) == [[1, 2.0, 0.5, 0.25]]
    np.testing.assert_array_equal(brighter.intensities, [[1.5] * 3, [0.5] * 3])
    assert stage.pattern(1) == [[1, 4.0, 1.0, 0.5]]


def test_moved_lights_stand_elsewhere_and_shine_as_before():
    shone = {"frame": [0], "light": [1], "intensity_r": [1.0], "intensity_g": [1.0], "intensity_b": [1.0]}
    stage = NamedLights(["a", "b"], np.array([[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]]), np.ones((2, 3)), pd.DataFrame(shone))
    moved = stage.moved(np.array([[0.5, 0.0, -0.5], [0.0, 0.0, 0.0]], np.float32))
    np.testing.assert_array_equal(moved.positions, [[0.5, 1.0, 1.5], [3.0, 4.0, 5.0]])
    assert moved.pattern(0) == stage.pattern(0)
