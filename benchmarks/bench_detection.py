"""Keypoints and masks that are detected, beside those that a capture has: a page of docs.

    python -m benchmarks.bench_detection --captures captures/subjectA captures/head60 --results results \\
        --heads captures/subjectB captures/closeup --faces ../shared/data/face_near_lights

Captures are synthetic and finished: their truth says where the template was, their own keypoints (a synthetic
detector's, with known noise) where a detector should have found them. Heads have eyes whose gaze is known. The faces
are photographs of a real person, who is not shown. Needs `make detect`.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
import textwrap
from pathlib import Path

import cv2
import numpy as np
import pandas as pd

from benchmarks import bench_gaze
from benchmarks.detection_page import Found, Looks, RealFace, page
from benchmarks.marked_page import read_between
from benchmarks.webcam_person import FACE, eye_gaps
from pipeline.base.errors import InputError
from pipeline.base.files import read_arrays, read_table, write_table
from pipeline.capture.keypoint_orders import points_of_template
from pipeline.config.detect_landmarks import DetectLandmarks
from pipeline.config.segment_subject import SegmentSubject
from pipeline.detection.detector import read_points, run_detector
from pipeline.eyes.iris_gaze import CLOSED
from pipeline.stages import detect_landmarks, index_capture, segment_subject, track_mesh

PAGE = Path("docs/detection.md")

SURE = 0.7
"""Confidence of a capture's own keypoints that count as the reference: those that are neither hidden nor outliers."""

NEAR = 0.05
"""Of the image's height: a detection farther from the reference is called wrong."""


def examine(capture: Path, results: Path, detector: str, folder: Path) -> Found:
    """Detect, compare with the capture's own, and track."""
    detected = folder / "detected"
    detect_landmarks.run(capture=capture, out=detected, settings=DetectLandmarks(detector=detector))
    segment_subject.run(capture=capture, out=detected, settings=SegmentSubject(detector=detector))
    counts, found = pd.read_csv(detected / "landmarks.csv"), read_table(detected / "keypoints_2d.parquet")
    index = results / "index"
    own, names = read_table(index / "keypoints_2d.parquet"), pd.read_csv(capture / "template/keypoints.csv").keypoint
    height = read_table(index / "cameras.parquet").height.iloc[0]
    both = found.merge(own[own.confidence > SURE], on=["frame", "camera", "keypoint"], suffixes=("", "_own"))
    distance = np.hypot(both.x - both.x_own, both.y - both.y_own)
    right = distance <= NEAR * height
    return Found(
        capture.name, int(counts.images.sum()), int(counts.found.sum()),
        (len(points_of_template(list(names))), len(names)),
        float(distance[right].median()), 1 - float(right.mean()), overlap(detected, capture, index),
        (track(capture, results, detected, folder / "index"), tracked_error(capture, results)),
    )  # fmt: skip


def overlap(detected: Path, capture: Path, index: Path) -> float:
    """Median intersection over union of detected masks with the capture's."""
    masks = read_table(detected / "masks.parquet").merge(
        read_table(index / "images.parquet"), on=["camera", "frame"], suffixes=("", "_own")
    )
    shares = []
    for row in masks.itertuples():
        a = cv2.imread(str(detected / "masks" / row.mask_path), cv2.IMREAD_UNCHANGED) > 127
        b = cv2.imread(str(capture / row.mask_path_own), cv2.IMREAD_UNCHANGED) > 127
        shares.append((a & b).sum() / (a | b).sum())
    return float(np.median(shares))


def track(capture: Path, results: Path, detected: Path, index: Path) -> str:
    """Error of the template, mm, tracked with what was detected; or why it was refused."""
    keypoints, masks = detected / "keypoints_2d.parquet", detected / "masks.parquet"
    index_capture.run(capture=capture, out=index, detected_keypoints=keypoints, detected_masks=masks)
    frames = len(read_table(index / "frames.parquet"))
    try:
        track_mesh.run(
            capture=capture, index=index, cameras=results / "calibration/cameras.json",
            lights=results / "calibration/lights.parquet", patterns=results / "patterns.parquet", chunk=0,
            chunk_size=frames, out=index / "tracking",
        )  # fmt: skip
    except InputError as error:
        return textwrap.shorten(f"refused: {error}", 160)
    return vertex_error(capture, [index / "tracking/0000.safetensors"])


def tracked_error(capture: Path, results: Path) -> str:
    """Error of the template as the finished run tracked it, mm."""
    return vertex_error(capture, sorted((results / "tracking").glob("*.safetensors")))


def vertex_error(capture: Path, chunks: list[Path]) -> str:
    """Median and 90th percentile of the distance of the template's vertices from the truth, of all frames, mm.

    After the one rigid motion that fits all frames best: the survey of the lights, which defines the stage's frame, is
    itself off by centimetres.
    """
    truth, found, true = read_arrays(capture / "truth/tracking.safetensors"), [], []
    place = {int(frame): row for row, frame in enumerate(truth["frames"])}
    for chunk in map(read_arrays, chunks):
        found.append(chunk["vertices"].astype(np.float64))
        true.append(truth["vertices"][[place[int(frame)] for frame in chunk["frames"]]].astype(np.float64))
    a, b = np.concatenate(found), np.concatenate(true)
    middle_a, middle_b = a.mean((0, 1)), b.mean((0, 1))
    a, b = a - middle_a, b - middle_b
    u, _, v = np.linalg.svd(np.einsum("fvi,fvj->ij", a, b))
    turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
    middle, most = np.percentile(1e3 * np.linalg.norm(a @ turn - b, axis=-1), [50, 90])
    return f"{middle:.1f} / {most:.1f}"


def gaze_by_irises(capture: Path, results: Path, folder: Path) -> Looks:
    """Gaze of a drawn head by pixels alone, and with the irises that MediaPipe finds, too."""
    points, index = bench_gaze.detected(capture, folder / "detected"), results / "index"
    irises, rms = bench_gaze.iris_errors(capture, index, points), []
    shutil.copytree(index, folder / "index")
    for table in (bench_gaze.no_irises(), points):
        write_table(folder / "index/eye_points.parquet", table)
        angle = bench_gaze.errors(capture, results, folder / "index", folder).query("not interpolated").angle
        rms.append(float(np.sqrt((angle**2).mean())))
    width = bench_gaze.iris_width(capture, index)
    return Looks(capture.name, width, irises.visible, irises.found, irises.median_px, irises.unseen, *rms)


def real_face(folder: Path, detector: str, work: Path) -> RealFace:
    """What is found of a face, its eyes closed, in photographs that show it under a single lamp each."""
    photographs, rows = sorted(folder.glob("[0-9]*.png")), ["image,path,camera,frame"]
    for number, path in enumerate(photographs):
        picture = work / f"{number}.png"
        linear = cv2.imread(str(path), cv2.IMREAD_REDUCED_COLOR_4) / 255.0
        shown = np.clip(linear / np.percentile(linear, 99.5), 0, 1) ** (1 / 2.2)
        assert cv2.imwrite(str(picture), np.round(255 * shown).astype(np.uint8))
        rows.append(f"{number},{picture},c,{number}")
    (work / "images.csv").write_text("\n".join(rows))
    run_detector(detector, ["landmarks", "--images", str(work / "images.csv"), "--out", str(work / "points.csv")])
    points = read_points(work / "points.csv")
    seen = points.groupby("order").image.nunique()
    gaps = [gap for _, mesh in points[points.order == FACE].groupby("image") for gap in eye_gaps(mesh)]
    closed = sum(gap < CLOSED for gap in gaps)
    return RealFace(len(photographs), int(seen.get(FACE, 0)), int(seen.get("mediapipe_pose_33", 0)), len(gaps), closed)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--captures", type=Path, nargs="+", required=True)
    parser.add_argument("--results", type=Path, default=Path("results"))
    parser.add_argument("--heads", type=Path, nargs="*", default=[], help="captures with eyes, finished up to tracking")
    parser.add_argument("--faces", type=Path, help="folder of face_near_lights")
    parser.add_argument("--detector", default="", help="command; MediaPipe's of make detect if left out")
    parser.add_argument("--out", type=Path, default=PAGE)
    options = parser.parse_args()
    found = []
    for capture in options.captures:
        with tempfile.TemporaryDirectory() as folder:
            found.append(examine(capture, options.results / capture.name, options.detector, Path(folder)))
            print(found[-1], flush=True)
    looks, face = [], None
    for capture in options.heads:
        with tempfile.TemporaryDirectory() as folder:
            looks.append(gaze_by_irises(capture, options.results / capture.name, Path(folder)))
            print(looks[-1], flush=True)
    if options.faces is not None:
        with tempfile.TemporaryDirectory() as folder:
            face = real_face(options.faces, options.detector, Path(folder))
            print(face)
    options.out.write_text(page(found, looks, face, read_between(options.out, "webcams")))


if __name__ == "__main__":
    main()
