"""Photographs in, keypoints of the template out, by a detector.

It finds bodies, faces with irises, and hands.

For captures without keypoints. Only fully lit frames are looked at. The detector is a program of another environment,
see `pipeline.detection.detector`; what it finds is named as the template names its keypoints, by the tables of
`pipeline.capture.keypoint_orders`. Beside the table: how many images of each camera show anything, and a picture.
"""

from __future__ import annotations

import logging
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.command import run_as_command
from pipeline.base.errors import InputError
from pipeline.base.files import write_table
from pipeline.capture.index.keypoint_tables import KEYPOINT_COLUMNS
from pipeline.capture.keypoint_orders import as_template_keypoints, points_of_eyes
from pipeline.config.detect_landmarks import DetectLandmarks
from pipeline.detection.detector import read_points, run_detector
from pipeline.detection.photographs import Photographs, read_photographs, write_pictures
from pipeline.figures.detected_sheet import draw_landmarks

log = logging.getLogger("detect_landmarks")


def run(*, capture: Path, out: Path, settings: DetectLandmarks = DetectLandmarks()) -> None:
    """Find the template's keypoints in fully lit photographs.

    Args:
        capture: the capture folder; capture.yaml lies at its root.
        out: folder for keypoints_2d.parquet, eye_points.parquet, landmarks.csv and landmarks.png.
        settings: see the flags below.
    """
    photographs = read_photographs(capture, settings.frames == "all")
    if not photographs.keypoints:
        raise InputError(
            "capture.yaml: template.keypoints: expected points that a detector finds, such as nose, left_elbow or "
            "face_30 (docs/detection.md), found none of them; name keypoints so, or say in template.points which "
            "points they are"
        )
    there = "has keypoints, and others are asked for" if photographs.manifest.keypoints_2d else "has no keypoints"
    log.info("the capture %s: looking for them in %s", there, photographs.said)
    with tempfile.TemporaryDirectory() as folder:
        pictures = write_pictures(photographs, Path(folder))
        points = Path(folder) / "points.csv"
        words = ["--images", str(pictures), "--out", str(points), "--parts", *settings.parts]
        run_detector(settings.detector, ["landmarks", *words, "--least", str(settings.least_confidence)])
        found = in_images(read_points(points), photographs)
    orders = found.pop("order").tolist()
    table = as_template_keypoints(found, orders, photographs.keypoints)
    write_table(out / "eye_points.parquet", points_of_eyes(found, orders))
    counts = count_found(table, photographs)
    for row in counts.itertuples():
        log.info("%s: keypoints in %d of %d images, %.1f each", row.camera, row.found, row.images, row.keypoints)
    if table.empty:
        log.warning("the detector found none of the template's keypoints in any image")
    write_table(out / "keypoints_2d.parquet", table[list(KEYPOINT_COLUMNS)])
    write_table(out / "landmarks.csv", counts)
    draw_landmarks(out / "landmarks.png", photographs, table)


def in_images(points: pd.DataFrame, photographs: Photographs) -> pd.DataFrame:
    """Points by camera and frame, without those outside their image.

    A detector guesses what it does not see.
    """
    rows = photographs.images.iloc[points["image"].astype(int).to_numpy()]
    size = np.array([photographs.sizes[camera] for camera in rows["camera"]], np.float64).reshape(-1, 2)
    pixels = points[["x", "y"]].to_numpy(np.float64)
    table = points.rename(columns={"number": "keypoint"}).assign(
        camera=rows["camera"].to_numpy(), frame=rows["frame"].to_numpy()
    )
    inside = ((pixels >= 0) & (pixels <= size)).all(1) & np.isfinite(table["confidence"])
    return table[inside].drop(columns="image").reset_index(drop=True)


def count_found(table: pd.DataFrame, photographs: Photographs) -> pd.DataFrame:
    """A row per camera: images looked at, images with a keypoint, keypoints in each of those."""
    rows = []
    for camera, images in photographs.images.groupby("camera", sort=True):
        mine = table[table["camera"] == camera]
        found = mine["frame"].nunique()
        rows.append((camera, len(images), found, len(mine) / max(found, 1)))
    return pd.DataFrame(rows, columns=["camera", "images", "found", "keypoints"])


def main() -> None:
    """Command line of this stage."""
    run_as_command(run)


if __name__ == "__main__":
    main()
