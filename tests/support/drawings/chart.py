"""A 24-patch chart drawn in perspective, with planted colour response, light and noise."""

from __future__ import annotations

import cv2
import numpy as np
import pandas as pd

from pipeline.base.exr import write_exr
from pipeline.base.files import read_json, write_json, write_table

# Linear Rec. 709 of the classic chart, to two digits: any 24 distinct colours in its order would do for the fit, but
# OpenCV's detector knows the real ones.
VALUES = np.array([
    [0.17, 0.08, 0.06], [0.54, 0.30, 0.22], [0.11, 0.19, 0.34], [0.10, 0.15, 0.05],
    [0.23, 0.21, 0.43], [0.12, 0.51, 0.40], [0.69, 0.20, 0.03], [0.06, 0.10, 0.38],
    [0.53, 0.09, 0.12], [0.11, 0.04, 0.14], [0.34, 0.50, 0.05], [0.75, 0.36, 0.03],
    [0.03, 0.05, 0.30], [0.06, 0.29, 0.06], [0.43, 0.03, 0.04], [0.81, 0.57, 0.01],
    [0.50, 0.09, 0.30], [0.00, 0.24, 0.37], [0.90, 0.90, 0.88], [0.58, 0.59, 0.58],
    [0.35, 0.36, 0.36], [0.19, 0.19, 0.19], [0.09, 0.09, 0.09], [0.03, 0.03, 0.03],
])  # fmt: skip

RESPONSE = np.array([[0.8, 0.05, 0.0], [0.03, 0.75, 0.04], [0.0, 0.02, 0.7]])

WIDTH, HEIGHT = 560, 400
IMAGE_FROM_CHART = np.array([[52.0, -7.0, 130.0], [6.0, 54.0, 60.0], [0.004, 0.002, 1.0]])
"""From patches (column, row) to pixels, first centre at (0.5, 0.5)."""

PATCH_SHARE = 0.8
"""Side of a patch over the distance from patch to patch."""


def draw_chart(response=RESPONSE, values=VALUES, light=None, noise=0.003, seed=0):
    """Linear image [400, 560, 3]; `light` maps (column, row) [pixels, 2] to a factor [pixels]."""
    rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH] + 0.5
    at = np.linalg.inv(IMAGE_FROM_CHART) @ np.stack([columns.ravel(), rows.ravel(), np.ones(columns.size)])
    x, y = at[:2] / at[2]
    column, row = np.floor(x).astype(int), np.floor(y).astype(int)
    in_chart = (x > -0.2) & (x < 6.2) & (y > -0.2) & (y < 4.2)
    inside = (column >= 0) & (column < 6) & (row >= 0) & (row < 4)
    inside &= np.maximum(abs(x % 1 - 0.5), abs(y % 1 - 0.5)) < PATCH_SHARE / 2
    patch = np.clip(6 * row + column, 0, 23)
    color = np.where(inside[:, None], values[patch], np.where(in_chart[:, None], 0.025, 0.0))
    if light is not None:
        color = color * light(np.stack([x, y], 1))[:, None]
    image = cv2.GaussianBlur((color @ response.T).reshape(HEIGHT, WIDTH, 3), (0, 0), 0.8)
    return (image + np.random.default_rng(seed).normal(0, noise, image.shape)).astype(np.float32)


def chart_pixels(*places):
    """Pixels [places, 2] of places (column, row) of the chart."""
    at = np.column_stack([np.array(places, float), np.ones(len(places))]) @ IMAGE_FROM_CHART.T
    return at[:, :2] / at[:, 2:]


def corners_of_chart():
    """Outermost corners of patches 1, 6, 24 and 19."""
    near, far = (1 - PATCH_SHARE) / 2, 1 - (1 - PATCH_SHARE) / 2
    return chart_pixels((near, near), (5 + far, near), (5 + far, 3 + far), (near, 3 + far))


def camera_responses(count=3):
    """Cameras of one rig: entries differ by 3 %."""
    rng = np.random.default_rng(1)
    return {f"cam{c}": 0.8 * np.eye(3) + rng.normal(0, 0.03, (3, 3)) for c in range(count)}


def write_chart_capture(folder, images, *, values=VALUES, corners=None, black_level=0.0, method="chart"):
    """Write all that calibrate_color reads, an .exr per camera; returns the stage's paths."""
    write_table(folder / "index/cameras.parquet", pd.DataFrame({"camera": list(images)}))
    write_json(folder / "index/capture.json", {"images": {"transfer": "linear", "black_level": black_level}})
    entries = []
    for name, image in images.items():
        write_exr(folder / f"{name}.exr", np.ascontiguousarray(image))
        entries.append({"camera": name, "path": f"{name}.exr", "digest": ""})
    content = {
        "method": method, "transfer": "linear", "images": entries, "patches": values.tolist(), "corners": corners or {}
    }  # fmt: skip
    write_json(folder / "index/calibration_color.json", content)
    return {"capture": folder, "index": folder / "index", "out": folder / "out"}


def errors_of_corrections(folder, planted):
    """Largest error of each camera's corrected response, over the average camera's gain."""
    matrices = read_json(folder / "out/color.json")["cameras"]
    average = np.mean(list(planted.values()), axis=0)
    gain = np.linalg.norm(average) / np.sqrt(3)
    return {name: np.abs(np.array(matrices[name]) @ planted[name] - average).max() / gain for name in planted}
