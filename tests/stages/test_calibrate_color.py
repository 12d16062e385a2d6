"""The stage on drawn charts; the chart's detection itself is tested in tests/unit/capture."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from pipeline.base.errors import InputError
from pipeline.base.files import read_json, read_table, write_json, write_table
from pipeline.calibrate_color import run
from pipeline.capture.images import write_exr

# The classic chart in linear Rec. 709, to two digits.
VALUES = np.array([
    [0.17, 0.08, 0.06], [0.54, 0.30, 0.22], [0.11, 0.19, 0.34], [0.10, 0.15, 0.05],
    [0.23, 0.21, 0.43], [0.12, 0.51, 0.40], [0.69, 0.20, 0.03], [0.06, 0.10, 0.38],
    [0.53, 0.09, 0.12], [0.11, 0.04, 0.14], [0.34, 0.50, 0.05], [0.75, 0.36, 0.03],
    [0.03, 0.05, 0.30], [0.06, 0.29, 0.06], [0.43, 0.03, 0.04], [0.81, 0.57, 0.01],
    [0.50, 0.09, 0.30], [0.00, 0.24, 0.37], [0.90, 0.90, 0.88], [0.58, 0.59, 0.58],
    [0.35, 0.36, 0.36], [0.19, 0.19, 0.19], [0.09, 0.09, 0.09], [0.03, 0.03, 0.03],
])  # fmt: skip
BLACK = 0.01


def draw_chart(response):
    """60-pixel patches, 12 pixels apart on a dark frame."""
    image = np.zeros((420, 560, 3))
    image[50:362, 50:506] = 0.025
    for k, value in enumerate(VALUES):
        row, column = 50 + 12 + 72 * (k // 6), 50 + 12 + 72 * (k % 6)
        image[row : row + 60, column : column + 60] = value
    noise = np.random.default_rng(0).normal(0, 0.002, image.shape)
    return (image @ response.T + noise + BLACK).astype(np.float32)


def responses():
    rng = np.random.default_rng(1)
    return {f"cam{c}": 0.8 * np.eye(3) + rng.normal(0, 0.03, (3, 3)) for c in range(3)}


def write_capture(folder, method="chart"):
    write_table(folder / "index/cameras.parquet", pd.DataFrame({"camera": list(responses())}))
    write_json(folder / "index/capture.json", {"images": {"transfer": "linear", "black_level": BLACK}})
    images = []
    for name, response in responses().items():
        write_exr(folder / f"{name}.exr", draw_chart(response))
        images.append({"camera": name, "path": f"{name}.exr", "digest": ""})
    content = {"method": "chart", "transfer": "linear", "images": images, "patches": VALUES.tolist()}
    write_json(folder / "index/calibration_color.json", content if method == "chart" else {"method": "none"})
    return {"capture": folder, "index": folder / "index", "out": folder / "out"}


def test_drawn_charts_give_the_average_camera(tmp_path):
    run(**write_capture(tmp_path), threads=2)
    matrices = read_json(tmp_path / "out/color.json")["cameras"]
    planted = responses()
    average = np.mean(list(planted.values()), axis=0)
    assert set(matrices) == set(planted)
    for name, matrix in matrices.items():
        # Medians of 1000 pixels of 0.002 and of half floats: a part in a thousand.
        assert matrix @ planted[name] == pytest.approx(average, abs=2e-3)
    residuals = read_table(tmp_path / "out/residuals_color.parquet")
    assert len(residuals) == 3 * 24
    assert residuals.used.all()
    assert residuals[["residual_r", "residual_g", "residual_b"]].abs().to_numpy().max() < 2e-3


def test_no_chart_means_identities(tmp_path):
    run(**write_capture(tmp_path, "none"))
    matrices = read_json(tmp_path / "out/color.json")["cameras"]
    assert all(matrix == np.eye(3).tolist() for matrix in matrices.values())
    assert len(read_table(tmp_path / "out/residuals_color.parquet")) == 0


def test_an_image_without_a_chart_is_named(tmp_path):
    paths = write_capture(tmp_path)
    write_exr(tmp_path / "cam1.exr", np.full((100, 120, 3), 0.2, np.float32))
    with pytest.raises(InputError, match=r"cam1.exr: camera cam1: expected a 24-patch chart, found none"):
        run(**paths)


def test_values_of_another_chart_are_refused(tmp_path):
    paths = write_capture(tmp_path)
    content = read_json(tmp_path / "index/calibration_color.json")
    content["patches"] = np.random.default_rng(3).permutation(VALUES).tolist()
    write_json(tmp_path / "index/calibration_color.json", content)
    with pytest.raises(InputError, match="is it the chart that patches describes"):
        run(**paths)


def test_a_camera_without_an_image_is_named(tmp_path):
    paths = write_capture(tmp_path)
    content = read_json(tmp_path / "index/calibration_color.json")
    del content["images"][2]
    write_json(tmp_path / "index/calibration_color.json", content)
    with pytest.raises(InputError, match="camera cam2: expected an image of the chart, found none"):
        run(**paths)
