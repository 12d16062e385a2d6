"""Shares of the images in which boards are looked for."""

from __future__ import annotations

import pytest

from pipeline.calibration.cameras.board_tables import places_of_share

VIEWS = [{"camera": camera, "view": view} for view in range(10) for camera in "cab"]


@pytest.mark.parametrize("shares", [1, 2, 3, 7, 30, 40])
def test_shares_have_each_image_once_and_are_alike(shares):
    chosen = [places_of_share(VIEWS, share, shares) for share in range(shares)]
    assert sorted(place for share in chosen for place in share) == list(range(30))
    assert max(map(len, chosen)) - min(map(len, chosen)) <= 1


@pytest.mark.parametrize("shares", [2, 3, 7, 30])
def test_images_of_a_camera_lie_in_few_shares(shares):
    """A share borders on the next within a camera, or between two: together they have as many cameras more."""
    cameras = [{VIEWS[place]["camera"] for place in places_of_share(VIEWS, share, shares)} for share in range(shares)]
    assert sum(map(len, cameras)) <= 3 + shares - 1
