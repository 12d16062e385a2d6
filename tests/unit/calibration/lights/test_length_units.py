"""One of three lengths in another unit: which, and by how much, whether it is too large or too small."""

from __future__ import annotations

import pytest

from pipeline.calibration.lights.length_units import unit_complaint

TOLERANCE = 0.05

LENGTHS = {
    "x, y, z": lambda factor: (1.0, factor),
    "calibration.lights.radius_m": lambda factor: (factor, 1.0),
    "calibration.cameras.square_m": lambda factor: (factor, 1 / factor),
}
"""By key of the length that is wrong: ratio of the ball in the rig to what is said, and of the survey to the rig."""


@pytest.mark.parametrize("key", LENGTHS)
@pytest.mark.parametrize(
    ("factor", "unit"),
    [
        (1000.0, "millimetres for metres"), (0.001, "metres for millimetres"), (100.0, "centimetres for metres"),
        (39.37, "inches for metres"), (1 / 3.281, "metres for feet"), (1.06, ""), (1 / 1.06, ""),
    ],
)  # fmt: skip
def test_odd_length_is_named_whether_too_large_or_too_small(key, factor, unit):
    _, named, _, found, _ = unit_complaint(*LENGTHS[key](factor), TOLERANCE)
    assert named == key
    assert (f"({unit}?)" in found) if unit else "?)" not in found


@pytest.mark.parametrize("factor", [1.0, 1.04, 1 / 1.04])
def test_lengths_that_agree_raise_no_complaint(factor):
    assert all(unit_complaint(*lengths(factor), TOLERANCE) is None for lengths in LENGTHS.values())


def test_two_odd_lengths_are_not_blamed_on_one():
    assert unit_complaint(100.0, 3.0, TOLERANCE)[1] == "calibration"
