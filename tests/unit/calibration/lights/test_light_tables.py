"""Tables of lights: what turns with the stage, and how."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from pipeline.calibration.lights.light_tables import BRIGHTNESS, COVARIANCE, place_in_stage
from pipeline.config.calibrate_lights import CalibrateLights
from pipeline.geometry.rigid_alignment import Alignment


def test_covariances_turn_with_their_lights() -> None:
    """The upper triangle of R C R^T, of covariances that are long in one direction; the transpose turns them back."""
    rng, names = np.random.default_rng(11), ["L0", "L1", "L2", "L3"]
    R, t = Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix(), np.array([0.3, 1.0, -0.2])
    points = rng.normal(size=(4, 3))
    spread = rng.normal(size=(4, 3, 3)) * [0.001, 0.01, 0.05]
    full = spread @ spread.transpose(0, 2, 1)
    upper = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]
    facts = pd.DataFrame(points, index=pd.Index(names, name="light"), columns=["x", "y", "z"])
    facts[COVARIANCE] = np.array([[one[place] for place in upper] for one in full])
    facts[BRIGHTNESS] = 1.0
    facts = facts.assign(why="", no_intensity="", no_color="", sigma_m=0.01)
    survey = pd.DataFrame(points @ R.T + t, columns=["x", "y", "z"]).assign(light=names)
    alignment = Alignment(R, t, np.zeros((4, 3)), np.ones(4), 0.0)
    lights = place_in_stage(facts, survey, alignment, False, CalibrateLights())
    np.testing.assert_allclose(lights[["x", "y", "z"]], survey[["x", "y", "z"]], atol=1e-12)
    for row, one in zip(lights[COVARIANCE].to_numpy(), full, strict=True):
        turned = R @ one @ R.T
        np.testing.assert_allclose(row, [turned[place] for place in upper], rtol=0, atol=1e-15)
    kept = place_in_stage(facts, survey, alignment, True, CalibrateLights())
    np.testing.assert_array_equal(kept[COVARIANCE], facts[COVARIANCE])
