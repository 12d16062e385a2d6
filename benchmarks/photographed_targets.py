"""Colour charts and mirror balls that others photographed: series of exposures, and directions of lights.

Charts: bllanos/chromatic-aberration, `demo_data`. Balls: yxiong/PSBox, `data`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

from pipeline.base.color import linear_from_srgb
from pipeline.calibration.color.color_chart import find_chart
from pipeline.calibration.color.sensor_linearity import Linearity, measure_linearity
from pipeline.calibration.lights.ball_highlights import measure_spots
from pipeline.calibration.lights.ball_photos import read_ball_photo

FILTERS_NM = (450, 550, 600)
"""Middles of the pass bands that the chart was photographed through."""

PROBE_IMAGES = 12
"""Photographs of each ball, one LED on in each."""

# PSBox (Ying Xiong, MIT licence), data/LightProbe-1/light_directions.txt: a column per image, x right, y up, z to us.
PUBLISHED = """
-0.354310 -0.231485 0.019117 0.267888 0.323648 -0.215681 0.206743 -0.126778 0.188762 0.224017 -0.213533 -0.131566
 0.069972  0.347887 0.377425 0.150072 -0.042205 -0.188019 -0.239130 0.207335 0.183521 -0.312077 -0.330370 -0.193409
 0.932506  0.908509 0.925843 0.951690 0.945236 0.958191 0.948722 0.970020 0.964722 0.923269 0.919380 0.972257
"""


@dataclass(frozen=True)
class FoundChart:
    """A chart that was found in an image, beside the published outlines of its patches.

    Attributes:
        inside: of 24 patches, those of which the middle and all corners of what is measured lie on their own label.
        middle_px: distance of each middle from that of its label.
        patch_px: side of a patch, the root of its label's median area.
    """

    inside: int
    middle_px: Float64[np.ndarray, "24"]
    patch_px: float


def read_series(charts: Path, band_nm: int) -> dict[int, UInt8[np.ndarray, "height width"]]:
    """Mosaics behind one filter, by their exposures in milliseconds, shortest first."""
    paths = {int(re.search(r"_(\d+)ms_", path.name)[1]): path for path in charts.glob(f"*_{band_nm}nm_*.tif")}
    return {ms: cv2.imread(str(paths[ms]), cv2.IMREAD_UNCHANGED) for ms in sorted(paths)}


def series_linearity(series: dict[int, UInt8[np.ndarray, "height width"]], tolerance: float) -> Linearity:
    """Where the counts of a series of 8 bits, of black level 0, stop being linear."""
    counts = np.stack([image.ravel() for image in series.values()]).astype(np.float64)
    return measure_linearity(counts, np.array(list(series)) / 1000, 0.0, 255.0, tolerance)


def find_labelled_chart(charts: Path) -> FoundChart:
    """Find the chart in the RGB image, without its labels, and compare with them."""
    stored = cv2.imread(str(charts / "rgb_chart.tif"))[..., ::-1]
    labels = cv2.imread(str(charts / "labels_rgb.png"), cv2.IMREAD_UNCHANGED)
    squares = find_chart(linear_from_srgb(stored.astype(np.float32) / 255))
    places = np.concatenate([squares, squares.mean(1, keepdims=True)], 1)
    column, row = np.floor(places).astype(int).transpose(2, 0, 1)
    inside = (labels[row, column] == np.arange(1, 25)[:, None]).all(1)
    middles = np.stack([np.argwhere(labels == k).mean(0)[::-1] + 0.5 for k in range(1, 25)])
    areas = [float((labels == k).sum()) for k in range(1, 25)]
    apart = np.linalg.norm(squares.mean(1) - middles, axis=1)
    return FoundChart(int(inside.sum()), apart, float(np.sqrt(np.median(areas))))


def probe_directions(probe: Path) -> Float64[np.ndarray, "images 3"]:
    """Directions of the lights by one ball's highlights: x right, y up, z to the camera.

    The circle is the publishers' (circle_data.txt, clicked by hand): ref.JPG shows the ball before a dark room, which
    is no silhouette. Orthographic, as they have it.
    """
    right, up_from_1, radius = map(float, (probe / "circle_data.txt").read_text().split())
    angle = np.linspace(0, 2 * np.pi, 360, endpoint=False)[:, None]
    found = []
    for number in range(1, PROBE_IMAGES + 1):
        image, clipped = read_ball_photo(probe / f"Image_{number:02d}.JPG", "srgb")
        # They count from 1, upwards, at pixel centres.
        middle = np.array([right - 0.5, len(image) + 0.5 - up_from_1])
        outline = middle + radius * np.concatenate([np.cos(angle), np.sin(angle)], 1)
        x, y = (measure_spots(image, clipped, outline)[0].pixel - middle) / radius
        normal = np.array([x, -y, np.sqrt(1 - x**2 - y**2)])
        found.append(2 * normal[2] * normal - [0, 0, 1])
    return np.stack(found)


def published_directions() -> Float64[np.ndarray, "images 3"]:
    """Unit directions that PSBox publishes for its first ball."""
    table = np.loadtxt(PUBLISHED.split("\n"), ndmin=2).T
    return table / np.linalg.norm(table, axis=1, keepdims=True)


def angles_deg(a: Float64[np.ndarray, "n 3"], b: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, " n"]:
    """Angles between unit directions."""
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(1)))
