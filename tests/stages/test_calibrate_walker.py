"""All three calibrations on the example capture, whose noise is known but whose truth is not."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import yaml

import pipeline.stages.calibrate_cameras
import pipeline.stages.calibrate_color
import pipeline.stages.calibrate_lights
from pipeline.base.files import read_json, read_table, write_json, write_table
from pipeline.geometry.cameras import read_cameras
from tests.support.shared_data import shared_data

WALKER, pytestmark = shared_data("captures/walker")


def entries(pattern, *keys):
    """What matches a pattern of {keys}, each key one whole folder or stem."""
    glob = pattern.replace("{view:03d}", "*")
    for key in keys:
        glob = glob.replace("{" + key + "}", "*")
    found = []
    for path in sorted(WALKER.glob(glob)):
        parts = path.relative_to(WALKER).with_suffix("").parts[-len(keys) :]
        found.append({**dict(zip(keys, parts, strict=True)), "path": str(path.relative_to(WALKER)), "digest": ""})
    return found


@pytest.fixture(scope="module")
def calibration(tmp_path_factory):
    """The folder of all outputs; the index holds just what these stages read, without digests."""
    folder = tmp_path_factory.mktemp("walker")
    index, out = folder / "index", folder / "calibration"
    sections = yaml.safe_load((WALKER / "capture.yaml").read_text())["calibration"]
    write_table(index / "cameras.parquet", pd.read_csv(WALKER / "cameras.csv"))
    write_table(index / "lights.parquet", pd.read_csv(WALKER / "lights.csv"))
    write_json(index / "capture.json", {"images": {"transfer": "linear", "black_level": 0.0}})
    views = [{**e, "view": int(e["view"])} for e in entries(sections["cameras"]["path"], "camera", "view")]
    write_json(index / "calibration_cameras.json", {**sections["cameras"], "views": views})
    images = entries(sections["lights"]["path"], "position", "camera", "light")
    silhouettes = [{**e, "path": e["path"]} for e in images if e["light"] == "silhouette"]
    images = [e for e in images if e["light"] != "silhouette"]
    write_json(
        index / "calibration_lights.json",
        {"method": "mirror_ball", "radius_m": 0.18, "images": images, "silhouettes": silhouettes},
    )
    chart = {
        "method": "chart",
        "transfer": "linear",
        "images": entries(sections["color"]["path"], "camera"),
        "patches": pd.read_csv(WALKER / sections["color"]["patches"])[["r", "g", "b"]].to_numpy().tolist(),
    }
    write_json(index / "calibration_color.json", chart)
    common = {"capture": WALKER, "index": index, "out": out, "threads": 2}
    pipeline.stages.calibrate_cameras.run(**common)
    pipeline.stages.calibrate_lights.run(**common, rig=out / "rig.json")
    pipeline.stages.calibrate_color.run(**common)
    return out


def test_all_cameras_to_a_fraction_of_a_pixel(calibration):
    residuals = read_table(calibration / "residuals_cameras.parquet")
    squared = residuals.residual_x**2 + residuals.residual_y**2
    rms = np.sqrt(squared.groupby(residuals.camera).mean())
    assert len(rms) == 12
    # Corners are good to 0.06 px RMS under the true cameras.
    assert rms.max() < 0.12


def test_every_light_is_measured(calibration):
    lights = read_table(calibration / "lights.parquet")
    assert len(lights) == 64
    assert (lights.status == "measured").all()
    assert lights.sigma_m.max() < 0.01
    survey = pd.read_csv(WALKER / "lights.csv").sort_values("light")
    away = np.linalg.norm(lights[["x", "y", "z"]].to_numpy() - survey[["x", "y", "z"]].to_numpy(), axis=1)
    # "Good to centimetres".
    assert np.median(away) < 0.08
    residuals = read_table(calibration / "residuals_lights.parquet")
    assert np.median(np.hypot(residuals.residual_x, residuals.residual_y)) < 0.1


def test_cameras_look_at_the_middle_of_the_stage(calibration):
    """In the stage's frame the dome surrounds the cameras, and they look inwards."""
    middle = pd.read_csv(WALKER / "lights.csv")[["x", "y", "z"]].to_numpy().mean(0)
    for camera in read_cameras(calibration / "cameras.json").values():
        toward = (middle - camera.center) / np.linalg.norm(middle - camera.center)
        assert camera.R[2] @ toward > 0.9


def test_keypoints_agree_with_the_cameras(calibration):
    """An independent check: the body's keypoints, seen by all cameras, meet in space to a detector's error."""
    table = pd.read_parquet(WALKER / "keypoints_2d.parquet")
    cameras = {name: c.downsampled(4) for name, c in read_cameras(calibration / "cameras.json").items()}
    residuals = []
    for _, group in list(table.groupby(["frame", "keypoint"]))[::29]:
        group = group[group.confidence > 0.3]
        if len(group) < 6:
            continue
        centers = np.stack([cameras[c].center for c in group.camera])
        pixels = group[["x", "y"]].to_numpy()
        rays = np.concatenate([cameras[c].ray_directions(p[None]) for c, p in zip(group.camera, pixels, strict=True)])
        across = np.eye(3) - rays[:, :, None] * rays[:, None]
        weight = np.ones(len(rays))
        for _ in range(10):
            point = np.linalg.solve(
                np.einsum("n,nij->ij", weight, across), np.einsum("n,nij,nj->i", weight, across, centers)
            )
            weight = 1 / (1e-3 + np.linalg.norm(np.einsum("nij,nj->ni", across, point - centers), axis=1))
        for camera, pixel in zip(group.camera, pixels, strict=True):
            residuals.append(np.linalg.norm(cameras[camera].project(point[None])[0][0] - pixel))
    assert len(residuals) > 100
    # The detector's median error is 0.35 px in each of x and y: 0.6 px in length.
    assert np.median(residuals) < 0.65


def test_corrected_patches_agree_between_cameras(calibration):
    residuals = read_table(calibration / "residuals_color.parquet")
    matrices = read_json(calibration / "color.json")["cameras"]
    assert len(matrices) == 12
    raw = {name: group[["r", "g", "b"]].to_numpy() for name, group in residuals.groupby("camera")}
    before = np.std(list(raw.values()), axis=0).mean()
    after = np.std([raw[name] @ np.transpose(matrix) for name, matrix in matrices.items()], axis=0).mean()
    assert after < before / 20
