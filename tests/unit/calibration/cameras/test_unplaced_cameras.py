"""Complaints about cameras that features do not place: they say what was shared, and what it lacks."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.base.errors import InputError
from pipeline.calibration.cameras.feature_matches import PairMatches
from pipeline.calibration.cameras.unplaced_cameras import LEAST_MATCHES, complain_of_unplaced

CAMERAS = ["a", "b", "c"]


def complaint(placed, *matches):
    with pytest.raises(InputError) as refused:
        complain_of_unplaced(Path("somewhere"), CAMERAS, placed, matches)
    return str(refused.value)


def test_camera_with_few_matches_is_told_with_how_many_and_of_which_camera():
    few = PairMatches("b", "c", 54, LEAST_MATCHES - 1, False)
    text = complaint(["a", "b"], PairMatches("a", "b", 900, 700, False), PairMatches("a", "c", 18, 0, False), few)
    assert "1 problem" in text and "camera c: expected 30 points" in text
    # The most that it shares comes first.
    assert "found 29 that fit one pose with b (of 54 alike); 0 that fit one pose with a (of 18 alike)" in text
    assert "20 degrees apart" in text and "900" not in text


def test_camera_whose_matches_lie_on_a_plane_is_told_so():
    text = complaint(["b", "c"], PairMatches("a", "b", 900, 800, True))
    assert "800 that fit one pose with b, on one plane or from one place (of 900 alike)" in text
    assert "fills depth" in text


def test_camera_with_many_matches_is_not_told_that_they_are_few():
    text = complaint([], PairMatches("a", "b", 1791, 1500, False), PairMatches("a", "c", 0, 0, False))
    first, second, third = text.splitlines()[1:]
    for line in (first, second):
        assert "1500 that fit one pose" in line and "too nearly parallel" in line and "20 degrees" not in line
    assert "camera c" in third and "20 degrees" in third


def test_rig_of_which_all_are_placed_is_not_refused():
    complain_of_unplaced(Path("somewhere"), CAMERAS, CAMERAS, [])
