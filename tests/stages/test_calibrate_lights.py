"""The stage on drawn balls in a rig whose frame is not the stage's."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pandas as pd
import pytest
import scipy.spatial.transform

from pipeline.base.errors import InputError
from pipeline.base.files import read_table, write_json, write_table
from pipeline.calibrate_lights import run
from pipeline.geometry.cameras import Camera, read_cameras, write_cameras

SIZE = 300
RADIUS = 0.18
BALLS = {"0": np.array([-0.25, 0.25, -0.2]), "1": np.array([0.3, -0.25, 0.25])}
SURVEY_SIGMA = 0.02
EMITTER = 0.05
LENS_BLUR_PX = 0.7
"""Standard deviation: a sharp highlight would hide inside one pixel, and could not be placed in it."""


def cameras_in_stage():
    cameras = {}
    for name, angle in (("east", 0.0), ("north", 2.0), ("west", 4.2)):
        R = scipy.spatial.transform.Rotation.from_euler("XY", [np.pi, angle]).as_matrix()
        K = np.array([[450.0, 0, SIZE / 2], [0, 450, SIZE / 2], [0, 0, 1]])
        cameras[name] = Camera(R, np.array([0.0, 0.0, 2.2]), K, np.zeros(5), SIZE, SIZE)
    return cameras


def planted_lights():
    rng = np.random.default_rng(1)
    lights = rng.normal(size=(12, 3))
    return 2.0 * lights / np.linalg.norm(lights, axis=1, keepdims=True)


def mirror(camera, ball):
    """(hit, points, mirrored directions) of 4 x 4 rays per pixel; the last two for rays that hit."""
    steps = (np.arange(4 * SIZE) + 0.5) / 4
    x, y = np.meshgrid(steps, steps)
    ray = np.stack([(x - SIZE / 2) / 450, (y - SIZE / 2) / 450, np.ones_like(x)], -1) @ camera.R
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    toward = ball - camera.center
    along = ray @ toward
    root = along**2 - toward @ toward + RADIUS**2
    hit = root > 0
    points = camera.center + (along[hit] - np.sqrt(root[hit]))[:, None] * ray[hit]
    normal = (points - ball) / RADIUS
    return hit, points, ray[hit] - 2 * (ray[hit] * normal).sum(-1, keepdims=True) * normal


def draw(mirrored, light):
    """The ball with a round light in it, or its silhouette where `light` is None."""
    hit, points, direction = mirrored
    image = np.where(hit, 0.02, 0.7 if light is None else 0.01)
    if light is not None:
        to_light = light - points
        ahead = (to_light * direction).sum(-1)
        lit = (ahead > 0) & ((to_light**2).sum(-1) - ahead**2 < EMITTER**2)
        image[hit] = np.where(lit, 0.9, 0.01)
    image = cv2.GaussianBlur(image, (0, 0), 4 * LENS_BLUR_PX)
    return image.reshape(SIZE, 4, SIZE, 4).mean((1, 3))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder, lights = tmp_path_factory.mktemp("capture"), planted_lights()
    images, silhouettes = [], []
    for name, camera in cameras_in_stage().items():
        for position, ball in BALLS.items():
            mirrored = mirror(camera, ball)
            for light in (None, *range(len(lights))):
                path = f"{name}_{position}_{light}.png"
                gray = draw(mirrored, None if light is None else lights[light])
                cv2.imwrite(str(folder / path), np.round(255 * gray).astype(np.uint8))
                entry = {"position": position, "camera": name, "path": path, "digest": ""}
                (silhouettes if light is None else images).append(
                    entry if light is None else {**entry, "light": f"L{light}"}
                )
    content = {"method": "mirror_ball", "radius_m": RADIUS, "images": images, "silhouettes": silhouettes}
    write_json(folder / "index/calibration_lights.json", content)
    write_json(folder / "index/calibration_cameras.json", {"method": "charuco"})
    survey = lights + np.random.default_rng(2).normal(0, SURVEY_SIGMA, lights.shape)
    rows = [(f"L{k}", *row) for k, row in enumerate(survey)]
    rows.append(("L99", 1.0, 2.0, 3.0))  # a light of which there are no images
    write_table(folder / "index/lights.parquet", pd.DataFrame(rows, columns=["light", "x", "y", "z"]))
    R = scipy.spatial.transform.Rotation.from_rotvec([0.3, -1.0, 0.5]).as_matrix()
    t = np.array([0.4, -2.0, 1.0])  # x_rig = R x_stage + t
    rig = {name: replace(c, R=c.R @ R.T, t=c.t - c.R @ R.T @ t) for name, c in cameras_in_stage().items()}
    write_cameras(folder / "rig.json", rig)
    return folder


def paths(folder, out):
    return {"capture": folder, "index": folder / "index", "rig": folder / "rig.json", "out": out}


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
    residuals = read_table(tmp_path / "residuals_lights.parquet")
    assert list(residuals.columns) == ["light", "position", "camera", "x", "y", "residual_x", "residual_y", "weight"]
    assert np.median(np.hypot(residuals.residual_x, residuals.residual_y)) < 0.2


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


@pytest.mark.parametrize("method", ["known", "charuco"])
def test_known_lights(folder, tmp_path, method):
    index = tmp_path / "index"
    index.mkdir()
    (index / "lights.parquet").write_bytes((folder / "index/lights.parquet").read_bytes())
    write_json(index / "calibration_lights.json", {"method": "known"})
    write_json(index / "calibration_cameras.json", {"method": method})
    arguments = {"capture": folder, "index": index, "rig": folder / "rig.json", "out": tmp_path}
    if method == "charuco":
        with pytest.raises(InputError, match="expected method known, found charuco"):
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
