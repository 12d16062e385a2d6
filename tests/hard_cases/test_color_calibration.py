"""Charts as they come out of a busy day: each is either calibrated to the truth, or named with what to do."""

from __future__ import annotations

import logging

import cv2
import numpy as np
import pandas as pd
import pytest

from pipeline.base.color import srgb_from_linear
from pipeline.base.errors import InputError
from pipeline.capture.images import read_stored
from pipeline.config.calibrate_color import CalibrateColor
from pipeline.figures.refused_chart import ODD
from pipeline.stages.calibrate_color import run
from tests.support.drawings.chart import (
    VALUES,
    WIDTH,
    camera_responses,
    chart_pixels,
    corners_of_chart,
    draw_chart,
    errors_of_corrections,
    write_chart_capture,
)

TOLERANCE = 5e-3
"""Of a corrected response, over its gain: medians of 300 pixels of noise 0.003, and half floats, are a fifth of it."""

PLANTED = camera_responses(2)


def write_capture(folder, change, **options):
    """Two cameras; `change` makes the second one's image from its response."""
    images = {"cam0": draw_chart(PLANTED["cam0"], seed=1), "cam1": change(PLANTED["cam1"])}
    return write_chart_capture(folder, images, **options)


def verdict(folder):
    table = pd.read_csv(folder / "out/verdicts_color.csv").set_index("name")
    assert table.grade["cam0"] == "good"
    return table.loc["cam1"]


def refused(paths, caplog, settings=None):
    with caplog.at_level(logging.INFO), pytest.raises(InputError) as caught:
        run(**paths, settings=settings or CalibrateColor())
    # Nothing but a picture of what was refused.
    assert [path.name for path in paths["out"].iterdir()] == ["refused_color_cam1.png"]
    assert str(paths["out"] / "refused_color_cam1.png") in str(caught.value)
    assert "color cam1: failed: " in caplog.text
    assert "color cam0: failed: " not in caplog.text
    return str(caught.value)


def turned(turns):
    return lambda response: np.rot90(draw_chart(response), turns)


@pytest.mark.parametrize(
    "change", [turned(2), turned(1), turned(3)], ids=["upside down", "turned left", "turned right"]
)
def test_a_turned_chart_is_calibrated(case, tmp_path, change):
    run(**write_capture(tmp_path, change))
    assert verdict(tmp_path).grade == "good"
    case.check(max(errors_of_corrections(tmp_path, PLANTED).values()), TOLERANCE)


def test_a_mirrored_image_is_calibrated_and_named(case, tmp_path):
    run(**write_capture(tmp_path, lambda response: draw_chart(response)[:, ::-1]))
    assert verdict(tmp_path).grade == "weak"
    assert "found a mirrored chart" in verdict(tmp_path).reason
    case.check(max(errors_of_corrections(tmp_path, PLANTED).values()), TOLERANCE)


def test_saturated_patches_are_left_out(case, tmp_path):
    """Clipped at full scale, as a sensor does it: white, and the reds of some others."""
    run(**write_capture(tmp_path, lambda response: np.minimum(draw_chart(1.8 * response), 1.0)))
    residuals = pd.read_parquet(tmp_path / "out/residuals_color.parquet")
    used = residuals[residuals.camera == "cam1"].set_index("patch").used
    assert not used[19]
    assert 12 <= used.sum() < 24
    planted = PLANTED | {"cam1": 1.8 * PLANTED["cam1"]}
    case.check(max(errors_of_corrections(tmp_path, planted).values()), TOLERANCE)


def test_saturation_is_seen_under_a_black_level(case, tmp_path):
    """A clipped pixel is below 1 once the black level is subtracted."""
    images = {name: np.minimum(draw_chart(1.8 * response) + 0.1, 1.0) for name, response in PLANTED.items()}
    run(**write_chart_capture(tmp_path, images, black_level=0.1))
    case.check(max(errors_of_corrections(tmp_path, {n: 1.8 * r for n, r in PLANTED.items()}).values()), TOLERANCE)


def test_a_saturated_chart_is_refused(tmp_path, caplog):
    message = refused(write_capture(tmp_path, lambda response: np.minimum(draw_chart(60 * response), 1.0)), caplog)
    assert "cam1.exr: camera cam1: expected a 24-patch chart, found none, and" in message
    assert "of the image saturated" in message


def test_a_saturated_chart_whose_corners_are_given_is_refused(tmp_path, caplog):
    corners = {"cam1": corners_of_chart().tolist()}
    paths = write_capture(tmp_path, lambda response: np.minimum(draw_chart(60 * response), 1.0), corners=corners)
    assert "found 0 of 24; expose less, " in refused(paths, caplog)


def test_a_chart_not_found_asks_for_its_corners(tmp_path, caplog):
    message = refused(write_capture(tmp_path, lambda _: np.full((100, 120, 3), 0.2, np.float32)), caplog)
    assert "cam1.exr: camera cam1: expected a 24-patch chart, found none; " in message
    assert "calibration.color.corners" in message


def hidden(left, right):
    """A hand in front of the columns between."""

    def change(response):
        image = draw_chart(response)
        corners = chart_pixels((left, -0.5), (right, -0.5), (right, 4.5), (left, 4.5))
        return cv2.fillConvexPoly(image, np.round(corners).astype(np.int32), (0.4, 0.25, 0.2))

    return change


@pytest.mark.parametrize("columns", [(-0.5, 3), (3, 6.5)], ids=["left half", "right half"])
def test_a_chart_half_hidden_is_refused_with_a_picture(tmp_path, caplog, columns):
    """The picture crosses patches out: there is orange in the hidden half."""
    paths = write_capture(tmp_path, hidden(*columns))
    message = refused(paths, caplog)
    assert "is part of it hidden" in message
    picture = read_stored(paths["out"] / "refused_color_cam1.png")
    left, right = np.clip(columns, 0, 6)
    half = chart_pixels((left, 0), (left, 4), (right, 4), (right, 0)) * picture.shape[1] / WIDTH
    inside = cv2.fillConvexPoly(np.zeros(picture.shape[:2], np.uint8), np.round(half).astype(np.int32), 1)
    orange = (np.abs(picture.astype(int) - ODD) < 10).all(-1)
    assert orange[inside > 0].sum() > 500


def test_a_third_of_a_chart_hidden_is_calibrated_and_named(case, tmp_path):
    run(**write_capture(tmp_path, hidden(4, 6.5)))
    assert verdict(tmp_path).grade == "weak"
    assert "at patches 5, 6, 11, 12, 17 ... (8 in all)" in verdict(tmp_path).reason
    case.check(max(errors_of_corrections(tmp_path, PLANTED).values()), TOLERANCE)


def test_pictures_of_refused_charts_go_once_the_chart_is_sound(tmp_path, caplog):
    refused(write_capture(tmp_path, hidden(3, 6.5)), caplog)
    run(**write_capture(tmp_path, draw_chart))
    assert not list((tmp_path / "out").glob("refused_*"))


def behind_wires(response):
    """Wires of 6 pixels, 40 apart, cut through all outlines; most of each patch shows."""
    image = draw_chart(response)
    rows, columns = np.mgrid[0 : image.shape[0], 0 : image.shape[1]]
    image[(columns - rows) % 40 < 6] = 0.5
    return image


def test_given_corners_stand_in_for_the_detector(case, tmp_path, caplog):
    assert "calibration.color.corners" in refused(write_capture(tmp_path, behind_wires), caplog)
    run(**write_capture(tmp_path, behind_wires, corners={"cam1": corners_of_chart().tolist()}))
    assert verdict(tmp_path).grade == "good"
    # A sixth of the pixels are wire: medians move by a fifth of the noise.
    case.check(max(errors_of_corrections(tmp_path, PLANTED).values()), TOLERANCE)


def test_corners_in_the_wrong_place_are_refused(tmp_path, caplog):
    corners = {"cam1": (corners_of_chart() + np.array([60, 40])).tolist()}
    message = refused(write_capture(tmp_path, draw_chart, corners=corners), caplog)
    assert "are the corners in order?" in message


def test_a_chart_under_another_light_is_refused(tmp_path, caplog):
    """Light of an incandescent lamp for one camera, daylight for the others: red to blue changes by a factor of 5."""
    lamp = np.diag([1.1, 0.5, 0.2])
    images = {name: draw_chart(response) for name, response in camera_responses(4).items()}
    images["cam1"] = draw_chart(camera_responses(4)["cam1"] @ lamp)
    message = refused(write_chart_capture(tmp_path, images), caplog)
    assert "camera cam1: expected the median camera's white within a factor of 2, found" in message
    assert "light the chart alike for all cameras" in message


def test_a_chart_under_dimmed_light_is_named(tmp_path):
    images = {name: draw_chart(response) for name, response in camera_responses(4).items()}
    images["cam1"] = draw_chart(0.5 * camera_responses(4)["cam1"])
    run(**write_chart_capture(tmp_path, images))
    assert verdict(tmp_path).grade == "weak"
    assert "times darker; fine if its exposure differs" in verdict(tmp_path).reason


def test_another_chart_is_refused(tmp_path, caplog):
    values = np.random.default_rng(3).permutation(VALUES)
    corners = {"cam1": corners_of_chart().tolist()}
    paths = write_capture(tmp_path, lambda response: draw_chart(response, values), corners=corners)
    assert "is it the chart that patches describes" in refused(paths, caplog)


def test_the_wrong_transfer_is_refused(tmp_path, caplog):
    """sRGB values that are read as linear."""
    paths = write_capture(tmp_path, lambda response: srgb_from_linear(np.clip(draw_chart(response), 0, 1)))
    assert "is transfer right" in refused(paths, caplog)


def test_a_dirty_patch_does_not_tint_the_camera(case, tmp_path):
    values = VALUES.copy()
    values[7] *= 0.2
    values[15] += [-0.2, 0.1, 0.3]
    run(**write_capture(tmp_path, lambda response: draw_chart(response, values)))
    assert verdict(tmp_path).grade == "weak"
    assert "at patches 8, 16; are they dirty" in verdict(tmp_path).reason
    case.check(max(errors_of_corrections(tmp_path, PLANTED).values()), TOLERANCE)


def test_uneven_light_is_named(tmp_path):
    """A lamp close by: a third brighter on one side."""
    run(**write_capture(tmp_path, lambda response: draw_chart(response, light=lambda at: 1 + at[:, 0] / 18)))
    assert verdict(tmp_path).grade == "weak"
    assert "is the light uneven across the chart" in verdict(tmp_path).reason


def test_patches_of_one_hue_are_refused(tmp_path, caplog):
    """All that is not grey saturated or covered: nothing tells the channels apart."""
    values = VALUES.copy()
    values[:18] = 1.6
    corners = {"cam1": corners_of_chart().tolist()}
    paths = write_capture(tmp_path, lambda response: np.minimum(draw_chart(response, values), 1.0), corners=corners)
    message = refused(paths, caplog, CalibrateColor(least_patches=6))
    assert "the patches that are left are of too few hues" in message


def test_a_chart_under_two_lights_of_other_colours_is_refused(tmp_path, caplog):
    """Daylight on its left half, an incandescent lamp on its right: no one response fits."""
    lamp = np.diag([1.1, 0.5, 0.2])

    def two_lights(response):
        right = draw_chart(response @ lamp)
        middle = int(chart_pixels((3, 2))[0, 0])
        image = draw_chart(response)
        image[:, middle:] = right[:, middle:]
        return image

    assert "hidden, out of the image or under another light?" in refused(write_capture(tmp_path, two_lights), caplog)


def test_hot_pixels_change_nothing(case, tmp_path):
    """One pixel in 500 at full scale, in one channel each: they count as saturated, too few to spoil a patch."""

    def with_hot_pixels(response):
        image = draw_chart(response)
        random = np.random.default_rng(5)
        hot = random.integers(0, image.size, image.size // 1500)
        image.reshape(-1)[hot] = 1.0
        return image

    run(**write_capture(tmp_path, with_hot_pixels))
    assert verdict(tmp_path).reason.startswith("24 patches") and verdict(tmp_path).grade == "good"
    case.check(max(errors_of_corrections(tmp_path, PLANTED).values()), TOLERANCE)
