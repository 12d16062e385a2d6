"""What goes wrong when lights are calibrated from mirror balls: each case with the message or the bound it has to meet.

The capture is drawn (tests/support/drawings/balls.py); every case changes one thing in it.
"""

from __future__ import annotations

import cv2
import numpy as np
import pandas as pd
import pytest

from pipeline.base.errors import InputError
from pipeline.base.files import read_table, write_table
from pipeline.config.calibrate_lights import CalibrateLights
from pipeline.stages.calibrate_lights import run
from tests.support.drawings.balls import edit_json, light_images, paths, planted_lights, variant, write_ball_capture

LENIENT = CalibrateLights(largest_sigma_m=0.06)
"""These balls are 37 px in radius: a light here is good to 5 mm, and one in five to 30 only."""


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    folder = tmp_path_factory.mktemp("original")
    write_ball_capture(folder)
    return folder


@pytest.fixture
def folder(original, tmp_path):
    return variant(original, tmp_path / "capture")


def calibrate(folder, settings=LENIENT):
    """lights.parquet by light, and (grade, reason) by (kind, name)."""
    run(**paths(folder, folder / "out"), settings=settings)
    table = pd.read_csv(folder / "out/verdicts_lights.csv")
    verdicts = {
        (row.kind, row.name_): (row.grade, row.reason) for row in table.rename(columns={"name": "name_"}).itertuples()
    }
    return read_table(folder / "out/lights.parquet").set_index("light"), verdicts


def distances_off(lights, names):
    """Largest error of the distances between lights: free of where the survey puts the stage."""
    found = lights.loc[names, ["x", "y", "z"]].to_numpy(np.float64)
    true = planted_lights()[[int(name[1:]) for name in names]]
    return np.abs(np.linalg.norm(found[:, None] - found, axis=2) - np.linalg.norm(true[:, None] - true, axis=2)).max()


def change_survey(folder, change):
    table = read_table(folder / "index/lights.parquet")
    change(table)
    write_table(folder / "index/lights.parquet", table)


def scale_survey(folder, factor):
    def scale(table):
        table[["x", "y", "z"]] *= factor

    change_survey(folder, scale)


def scale_rig(folder, factor):
    def scale(content):
        for camera in content["cameras"].values():
            camera["t"] = [factor * value for value in camera["t"]]

    edit_json(folder / "rig.json", scale)


def test_a_ball_at_the_border_of_an_image(folder):
    path = folder / "east_0_None.png"
    gray = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    columns = np.flatnonzero((gray < 90).any(0))
    # The same ball, cut off by the left border through its middle.
    cut = np.full_like(gray, gray[0, 0])
    cut[:, : gray.shape[1] - int(columns.mean())] = gray[:, int(columns.mean()) :]
    cv2.imwrite(str(path), cut)
    lights, verdicts = calibrate(folder)
    grade, reason = verdicts["ball", "0"]
    assert grade == "weak"
    assert "outlines in 2 cameras" in reason
    assert "east: a ball that touches the image's border" in reason
    assert verdicts["ball", "1"][0] == "good"
    assert (lights.status == "measured").sum() >= 9


def test_a_dead_led(folder):
    for path in light_images(folder, "L4"):
        cv2.imwrite(str(path), np.full((300, 300), 3, np.uint8))
    lights, verdicts = calibrate(folder)
    grade, reason = verdicts["light", "L4"]
    assert grade == "failed"
    assert reason.startswith("no highlight in 6 images: is the LED dead?; keeps its surveyed position")
    assert lights.status["L4"] == "surveyed"
    survey = read_table(folder / "index/lights.parquet").set_index("light")
    assert np.array_equal(lights.loc["L4", ["x", "y", "z"]], survey.loc["L4", ["x", "y", "z"]])


def test_two_leds_on_in_all_images_of_one(folder):
    for path, other in zip(light_images(folder, "L3"), light_images(folder, "L7"), strict=True):
        both = np.maximum(cv2.imread(str(path), 0), cv2.imread(str(other), 0))
        cv2.imwrite(str(path), both)
    lights, verdicts = calibrate(folder)
    grade, reason = verdicts["light", "L3"]
    assert grade == "failed"
    assert reason.startswith("two lights shine in its images: ")
    assert lights.status["L3"] == "surveyed"
    assert lights.status["L7"] == "measured"


def test_a_reflection_of_something_else_in_some_images(case, folder):
    plain, _ = calibrate(folder)
    for path in light_images(folder, "L3")[::3]:
        image = cv2.imread(str(path), 0)
        silhouette = cv2.imread(str(path.with_name(path.name.replace("_3.", "_None."))), 0)
        middle = np.argwhere(silhouette < 90).mean(0)
        cv2.circle(image, (int(middle[1]) + 8, int(middle[0]) - 12), 2, 200, -1, cv2.LINE_AA)
        cv2.imwrite(str(path), image)
    lights, verdicts = calibrate(folder)
    assert verdicts["light", "L3"][0] != "failed"
    moved = (lights.loc["L3", ["x", "y", "z"]] - plain.loc["L3", ["x", "y", "z"]]).to_numpy(np.float64)
    case.check(np.linalg.norm(moved), 3 * np.sqrt(3) * plain.sigma_m["L3"], unit="m")


def test_a_window_in_all_images_is_no_light(case, folder, caplog):
    """Brighter than some highlights, fainter than others; and one LED is dead, so that it is all that shines."""
    for light in range(len(planted_lights())):
        for path in light_images(folder, f"L{light}"):
            image = cv2.imread(str(path), 0) if light != 4 else np.full((300, 300), 3, np.uint8)
            silhouette = cv2.imread(str(path.with_name(path.name.replace(f"_{light}.", "_None."))), 0)
            row, column = np.argwhere(silhouette < 90).mean(0)
            cv2.circle(image, (int(column) - 10, int(row) + 9), 1, 35, -1, cv2.LINE_AA)
            cv2.imwrite(str(path), image)
    lights, verdicts = calibrate(folder)
    assert "at one place whichever light is on" in caplog.text
    assert verdicts["light", "L4"][1].startswith("no highlight in 6 images: is the LED dead?")
    sure = lights.index[(lights.status == "measured") & (lights.sigma_m < 0.01)]
    assert len(sure) >= 5
    case.check(distances_off(lights, list(sure)), 0.05, unit="m")


def test_hot_pixels_are_no_highlights(case, folder):
    """One pixel in 5000 at full scale, the same in all of a camera's images: brighter than the highlights."""
    plain, _ = calibrate(folder)
    for number, camera in enumerate(("east", "north", "west")):
        hot = np.random.default_rng(number).random((300, 300)) < 1 / 5000
        for path in folder.glob(f"{camera}_*.png"):
            cv2.imwrite(str(path), np.where(hot, np.uint8(255), cv2.imread(str(path), 0)))
    lights, _ = calibrate(folder)
    measured = plain.index[plain.status == "measured"]
    assert (lights.status[measured] == "measured").all()
    places = [table.loc[measured, ["x", "y", "z"]].to_numpy(np.float64) for table in (plain, lights)]
    moved = np.linalg.norm(places[1] - places[0], axis=1) / lights.sigma_m[measured].to_numpy()
    # Those that lie on a highlight or on an outline move a light within its error bars.
    assert np.median(moved) < 0.1
    case.check(moved.max(), 3 * np.sqrt(3), unit="sigma")


def test_swapped_names(folder):
    def swap(table):
        rows = [table.index[table.light == name][0] for name in ("L3", "L7")]
        table.loc[rows, "light"] = ["L7", "L3"]

    change_survey(folder, swap)
    _, verdicts = calibrate(folder)
    for name in ("L3", "L7"):
        grade, reason = verdicts["light", name]
        assert grade == "weak"
        assert "names of L3 and L7 look swapped" in reason


def test_a_light_that_was_moved(folder):
    def move(table):
        table.loc[table.light == "L5", "x"] += 0.6

    change_survey(folder, move)
    _, verdicts = calibrate(folder)
    assert verdicts["light", "L5"][0] == "weak"
    assert "far from its surveyed position: was it moved?" in verdicts["light", "L5"][1]


def test_survey_in_centimetres(case, folder):
    scale_survey(folder, 100.0)
    with pytest.raises(
        InputError, match=r"lights\.csv: x, y, z: .* times as large \(centimetres for metres\?\)"
    ) as caught:
        calibrate(folder)
    assert "convert lights.csv to metres: divide x, y, z by" in str(caught.value)
    factor = float(str(caught.value).rsplit(" ", 1)[1])
    case.check(abs(factor / 100 - 1), 0.02)
    assert not (folder / "out").exists()


def test_survey_in_millimetres(folder):
    scale_survey(folder, 1000.0)
    with pytest.raises(InputError, match=r"lights\.csv: x, y, z: .* times as large \(millimetres for metres\?\)"):
        calibrate(folder)


def test_board_in_millimetres(folder):
    """The rig is a thousand times too large; ball and survey are on the same side."""
    scale_rig(folder, 1000.0)
    with pytest.raises(InputError, match=r"square_m: .*a rig .*millimetres for metres\?.*divide square_m and marker_m"):
        calibrate(folder)


def test_ball_radius_in_centimetres(folder):
    edit_json(folder / "index/calibration_lights.json", lambda content: content.update(radius_m=18.0))
    with pytest.raises(InputError, match=r"radius_m: .*\(metres for centimetres\?\).*multiply radius_m by 0\.0"):
        calibrate(folder)


def test_board_printed_at_95_percent(folder):
    """The board's squares are smaller than stated, so the rig comes out larger than it is."""
    scale_rig(folder, 1 / 0.95)
    with pytest.raises(InputError, match=r"square_m: .*a rig 1\.05.* times as large"):
        calibrate(folder)


def test_known_cameras_in_another_frame(folder):
    edit_json(folder / "index/calibration_cameras.json", lambda content: content.update(method="known"))
    with pytest.raises(InputError, match=r"calibration\.cameras: expected the stage's frame, found lights measured"):
        calibrate(folder)


def test_overexposed_highlights_tell_no_intensity(folder):
    for path in light_images(folder, "L6"):
        image = cv2.imread(str(path), 0).astype(float)
        cv2.imwrite(str(path), np.minimum(30 * image, 255).astype(np.uint8))
    lights, verdicts = calibrate(folder)
    assert lights.status["L6"] == "measured"
    assert np.isnan(lights.intensity["L6"])
    assert "no intensity: its highlights are clipped: expose shorter" in verdicts["light", "L6"][1]
    assert lights.intensity.drop(["L6", "L99"]).notna().all()
