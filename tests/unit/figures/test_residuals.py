"""What the pictures of corners and residuals are drawn from."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from pipeline.calibration.cameras.image_coverage import count_cells
from pipeline.figures.corners import worst_view
from pipeline.figures.residual_arrows import magnification, round_length
from pipeline.figures.residual_histogram import normalised


def test_cells_count_corners_by_row_and_column():
    pixels = np.array([[1.0, 1.0], [639.9, 0.1], [639.9, 479.9], [85.0, 65.0], [90.0, 70.0]])
    counts = count_cells(pixels, 640, 480)
    assert counts.sum() == 5
    assert {(int(r), int(c)): int(counts[r, c]) for r, c in np.argwhere(counts)} == {
        (0, 0): 1,
        (0, 7): 1,
        (7, 7): 1,
        (1, 1): 2,
    }


def test_worst_view_is_the_one_with_the_largest_residuals():
    table = pd.DataFrame(
        {"view": [3, 3, 5, 5, 8], "residual_x": [0.1, 0, 0, 0.4, 0.2], "residual_y": [0, 0.1, 0.1, 0, 0]}
    )
    assert worst_view(table) == 5


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e2])
def test_arrows_fit_their_panels(scale):
    rng = np.random.default_rng(0)
    table = pd.DataFrame(scale * rng.normal(size=(500, 2)), columns=["residual_x", "residual_y"])
    factor = magnification(table, 640)
    long = np.percentile(np.hypot(table.residual_x, table.residual_y), 90) * factor
    assert long <= 0.12 * 640 or factor == 1


def test_lengths_of_the_key_have_one_digit():
    assert [round_length(x) for x in (0.23, 0.099, 7.0, 0.00051)] == [0.2, 0.05, 5.0, 0.0005]


def test_normal_residuals_have_unit_spread_whatever_their_noise():
    """10,000 numbers of each kind: their spread is known to 1 / sqrt(20,000) = 0.7 %, from a median to twice that."""
    rng = np.random.default_rng(0)
    corner = pd.DataFrame(rng.normal(0, 0.05, (5000, 2)), columns=["residual_x", "residual_y"])
    patches = [
        pd.DataFrame(sigma * rng.normal(size=(3334, 3)), columns=["residual_r", "residual_g", "residual_b"]).assign(
            camera=c
        )
        for c, sigma in (("a", 1e-3), ("b", 2e-2))
    ]
    unused = pd.DataFrame({"kind": ["patch"], "camera": ["a"], "residual_r": [np.nan]})
    table = pd.concat([corner.assign(kind="corner", camera="a"), *(p.assign(kind="patch") for p in patches), unused])
    for kind, count in (("corner", 10_000), ("patch", 20_004)):
        values = normalised(table, kind)
        assert len(values) == count
        assert np.std(values) == pytest.approx(1, abs=0.03)
