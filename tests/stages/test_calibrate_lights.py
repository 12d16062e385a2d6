"""The stage on drawn balls in a rig whose frame is not the stage's."""

from __future__ import annotations

import cv2
import numpy as np
import pandas as pd
import pytest

from pipeline.base.errors import InputError
from pipeline.base.files import read_table, write_json, write_table
from pipeline.calibration.lights import ball_photos
from pipeline.config.calibrate_lights import CalibrateLights
from pipeline.geometry.cameras import read_cameras, write_cameras
from pipeline.stages.calibrate_lights import run
from tests.support.drawings.balls import (
    RADIUS,
    cameras_in_stage,
    edit_json,
    paths,
    planted_lights,
    variant,
    write_ball_capture,
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("capture")
    write_ball_capture(folder)
    return folder


def test_lights_and_cameras_in_the_stage_frame(folder, tmp_path):
    run(**paths(folder, tmp_path), threads=2)
    lights = read_table(tmp_path / "lights.parquet").set_index("light")
    measured = lights[lights.status == "measured"]
    assert len(measured) >= 10
    assert list(lights.index[lights.status == "surveyed"])[-1] == "L99"
    assert lights.loc["L99", ["x", "y", "z"]].tolist() == [1.0, 2.0, 3.0]
    found = measured[["x", "y", "z"]].to_numpy(np.float64)
    true = planted_lights()[[int(name[1:]) for name in measured.index]]
    # The survey places the stage to 0.02 / sqrt(12) per axis and 0.02 / (2 sqrt(8)) rad: 6 mm and 7 mm at 2 m; times 3.
    placed = 3 * np.sqrt(3 * 0.006**2 + 2 * 0.007**2)
    assert np.all(np.linalg.norm(found - true, axis=1) < placed + 4 * np.sqrt(3) * measured.sigma_m)
    assert measured.sigma_m.median() < 0.01
    # Without the survey's error: distances between lights. 0.05 px of 37 px of radius turn a ray by 3 mrad, 6 mm.
    error = np.linalg.norm(found[:, None] - found, axis=-1) - np.linalg.norm(true[:, None] - true, axis=-1)
    assert np.median(np.abs(error)) < 0.01
    cameras = read_cameras(tmp_path / "cameras.json")
    for name, camera in cameras_in_stage().items():
        assert np.linalg.norm(cameras[name].center - camera.center) < 0.05
    covariance = measured[["cov_xx", "cov_yy", "cov_zz"]].sum(axis=1)
    assert measured.sigma_m.to_numpy() == pytest.approx(np.sqrt(covariance / 3))
    assert lights.loc["L99", "cov_xx":"color_b_sigma"].drop("highlights").isna().all()
    verdicts = pd.read_csv(tmp_path / "verdicts_lights.csv").set_index(["kind", "name"])
    assert verdicts.loc[("light", "L99"), "grade"] == "failed"
    assert verdicts.loc[("light", "L99"), "reason"].startswith("no image of it with a usable ball; keeps its surveyed")
    assert (verdicts.loc["ball"].grade == "good").all()
    assert list(verdicts.loc["light"].index) == list(lights.index)
    residuals = read_table(tmp_path / "residuals_lights.parquet")
    assert list(residuals.columns) == ["light", "position", "camera", "x", "y", "residual_x", "residual_y", "weight"]
    assert np.median(np.hypot(residuals.residual_x, residuals.residual_y)) < 0.2


def test_shares_of_the_cameras_give_the_same_bytes(folder, tmp_path, monkeypatch):
    """Also with a share that has no camera; and no photograph is read again."""
    words = paths(folder, tmp_path / "one")
    run(**words)
    shares, count = tmp_path / "shares", len(cameras_in_stage()) + 1
    for share in range(count):
        run(**{**words, "out": shares}, share=share, shares=count)
    monkeypatch.setattr(ball_photos, "read_ball_photo", lambda *_: pytest.fail("read again"))
    run(**{**words, "out": tmp_path / "joined"}, measured=tuple(sorted(shares.iterdir(), reverse=True)))
    for name in ("lights.parquet", "cameras.json", "residuals_lights.parquet", "verdicts_lights.csv"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "joined" / name).read_bytes(), name
    with pytest.raises(InputError, match=r"lights.parquet: expected columns what, position, .* found light"):
        run(**{**words, "out": tmp_path / "other"}, measured=(tmp_path / "one/lights.parquet",))


def test_equal_lights_are_equally_bright(folder, tmp_path):
    """All lamps are drawn alike, at 2 m: only their places differ, and grey images tell no colours."""
    run(**paths(folder, tmp_path), settings=CalibrateLights(largest_sigma_m=0.1))
    lights = read_table(tmp_path / "lights.parquet").set_index("light").drop("L99")
    # Peaks are 25 to 80 grey levels: 20 pixels of a highlight, each rounded, add up to sqrt(20 / 12) of 100, or 1 %;
    # the blurred skirt that rounds to nothing is some per cent more, and more of it the fainter the peak.
    assert (lights.intensity - 1).abs().max() < 0.1
    assert np.sqrt((((lights.intensity - 1) / lights.intensity_sigma) ** 2).mean()) < 2
    assert lights.color_r.isna().all()
    reasons = pd.read_csv(tmp_path / "verdicts_lights.csv").set_index("name").reason
    assert reasons["L3"].endswith("no colour: the images are grey")


def test_photographs_in_srgb(folder, tmp_path):
    """The same light in other counts: the same lights, to the rounding of the files; said to be linear, it is not."""
    run(**paths(folder, tmp_path / "linear"))
    photos = variant(folder, tmp_path / "photos")
    for path in photos.glob("*.png"):
        value = cv2.imread(str(path), 0) / 255
        value = np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)
        cv2.imwrite(str(path), np.round(255 * value).astype(np.uint8))
    edit_json(photos / "index/calibration_lights.json", lambda content: content.update(transfer="srgb"))
    run(**paths(photos, tmp_path / "srgb"))
    a, b = (read_table(tmp_path / name / "lights.parquet").set_index("light") for name in ("linear", "srgb"))
    both = a.index[(a.status == "measured") & (b.status == "measured")]
    assert len(both) >= 10
    away = (a.loc[both, ["x", "y", "z"]] - b.loc[both, ["x", "y", "z"]]).to_numpy(np.float64)
    assert np.median(np.linalg.norm(away, axis=1)) < a.sigma_m[both].median()
    assert (a.intensity[both] / b.intensity[both] - 1).abs().max() < 0.1
    edit_json(photos / "index/calibration_lights.json", lambda content: content.update(transfer="linear"))
    run(**paths(photos, tmp_path / "unsaid"))
    balls = {
        name: pd.read_csv(tmp_path / name / "verdicts_lights.csv").query("kind == 'ball'").reason.tolist()
        for name in ("srgb", "unsaid")
    }
    assert balls["srgb"] != balls["unsaid"]


def test_fewer_balls_are_faster_and_worse(folder, tmp_path):
    run(**paths(folder, tmp_path / "all"))
    run(**paths(folder, tmp_path / "one"), settings=CalibrateLights(most_balls=1, largest_sigma_m=0.1))
    few, all_of_them = (read_table(tmp_path / name / "residuals_lights.parquet") for name in ("one", "all"))
    assert set(few.position) == {"0"}
    assert set(all_of_them.position) == {"0", "1"}
    worse, better = (read_table(tmp_path / name / "lights.parquet").set_index("light") for name in ("one", "all"))
    both = worse.index[(worse.status == "measured") & (better.status == "measured")]
    assert worse.sigma_m[both].median() > better.sigma_m[both].median()


def test_known_cameras_are_in_the_stage_already(folder, tmp_path):
    index = tmp_path / "index"
    for name in ("calibration_lights.json", "lights.parquet"):
        index.mkdir(exist_ok=True)
        (index / name).write_bytes((folder / "index" / name).read_bytes())
    write_json(index / "calibration_cameras.json", {"method": "known"})
    write_cameras(tmp_path / "rig.json", cameras_in_stage())
    run(capture=folder, index=index, rig=tmp_path / "rig.json", out=tmp_path)
    assert (tmp_path / "cameras.json").read_text() == (tmp_path / "rig.json").read_text()
    lights = read_table(tmp_path / "lights.parquet")
    lights = lights[lights.status == "measured"]
    true = planted_lights()[[int(name[1:]) for name in lights.light]]
    assert np.median(np.linalg.norm(lights[["x", "y", "z"]].to_numpy() - true, axis=1)) < 0.01


def test_known_cameras_in_a_frame_of_their_own_are_moved_like_calibrated_ones(folder, tmp_path):
    run(**paths(folder, tmp_path / "calibrated"))
    other = variant(folder, tmp_path / "capture")
    write_json(other / "index/calibration_cameras.json", {"method": "known", "frame": "own"})
    run(**paths(other, tmp_path / "known"))
    for name in ("cameras.json", "lights.parquet"):
        assert (tmp_path / "known" / name).read_bytes() == (tmp_path / "calibrated" / name).read_bytes()


@pytest.mark.parametrize(
    "cameras", [{"method": "known"}, {"method": "known", "frame": "own"}, {"method": "charuco"}], ids=str
)
def test_known_lights(folder, tmp_path, cameras):
    index = tmp_path / "index"
    index.mkdir()
    (index / "lights.parquet").write_bytes((folder / "index/lights.parquet").read_bytes())
    write_json(index / "calibration_lights.json", {"method": "known"})
    write_json(index / "calibration_cameras.json", cameras)
    arguments = {"capture": folder, "index": index, "rig": folder / "rig.json", "out": tmp_path}
    if cameras != {"method": "known"}:
        with pytest.raises(InputError, match="expected known cameras in the stage's frame"):
            run(**arguments)
        return
    run(**arguments)
    lights, survey = read_table(tmp_path / "lights.parquet"), read_table(index / "lights.parquet")
    assert np.array_equal(lights[["x", "y", "z"]], survey.sort_values("light")[["x", "y", "z"]])
    assert set(lights.status) == {"surveyed"}
    assert (tmp_path / "cameras.json").read_text() == (folder / "rig.json").read_text()


def test_images_without_a_ball_are_refused(folder, tmp_path):
    cv2.imwrite(str(tmp_path / "gray.png"), np.full((64, 64), 180, np.uint8))
    index = tmp_path / "index"
    write_json(
        index / "calibration_lights.json",
        {
            "method": "mirror_ball",
            "radius_m": RADIUS,
            "images": [],
            "silhouettes": [{"position": "0", "camera": "east", "path": "gray.png", "digest": ""}],
        },
    )
    (index / "lights.parquet").write_bytes((folder / "index/lights.parquet").read_bytes())
    write_json(index / "calibration_cameras.json", {"method": "charuco"})
    with pytest.raises(InputError, match="silhouette: expected a dark ball in some image, found none"):
        run(capture=tmp_path, index=index, rig=folder / "rig.json", out=tmp_path)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda xyz: xyz * [1, 1, -1], "its mirror image fits to 0.0"),
        (lambda xyz: np.roll(xyz, 1, axis=0), "are names shifted or mixed up in lights.csv"),
    ],
    ids=["mirrored", "shifted"],
)
def test_survey_of_another_stage_ends_the_run(folder, tmp_path, change, said):
    """Where most lights are elsewhere, cameras would be placed by chance; it was a weak verdict on each light."""
    other = variant(folder, tmp_path / "capture")
    survey = read_table(other / "index/lights.parquet")
    survey[["x", "y", "z"]] = change(survey[["x", "y", "z"]].to_numpy())
    write_table(other / "index/lights.parquet", survey)
    with pytest.raises(InputError) as caught:
        run(**paths(other, tmp_path / "out"))
    assert "lights.csv: x, y, z: expected a survey that fits to 0.25 m" in str(caught.value)
    assert said in str(caught.value)
    assert not (tmp_path / "out/cameras.json").exists()


def test_two_exchanged_names_are_weak_verdicts(folder, tmp_path):
    """The others place the stage: the run goes on, and names the two."""
    other = variant(folder, tmp_path / "capture")
    survey = read_table(other / "index/lights.parquet").sort_values("light", ignore_index=True)
    run(**paths(other, tmp_path / "before"))
    verdicts = pd.read_csv(tmp_path / "before/verdicts_lights.csv").set_index("name")
    good = verdicts.index[(verdicts.kind == "light") & (verdicts.grade == "good")]
    first, second = (survey.index[survey.light == name][0] for name in good[:2])
    survey.loc[[first, second], ["x", "y", "z"]] = survey.loc[[second, first], ["x", "y", "z"]].to_numpy()
    write_table(other / "index/lights.parquet", survey)
    run(**paths(other, tmp_path / "after"))
    verdicts = pd.read_csv(tmp_path / "after/verdicts_lights.csv").set_index("name")
    assert all("look swapped" in verdicts.reason[survey.light[row]] for row in (first, second))
