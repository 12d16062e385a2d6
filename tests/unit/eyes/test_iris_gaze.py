"""Gaze from detected irises: projected middles of irises of eyes whose gaze is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from pipeline.eyes.gaze_estimate import GazeEstimate
from pipeline.eyes.iris_gaze import CORNERS, LEAST_ERROR_PX, LIDS, add_irises, combine_irises, openness, see_iris
from tests.support.avatars.painted_eyes import CENTER, LOOKS, RADIUS_M, SHAPE, cameras

TURN = Rotation.from_euler("YXZ", [20, -5, 8], degrees=True).as_matrix(), np.array([0.02, 0.1, -0.03])
HEAD = np.column_stack([TURN[0].T, -TURN[0].T @ TURN[1]])
UNCLEAR = GazeEstimate("unclear", np.full(3, np.nan), np.nan, 0.2, 5, 100)


def iris(camera, gaze):
    """The middle of the limbus's circle, sin = 0.49 of the eyeball's radius, in an image."""
    place = CENTER + RADIUS_M * np.sqrt(1 - 0.49**2) * gaze
    return camera.project((place @ TURN[0].T + TURN[1])[None])[0][0]


def irises(gaze, noise_px=0.0, seed=0):
    random = np.random.default_rng(seed)
    return [see_iris(iris(c, gaze) + random.normal(0, noise_px, 2), c, HEAD, CENTER, SHAPE) for c in cameras(TURN)]


def contour(side, gap, shift=0.0):
    """An eye 20 pixels wide whose lids are `gap` of that apart."""
    points = {corner: np.array([20.0 * k + shift, 0]) for k, corner in enumerate(CORNERS[side])}
    for k, (upper, lower) in enumerate(LIDS[side]):
        x = 7.0 * (k + 1) + shift
        points |= {upper: np.array([x, -10 * gap]), lower: np.array([x, 10 * gap])}
    return points


def off_deg(direction, gaze):
    return np.degrees(np.arccos(min(1.0, float(direction @ gaze))))


@pytest.mark.parametrize("gaze", LOOKS)
def test_middle_of_an_iris_lies_on_the_eyes_axis(gaze):
    for view in irises(gaze):
        np.testing.assert_allclose(view.axis, gaze, atol=1e-7)


def test_irises_stand_in_where_pixels_show_none_and_are_as_far_off_as_said():
    off = []
    for seed in range(40):
        found = combine_irises(UNCLEAR, irises(LOOKS[1], LEAST_ERROR_PX, seed), [])
        # An image along the rim of the eye may be left out.
        assert found.status == "estimated" and found.views >= 4
        off.append(off_deg(found.direction, LOOKS[1]) / found.sigma_deg)
    # Rayleigh's root mean square is the root of two; of 40, to 8 %.
    assert np.sqrt(np.mean(np.square(off))) == pytest.approx(np.sqrt(2), rel=0.35)


def test_pixels_and_irises_are_weighed_by_their_variances():
    pixels = GazeEstimate("estimated", LOOKS[0], 1.0, 0.8, 5, 100)
    both = combine_irises(pixels, irises(LOOKS[1]), [])
    sigma = np.degrees(np.mean([view.sigma for view in irises(LOOKS[1])])) / np.sqrt(5)
    apart = off_deg(LOOKS[1], LOOKS[0])
    # They are 17 degrees apart: what is known is no better than that.
    assert both.sigma_deg == pytest.approx((1 + sigma**-2) ** -0.5 * apart / np.sqrt(2 * (1 + sigma**2)), rel=1e-3)
    agree = combine_irises(replace(pixels, direction=LOOKS[1]), irises(LOOKS[1]), [])
    assert agree.sigma_deg == pytest.approx((1 + sigma**-2) ** -0.5)
    share = off_deg(both.direction, LOOKS[0]) / apart
    assert share == pytest.approx(sigma**-2 / (1 + sigma**-2), abs=0.02)


def test_iris_elsewhere_in_one_image_is_left_out():
    views = irises(LOOKS[0])
    views[2] = irises(Rotation.from_euler("Y", 40, degrees=True).apply(LOOKS[0]))[2]
    assert off_deg(combine_irises(UNCLEAR, views, []).direction, LOOKS[0]) < 0.1
    assert combine_irises(UNCLEAR, views[:1], []) is UNCLEAR


def test_closed_lids_hide_an_eye_though_irises_are_detected():
    assert openness(contour("left", 0.3), "left") == pytest.approx(0.3)
    assert np.isnan(openness({"face_42": np.zeros(2)}, "left"))
    found = combine_irises(UNCLEAR, irises(LOOKS[0]), [0.03, 0.05, 0.3, np.nan])
    assert found.status == "hidden" and np.isnan(found.direction).all()


def test_sides_are_told_by_place_whatever_eyes_are_called():
    """Frame 4 shows the eye open and looking to a side; frame 6 closed. The other side's points lie 30 px beside."""
    rows, rig = [], {f"cam{k}": camera for k, camera in enumerate(cameras(TURN))}
    for frame, gap in ((4, 0.3), (6, 0.02)):
        for name, camera in rig.items():
            pixel = iris(camera, LOOKS[1])
            middle = camera.project((CENTER @ TURN[0].T + TURN[1])[None])[0][0]
            shown = {p: at + middle - [10, 0] for p, at in contour("right", gap).items()} | {"right_pupil": pixel}
            shown |= {p: at + middle + [30, 0] for p, at in contour("left", gap).items()} | {"left_pupil": pixel + 30}
            rows += [(frame, name, point, *at, 0.9) for point, at in shown.items()]
    table = pd.DataFrame(rows, columns=["frame", "camera", "point", "x", "y", "confidence"])
    sphere = np.array([*CENTER, RADIUS_M])
    found = add_irises(
        {"eye_a": [UNCLEAR, UNCLEAR, UNCLEAR]}, table, [4, 5, 6], rig, dict.fromkeys((4, 5, 6), HEAD),
        {"eye_a": sphere}, {"eye_a": SHAPE},
    )["eye_a"]  # fmt: skip
    assert [each.status for each in found] == ["estimated", "unclear", "hidden"]
    assert off_deg(found[0].direction, LOOKS[1]) < 0.1
