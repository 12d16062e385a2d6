"""Pictures of fakes: the imported mesh through the imported cameras, on images and masks."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pandas as pd

from benchmarks.fake_sets import FakeSet
from pipeline.base.color import corrected, srgb_from_linear
from pipeline.base.files import read_arrays, read_json, read_table
from pipeline.capture.images import ImageSource
from pipeline.effects.scene_evidence import read_colors
from pipeline.geometry.cameras import read_cameras
from pipeline.geometry.template_file import read_template
from tests.support.datasets.turning_head import TurningHead

SHOWN_SIDE = 420
"""Height of a picture's panels, pixels."""

SHOWN_FACES = 500
"""Triangles of a mesh that are drawn, evenly chosen: all edges of a fine one would hide the image."""


def draw(fake: FakeSet, truth: TurningHead, project: Path, path: Path, most: int = 4) -> None:
    """Write a picture: images of several cameras with the mask's outline and the projected mesh.

    Sets without masks get the true one.
    """
    results, capture = project / "results" / fake.name, project / "captures" / fake.name
    described, images = read_json(results / "index/capture.json"), read_table(results / "index/images.parquet")
    source = ImageSource.from_index(capture, described["images"])
    cameras = read_cameras(results / "calibration/cameras.json")
    colors = read_colors(results / "calibration/color.json")
    faces = read_template(capture / described["template"]["mesh"], 1.0).faces
    faces = faces[:: -(-len(faces) // SHOWN_FACES)]
    tracked = read_arrays(results / "tracking/0000.safetensors")
    vertices = dict(zip(tracked["frames"].tolist(), tracked["vertices"].astype(np.float64), strict=True))
    # Without masks, fully lit images with a mesh of their own.
    tracking, frames = read_table(results / "tracking/0000.parquet"), read_table(results / "frames.parquet")
    seen = set(tracking.frame[tracking.status == "given"]) & set(frames.frame[frames.fully_lit])
    masked = images[images.mask_path.notna() if images.mask_path.notna().any() else images.frame.isin(seen)]
    names = sorted(masked.camera.unique())
    chosen = [names[i] for i in np.linspace(0, len(names) - 1, min(most, len(names))).round().astype(int)]
    panels = []
    for number, name in enumerate(chosen):
        rows = masked[masked.camera == name].sort_values("frame")
        row = rows.iloc[number * (len(rows) - 1) // max(len(chosen) - 1, 1)]
        image = corrected(source.read(row.path, row.frame), colors[name].astype(np.float32))
        if pd.notna(row.mask_path):
            mask = source.read_mask(row.mask_path, image.shape)
        else:
            mask = truth.labels(name, fake.true_frame(row.frame), np.full(len(truth.faces), 255))
        small = cameras[name].downsampled(float(described["images"]["downsample_from_sensor"]))
        pixels, _ = small.project(vertices[row.frame])
        panels.append(panel(image, mask, pixels[faces], f"{name}, {row.frame}"))
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.hstack(panels)[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 90])


def panel(image: np.ndarray, mask: np.ndarray, triangles: np.ndarray, title: str) -> np.ndarray:
    """An image enlarged, with the mask's outline in pink and the mesh's edges in yellow."""
    factor = SHOWN_SIDE / image.shape[0]
    size = (round(image.shape[1] * factor), SHOWN_SIDE)
    bright = srgb_from_linear(np.clip(image / max(float(np.percentile(image, 99)), 1e-6), 0, 1))
    shown = cv2.resize((255 * bright).astype(np.uint8), size, interpolation=cv2.INTER_NEAREST)
    # From the corner of the first pixel to OpenCV's pixel centres, in sixteenths.
    lines = np.round((triangles * factor - 0.5) * 16).astype(np.int32)
    cv2.polylines(shown, list(lines), isClosed=True, color=(240, 200, 40), lineType=cv2.LINE_AA, shift=4)
    large = cv2.resize(mask, size, interpolation=cv2.INTER_NEAREST)
    outlines, _ = cv2.findContours((large >= 128).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(shown, outlines, -1, (230, 90, 170), 2, cv2.LINE_AA)
    cv2.putText(shown, title, (8, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255, 255, 255), 1, cv2.LINE_AA)
    return shown
