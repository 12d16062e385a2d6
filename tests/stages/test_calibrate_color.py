"""The stage on drawn charts and on the synthetic subject. What goes wrong is in tests/hard_cases."""

from __future__ import annotations

import weakref
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pipeline.base.errors import InputError
from pipeline.base.files import read_json, read_table, write_json
from pipeline.calibration.color.chart_images import ChartFormat
from pipeline.config.calibrate_color import CalibrateColor
from pipeline.stages.calibrate_color import run
from pipeline.stages.index_capture import run as index_capture
from tests.support.drawings.chart import (
    camera_responses,
    chart_pixels,
    draw_chart,
    errors_of_corrections,
    write_chart_capture,
)

SUBJECT = Path(__file__).parents[2] / "captures/subjectA"

BLACK = 0.01


def write_capture(folder, **options):
    images = {name: draw_chart(response) + np.float32(BLACK) for name, response in camera_responses().items()}
    return write_chart_capture(folder, images, black_level=BLACK, **options)


def test_drawn_charts_give_the_average_camera(tmp_path):
    run(**write_capture(tmp_path), threads=2)
    errors = errors_of_corrections(tmp_path, camera_responses())
    # Medians of 300 pixels of 0.003 and of half floats: a part in a thousand.
    assert max(errors.values()) < 3e-3
    residuals = read_table(tmp_path / "out/residuals_color.parquet")
    assert len(residuals) == 3 * 24
    assert residuals.used.all()
    assert residuals[["residual_r", "residual_g", "residual_b"]].abs().to_numpy().max() < 2e-3
    verdicts = pd.read_csv(tmp_path / "out/verdicts_color.csv")
    assert list(verdicts.name) == ["cam0", "cam1", "cam2"]
    assert set(verdicts.grade) == {"good"}


def test_images_of_other_cameras_are_not_kept(tmp_path, monkeypatch):
    """They are several hundred megabytes each; of a refused camera, the image is read once more."""
    read, kept, most = ChartFormat.read, [], []

    def counted(form, path):
        most.append(sum(reference() is not None for reference in kept))
        kept.append(weakref.ref(image := read(form, path)))
        return image

    monkeypatch.setattr(ChartFormat, "read", counted)
    with pytest.raises(InputError, match=r"see .*refused_color_cam0\.png"):
        run(**write_capture(tmp_path), settings=CalibrateColor(least_patches=24, saturation=0.1))
    assert most == [0] * 6


def test_residuals_say_where_each_patch_lies(tmp_path):
    run(**write_capture(tmp_path))
    residuals = read_table(tmp_path / "out/residuals_color.parquet")
    middles = chart_pixels(*[(column + 0.5, row + 0.5) for row in range(4) for column in range(6)])
    for _, group in residuals.groupby("camera"):
        assert list(group.patch) == list(range(1, 25))
        corners = group[[f"{axis}{corner}" for corner in range(4) for axis in "xy"]].to_numpy().reshape(24, 4, 2)
        assert corners.mean(1) == pytest.approx(middles, abs=4)


def test_no_chart_means_identities(tmp_path):
    run(**write_capture(tmp_path, method="none"))
    matrices = read_json(tmp_path / "out/color.json")["cameras"]
    assert set(matrices) == set(camera_responses())
    assert all(matrix == np.eye(3).tolist() for matrix in matrices.values())
    assert len(read_table(tmp_path / "out/residuals_color.parquet")) == 0
    assert len(pd.read_csv(tmp_path / "out/verdicts_color.csv")) == 0


def test_a_camera_without_an_image_is_named(tmp_path):
    paths = write_capture(tmp_path)
    content = read_json(tmp_path / "index/calibration_color.json")
    del content["images"][2]
    write_json(tmp_path / "index/calibration_color.json", content)
    with pytest.raises(InputError, match="camera cam2: expected an image of the chart, found none"):
        run(**paths)


@pytest.mark.skipif(not (SUBJECT / "truth/color.json").is_file(), reason="needs captures/subjectA: make it first")
def test_photographed_charts_give_the_true_responses(tmp_path):
    """Up to a scale common to all cameras, of which a chart says nothing, every entry within 1.5 % of the gain."""
    index_capture(capture=SUBJECT, out=tmp_path / "index")
    run(capture=SUBJECT, index=tmp_path / "index", out=tmp_path / "out", threads=2)
    corrected = read_json(tmp_path / "out/color.json")["cameras"]
    truth = {name: np.array(m) for name, m in read_json(SUBJECT / "truth/color.json")["raw_from_true"].items()}
    average = np.mean(list(truth.values()), axis=0)
    estimated = {name: np.linalg.inv(corrected[name]) @ average for name in truth}
    stack, true = np.stack(list(estimated.values())), np.stack(list(truth.values()))
    scale = (stack * true).sum() / (stack**2).sum()
    assert np.abs(scale * stack - true).max() < 0.015 * np.linalg.norm(average) / np.sqrt(3)
