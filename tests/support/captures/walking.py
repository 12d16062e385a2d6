"""The walking figure as a capture's index, for track_mesh, and the error of its answer."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pandas as pd

from pipeline.base.files import read_arrays, read_json, write_json, write_table
from pipeline.geometry.cameras import write_cameras
from tests.support.figures.walking import BONES, Motion, draw_mask, ring_of_cameras, write_template

DOWNSAMPLE = 4.0
NOISE_PX, OUTLIERS, OUTLIER_PX = 0.35, 0.03, 20.0
"""A detector's noise at 12 mm per pixel, its share of wrong points, and how wrong they are."""


def detect(motion_points: np.ndarray, cameras: dict, names: list[str]) -> pd.DataFrame:
    """Keypoints of [frames, points, 3] as a detector would give them."""
    rng = np.random.default_rng(11)
    frames, count = motion_points.shape[:2]
    rows = []
    for camera_name, camera in cameras.items():
        pixels, _ = camera.downsampled(DOWNSAMPLE).project(motion_points)
        pixels = pixels + NOISE_PX * rng.normal(size=pixels.shape)
        wrong = rng.random(pixels.shape[:2]) < OUTLIERS
        pixels[wrong] += OUTLIER_PX * rng.normal(size=(wrong.sum(), 2))
        for f in range(frames):
            rows += [(f, camera_name, names[k], *pixels[f, k], 0.9) for k in range(count)]
    return pd.DataFrame(rows, columns=["frame", "camera", "keypoint", "x", "y", "confidence"])


def write_capture(
    folder: Path, motion: Motion, *, rigged: bool = True, masks: bool = True, cameras: int = 6, flaw: bool = False
) -> dict:
    """A capture folder and its index; returns the paths that `run` takes. `flaw`: see `write_template`."""
    rig, index = ring_of_cameras(cameras), folder / "index"
    write_template(folder / "template.glb", units_per_m=100.0, rigged=rigged, flaw=flaw)
    write_cameras(folder / "cameras.json", rig)
    chosen = np.arange(0, motion.vertices.shape[1], 40)
    points = motion.joints if rigged else motion.vertices[:, chosen]
    names = [f"k{i:02d}" for i in range(points.shape[1])]
    column, targets = ("node_index", np.arange(len(BONES)) + 1) if rigged else ("vertex", chosen)
    pd.DataFrame({"keypoint": names, column: targets}).to_csv(folder / "keypoints.csv", index=False)
    facts = {"downsample_from_sensor": DOWNSAMPLE, "transfer": "linear", "black_level": 0.0}
    template = {"mesh": "template.glb", "keypoints": "keypoints.csv", "scale_to_m": 0.01}
    write_json(index / "capture.json", {"template": template, "images": facts})
    frames = np.arange(len(motion.times_s))
    write_table(
        index / "frames.parquet", pd.DataFrame({"frame": frames, "timestamp_s": motion.times_s, "segment": "a"})
    )
    rows = []
    for number, (name, camera) in enumerate(rig.items()):
        for f in frames:
            path = f"{name}_{f:03d}.png" if masks else None
            if masks:
                mask = draw_mask(camera.downsampled(DOWNSAMPLE), motion.vertices[f], motion.faces)
                cv2.imwrite(str(folder / path), mask)
            rows.append((name, f, path, number == 1))
    images = pd.DataFrame(rows, columns=["camera", "frame", "mask_path", "test_camera"])
    write_table(index / "images.parquet", images)
    write_table(index / "keypoints_2d.parquet", detect(points, rig, names))
    return {"capture": folder, "index": index, "cameras": folder / "cameras.json", "out": folder / "tracking"}


def with_template_scale(captured: dict, folder: Path, scale_to_m: float) -> dict:
    """The capture in another folder, with another unit of the template."""
    paths = edited(captured, folder)
    content = read_json(paths["index"] / "capture.json")
    content["template"]["scale_to_m"] = scale_to_m
    write_json(paths["index"] / "capture.json", content)
    return paths


def mean_error_mm(paths: dict, motion: Motion, chunk: int = 0) -> float:
    result = read_arrays(paths["out"] / f"{chunk:04d}.safetensors")
    error = np.linalg.norm(result["vertices"] - motion.vertices[result["frames"]], axis=-1)
    return 1e3 * float(error.mean())


def edited(captured: dict, tmp_path: Path, **tables: pd.DataFrame) -> dict:
    """The captured index with some tables replaced, and its own output folder."""
    index = tmp_path / "index"
    index.mkdir(parents=True)
    for file in captured["index"].iterdir():
        (index / file.name).write_bytes(file.read_bytes())
    for name, table in tables.items():
        write_table(index / f"{name}.parquet", table)
    return captured | {"index": index, "out": tmp_path / "tracking"}
