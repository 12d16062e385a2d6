"""The stage on raw Bayer mosaics: drawn ones, and photographs of a chart through narrow filters."""

from __future__ import annotations

import logging
import re

import cv2
import numpy as np
import pandas as pd
import pytest

from benchmarks.photographed_targets import read_series
from pipeline.base.files import read_json, read_table, write_json, write_table
from pipeline.capture.images import write_png
from pipeline.stages.calibrate_color import run
from tests.support.drawings.chart import VALUES, camera_responses, draw_chart, errors_of_corrections
from tests.support.shared_data import shared_data

CHARTS, needs_charts = shared_data("data/chart_photographs")

SITES = {"R": 0, "G": 1, "B": 2}
BLACK, FULL = 1000, 65535
PLANTED = camera_responses(2)
SECONDS = (0.01, 0.02, 0.04, 0.08)
BEND = 0.45
"""Share of full scale from which a drawn sensor collects half as much."""


def to_mosaic(image, pattern="GBRG"):
    """One channel of each pixel."""
    out = np.empty(image.shape[:2], image.dtype)
    for k, color in enumerate(pattern):
        out[k // 2 :: 2, k % 2 :: 2] = image[k // 2 :: 2, k % 2 :: 2, SITES[color]]
    return out


def expose(image, bend=np.inf):
    """Counts of 16 bits above a black level."""
    stored = np.minimum(image, 0.5 * image + 0.5 * bend)
    return np.clip(np.round(BLACK + stored * FULL), 0, FULL).astype(np.uint16)


def write_raw_capture(folder, images, exposures=(), values=VALUES, **options):
    """An index and an image per camera; `exposures` are (camera, seconds, image)."""
    write_table(folder / "index/cameras.parquet", pd.DataFrame({"camera": list(images)}))
    write_json(folder / "index/capture.json", {"images": {"transfer": "linear", "black_level": 0.0}})
    entries = [{"camera": name, "path": f"{name}.png", "digest": ""} for name in images]
    series = [{"camera": c, "path": f"{c}_{k}.png", "exposure_s": s} for k, (c, s, _) in enumerate(exposures)]
    for entry, image in zip(entries + series, [*images.values(), *(e[2] for e in exposures)], strict=True):
        write_png(folder / entry["path"], image)
    content = {
        "method": "chart", "transfer": "linear", "images": entries, "patches": values.tolist(), "corners": {},
        "mosaic": "GBRG", "black_level": BLACK, "exposures": series, **options,
    }  # fmt: skip
    write_json(folder / "index/calibration_color.json", content)
    return {"capture": folder, "index": folder / "index", "out": folder / "out"}


def mosaics(bend=np.inf):
    return {name: to_mosaic(expose(draw_chart(response), bend)) for name, response in PLANTED.items()}


def test_mosaics_above_a_black_level_are_calibrated(tmp_path):
    run(**write_raw_capture(tmp_path, mosaics()))
    # A quarter of the pixels or half of them see a channel: medians of 75 of noise 0.003, twice those of whole images.
    assert max(errors_of_corrections(tmp_path, PLANTED).values()) < 6e-3
    assert read_table(tmp_path / "out/quality_color.parquet").linear_up_to.isna().all()


def test_a_series_of_exposures_leaves_out_what_is_not_linear(tmp_path, caplog):
    """Bright patches of a sensor that bends look dirty, unless the series of exposures says where it does."""
    scene = draw_chart(PLANTED["cam1"], noise=0.001)
    scene = np.maximum(scene, np.linspace(0.01, 1, scene.shape[1], dtype=np.float32)[:, None])  # All brightnesses.
    series = [("cam1", s, to_mosaic(expose(scene * s / SECONDS[2], BEND))) for s in SECONDS]
    images = mosaics() | {"cam1": mosaics(BEND)["cam1"]}
    run(**write_raw_capture(tmp_path / "without", images))
    with caplog.at_level(logging.INFO):
        run(**write_raw_capture(tmp_path / "with", images, series))
    reasons = {}
    for folder in ("without", "with"):
        assert max(errors_of_corrections(tmp_path / folder, PLANTED).values()) < 6e-3
        reasons[folder] = pd.read_csv(tmp_path / folder / "out/verdicts_color.csv").set_index("name").reason["cam1"]
    # The robust fit lives with four patches that are too dark, but takes them for dirty.
    assert "at patches 7, 12, 16, 19; are they dirty" in reasons["without"]
    assert "expected" not in reasons["with"]
    quality = read_table(tmp_path / "with/out/quality_color.parquet").set_index("camera")
    # Half of the signal above the bend: 2 % are missing 4 % above it.
    assert quality.linear_up_to["cam1"] == pytest.approx(BLACK + 1.02 * BEND * FULL, rel=0.03)
    assert quality.black_level["cam1"] == pytest.approx(BLACK, abs=0.001 * FULL)
    assert re.search(r"cam1: linear up to a count of \S+, black level 1e\+03 \(to 2.0 %\)", caplog.text)


def test_a_wrong_black_level_is_named(tmp_path):
    scene = np.maximum(draw_chart(PLANTED["cam1"]), np.linspace(0.01, 1, 560, dtype=np.float32)[:, None])
    series = [("cam1", s, to_mosaic(expose(scene * s / SECONDS[2]))) for s in SECONDS]
    run(**write_raw_capture(tmp_path, mosaics(), series, black_level=0))
    verdicts = pd.read_csv(tmp_path / "out/verdicts_color.csv").set_index("name")
    assert verdicts.grade["cam1"] == "weak"
    assert "expected a black level of 0, found 1e+03 by the series of exposures" in verdicts.reason["cam1"]


@needs_charts
def test_photographed_mosaics_give_the_response_that_their_labels_say(tmp_path):
    """A mosaic of three filters, against colours of half the exposure by the published outlines of the patches."""
    red, green, blue = (read_series(CHARTS, band) for band in (600, 550, 450))
    shown = to_mosaic(np.stack([red[100], green[50], blue[50]], -1))
    labels = cv2.imread(str(CHARTS / "labels_bayer.png"), cv2.IMREAD_UNCHANGED)
    half, values = to_mosaic(np.stack([red[50], green[25], blue[25]], -1)), np.empty((24, 3))
    sites = to_mosaic(np.broadcast_to([0, 1, 2], (*half.shape, 3)))
    for k, c in np.ndindex(24, 3):
        values[k, c] = half[(labels == k + 1) & (sites == c)].mean() / 255
    series = [("cam", ms / 1000, image) for ms, image in green.items()]
    run(**write_raw_capture(tmp_path, {"cam": shown}, series, values=values, black_level=0))
    assert read_json(tmp_path / "out/color.json")["cameras"]["cam"] == pytest.approx(np.eye(3), abs=1e-9)
    residuals = read_table(tmp_path / "out/residuals_color.parquet")
    color = residuals[["r", "g", "b"]].to_numpy()
    used = residuals.used.to_numpy(bool)
    # Patch 19 has 167 counts and more at half the exposure, and is over the limit.
    assert not used[18] and used.sum() >= 20
    matrix = np.linalg.lstsq(values[used], color[used], rcond=None)[0].T
    assert matrix == pytest.approx(2 * np.eye(3), abs=0.05)
    limit = read_table(tmp_path / "out/quality_color.parquet").linear_up_to[0]
    assert 170 < limit < 240
