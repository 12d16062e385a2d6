"""Units of poses, decided by lights of known places."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.datasets.stage_units import extent, unit_of_stage

UNITS = {0.001: "millimetres", 1.0: "metres"}


def on_a_sphere(count: int, radius: float, seed: int) -> np.ndarray:
    directions = np.random.default_rng(seed).normal(size=(count, 3))
    return radius * directions / np.linalg.norm(directions, axis=1, keepdims=True) + [0.75, 1.6, 0.5]


@pytest.mark.parametrize("metres", UNITS)
def test_cameras_among_the_lights_say_their_unit_whatever_the_stages_middle(metres):
    """A middle as far from the origin as lights are from it: cameras shrunk into the origin do not pass for near."""
    lights, cameras = on_a_sphere(200, 1.6, 0), on_a_sphere(35, 1.9, 1)
    found, said = unit_of_stage(cameras / metres, lights, UNITS, "set")
    assert found == metres
    assert f"poses in {UNITS[metres]}" in said and all(name in said for name in UNITS.values())


def test_units_between_the_known_ones_are_refused_with_all_numbers():
    lights = on_a_sphere(200, 1.6, 0)
    with pytest.raises(InputError, match=r"millimetres 0.01\d*, metres 1\d"):
        unit_of_stage(12 * lights, lights, UNITS, "set")


def test_extent_is_the_median_distance_from_the_mean():
    assert extent(np.array([[1.0, 0, 0], [5, 0, 0], [3, 0, 0]])) == pytest.approx(2.0)
