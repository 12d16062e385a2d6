"""Lights of an earlier day for today's cameras, whose frame is another and some of which were moved."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from pipeline.base.errors import InputError
from pipeline.base.files import read_table, write_json, write_table
from pipeline.calibration.lights.light_tables import TABLE_COLUMNS
from pipeline.geometry.cameras import Camera, read_cameras, write_cameras
from pipeline.stages.calibrate_lights import run

NOISE_M = 2e-4
"""Of today's centres: what a calibration is good to."""

CAMERAS = 8

LIGHTS = pd.DataFrame({"light": ["L0", "L1", "L2"], "x": [1.0, -2, 0], "y": [2.0, 1, 3], "z": [0.5, 0, -1]})


def stage_cameras():
    """A ring of cameras of 2 m that look at its middle."""
    found = {}
    for k in range(CAMERAS):
        turn = Rotation.from_euler("y", 360 * k / CAMERAS, degrees=True).as_matrix()
        R = np.diag([1.0, -1, -1]) @ turn.T
        center = turn @ [0, 0.3 * (k % 3), 2.0]
        K = np.array([[900.0, 0, 320], [0, 900, 240], [0, 0, 1]])
        found[f"cam{k}"] = Camera(R, -R @ center, K, np.zeros(5), 640, 480)
    return found


def another_day(moved=()):
    """Today's cameras in another frame, with errors; the cameras `moved` are 3 cm off."""
    random = np.random.default_rng(0)
    turn, shift = Rotation.from_rotvec([0.4, -1.1, 0.2]).as_matrix(), np.array([0.3, 1.0, -2.0])
    found = {}
    for name, camera in stage_cameras().items():
        center = camera.center + random.normal(0, NOISE_M, 3) + (0.03 if name in moved else 0) * np.array([0, 1, 0])
        R = camera.R @ turn.T
        found[name] = replace(camera, R=R, t=-R @ (turn @ center + shift))
    return found


def write_day(folder, today, lights=LIGHTS, cameras="charuco"):
    table = lights.assign(sigma_m=0.003, status="measured", highlights=9).reindex(columns=TABLE_COLUMNS)
    write_table(folder / "earlier/lights.parquet", table)
    write_cameras(folder / "earlier/cameras.json", stage_cameras())
    write_table(folder / "index/lights.parquet", LIGHTS.assign(x=LIGHTS.x + 0.01))
    earlier = {"lights": "earlier/lights.parquet", "cameras": "earlier/cameras.json"}
    write_json(folder / "index/calibration_lights.json", {"method": "earlier", **earlier})
    write_json(folder / "index/calibration_cameras.json", {"method": cameras})
    write_cameras(folder / "rig.json", today)
    return {"capture": folder, "index": folder / "index", "rig": folder / "rig.json", "out": folder / "out"}


def verdicts(folder):
    return pd.read_csv(folder / "out/verdicts_lights.csv").set_index(["kind", "name"])


@pytest.mark.parametrize("moved", [(), ("cam1", "cam4", "cam5")], ids=["none moved", "three moved"])
def test_cameras_are_placed_by_those_that_have_not_moved(tmp_path, moved):
    run(**write_day(tmp_path, another_day(moved)))
    placed = read_cameras(tmp_path / "out/cameras.json")
    for name, camera in stage_cameras().items():
        true = camera.center + (0.03 if name in moved else 0) * np.array([0, 1, 0])
        # Its own error and that of the frame, which five cameras and more share: 5 standard deviations.
        assert np.linalg.norm(placed[name].center - true) < 5 * NOISE_M * np.sqrt(3 * 1.2)
        assert pytest.approx(camera.R, abs=5 * NOISE_M) == placed[name].R
    lights = read_table(tmp_path / "out/lights.parquet")
    assert np.array_equal(lights[["x", "y", "z"]], LIGHTS[["x", "y", "z"]])
    assert set(lights.status) == {"measured"}
    table = verdicts(tmp_path)
    assert set(table.loc["light"].grade) == {"good"}
    weak = set(table.loc["camera"].index) if "camera" in table.index.get_level_values(0) else set()
    assert weak == set(moved)


def test_a_rig_that_was_rebuilt_is_refused(tmp_path):
    moved = [f"cam{k}" for k in range(0, CAMERAS, 2)]
    with pytest.raises(InputError, match=r"found \d of 8 cameras of both days within 5 mm; photograph a mirror ball"):
        run(**write_day(tmp_path, another_day(moved)))


def test_a_light_that_is_new_keeps_its_surveyed_place(tmp_path):
    run(**write_day(tmp_path, another_day(), LIGHTS.iloc[:2]))
    lights = read_table(tmp_path / "out/lights.parquet").set_index("light")
    assert lights.status["L2"] == "surveyed"
    assert lights.x["L2"] == LIGHTS.x[2] + 0.01
    assert verdicts(tmp_path).grade["light", "L2"] == "weak"


def test_cameras_known_in_the_stage_stay_where_they_are(tmp_path):
    run(**write_day(tmp_path, stage_cameras(), cameras="known"))
    assert (tmp_path / "out/cameras.json").read_text() == (tmp_path / "rig.json").read_text()


def test_lights_of_another_stage_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"expected lights of lights\.csv, found none of them"):
        run(**write_day(tmp_path, another_day(), LIGHTS.assign(light=["A", "B", "C"])))
