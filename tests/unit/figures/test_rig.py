"""The ellipses of the lights."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from matplotlib.patches import Ellipse

from pipeline.figures.rig import light_covariances, one_sigma_ellipse


def test_covariances_are_read_in_the_order_of_their_names():
    numbers = {"cov_xx": 1.0, "cov_xy": 2.0, "cov_xz": 3.0, "cov_yy": 4.0, "cov_yz": 5.0, "cov_zz": 6.0}
    table = pd.DataFrame([numbers, dict.fromkeys(numbers, np.nan)])
    found = light_covariances(table)
    assert found[0].tolist() == [[1, 2, 3], [2, 4, 5], [3, 5, 6]]
    assert np.isnan(found[1]).all()


@pytest.mark.parametrize(
    "entries", [(4.0, 0.0, 1.0), (1.0, 0.0, 4.0), (2.0, -1.2, 3.0), (1.0, 0.999, 1.0), (1.0, 0.0, 0.0)]
)
def test_ellipse_is_one_standard_deviation(entries):
    """Points on the drawn outline are one standard deviation away; along any line, so is its widest extent."""
    xx, xy, yy = entries
    covariance = np.array([[xx, xy], [xy, yy]])
    width, height, angle = one_sigma_ellipse(covariance)
    shape = Ellipse((0, 0), width, height, angle=angle)
    outline = shape.get_patch_transform().transform(
        np.stack([np.cos(t := np.linspace(0, 2 * np.pi, 721)), np.sin(t)], 1)
    )
    for direction in np.random.default_rng(0).normal(size=(8, 2)):
        expected = np.sqrt(direction @ covariance @ direction)
        assert (outline @ direction).max() == pytest.approx(expected, rel=1e-4, abs=1e-6)
