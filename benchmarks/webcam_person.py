"""What a detector finds of a real person before four webcams, and how well the views agree.

Videos: mprib/caliscope (BSD-2), as the cameras, which are those of its authors. The person moves a board; the images of
one moment are up to a tenth of a second apart.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pandas as pd

from benchmarks.photographed_rigs import caliscope_cameras, caliscope_frames
from pipeline.capture.keypoint_orders import read_orders
from pipeline.detection.detector import read_points, run_detector
from pipeline.eyes.iris_gaze import CLOSED, SIDES, openness
from pipeline.geometry.triangulation import Triangulation, triangulate

EVERY = 10
"""One of so many moments is looked at."""

FACE = "mediapipe_face_478"

PARTS = {"body": ("mediapipe_pose_33",), "face": (FACE,), "hands": ("left_hand_21", "right_hand_21")}
"""Part -> orders of its points."""

SURE = 0.7
"""Least confidence of points that are held against other views."""

AGREE_PX = 20.0
"""Farther from where the other views have a point, a detection is wrong: 3 % of the images' height."""

PUPILS = ("left_pupil", "right_pupil")


@dataclass(frozen=True)
class Agreement:
    """Points of a part that two cameras or more are sure of.

    Attributes:
        points: of all moments together.
        wrong: share of their detections farther than `AGREE_PX` from where the others have them.
        pixels: median distance of the others.
    """

    points: int
    wrong: float
    pixels: float


@dataclass(frozen=True)
class WebcamPerson:
    """A real person, found.

    Attributes:
        seen: camera -> images with a body, a face and a hand.
        moments: images of each camera.
        agreement: by part.
        apart_mm: distance of the irises' middles, median over the moments in which two cameras have both.
        eyes, closed: eyes of all faces, and those called closed.
    """

    seen: dict[str, tuple[int, int, int]]
    moments: int
    agreement: dict[str, Agreement]
    apart_mm: float
    eyes: int
    closed: int


def read_moments(data: Path, work: Path) -> pd.DataFrame:
    """One of `EVERY` moments as PNG files in `work`: image, path, camera, frame."""
    rows = []
    for name in caliscope_cameras(data):
        for frame, image in caliscope_frames(data, name, EVERY):
            path = work / f"{name}_{frame:03d}.png"
            if not cv2.imwrite(str(path), image):
                raise OSError(f"{path}: could not be written")
            rows.append((path.stem, str(path), name, frame))
    return pd.DataFrame(rows, columns=["image", "path", "camera", "frame"])


def examine_person(data: Path, detector: str, work: Path) -> tuple[WebcamPerson, pd.DataFrame]:
    """Detect, and hold the views against each other. Also the points that were found, with camera and frame."""
    images = read_moments(data, work)
    images.to_csv(work / "images.csv", index=False)
    run_detector(detector, ["landmarks", "--images", str(work / "images.csv"), "--out", str(work / "points.csv")])
    points = read_points(work / "points.csv").merge(images, on="image")
    seen = {
        camera: tuple(int(own[own.order.isin(orders)].image.nunique()) for orders in PARTS.values())
        for camera, own in points.groupby("camera")
    }
    agreement = {part: agree(*placed(data, points[points.order.isin(orders)])) for part, orders in PARTS.items()}
    faces = points[points.order == FACE]
    gaps = [gap for _, mesh in faces.groupby("image") for gap in eye_gaps(mesh)]
    person = WebcamPerson(
        seen, int(images.frame.nunique()), agreement, iris_distance_mm(data, faces), len(gaps),
        sum(gap < CLOSED for gap in gaps),
    )  # fmt: skip
    return person, points


def placed(data: Path, points: pd.DataFrame) -> tuple[pd.MultiIndex, Triangulation]:
    """Points that two cameras or more are sure of, by frame, order and number, triangulated."""
    cameras = caliscope_cameras(data)
    sure = points[points.confidence >= SURE]
    wide = sure.pivot_table(index=["frame", "order", "number"], columns="camera", values=["x", "y"])
    wide = wide[wide["x"].notna().sum(axis=1) >= 2]
    normalised = [
        camera.undistort(wide.reindex(columns=[("x", name), ("y", name)]).to_numpy(np.float64))
        for name, camera in cameras.items()
    ]
    observed = np.stack(normalised)
    known = np.isfinite(observed).all(-1).astype(np.float64)
    return wide.index, triangulate(list(cameras.values()), observed, known, AGREE_PX)


def agree(index: pd.MultiIndex, found: Triangulation) -> Agreement:
    """How well the views of these points agree."""
    seen = np.isfinite(found.residual_px) | found.inlier
    pixels = float(np.median(found.residual_px[found.inlier])) if found.inlier.any() else np.nan
    return Agreement(len(index), 1 - float(found.inlier.sum() / max(seen.sum(), 1)), pixels)


def iris_distance_mm(data: Path, faces: pd.DataFrame) -> float:
    """Median distance of the two irises' middles over the moments in which both are placed."""
    names = read_orders()[FACE].points
    numbers = {str(names.index(pupil)) for pupil in PUPILS}
    index, found = placed(data, faces[faces.number.isin(numbers)])
    table = pd.DataFrame(found.points, index=index).dropna().reset_index()
    both = [pair[[0, 1, 2]].to_numpy() for _, pair in table.groupby("frame") if len(pair) == 2]
    return float(np.median([1e3 * np.linalg.norm(a - b) for a, b in both])) if both else np.nan


def eye_gaps(mesh: pd.DataFrame) -> list[float]:
    """`openness` of both eyes of a face's mesh."""
    names, numbers = read_orders()[FACE].points, mesh.number.astype(int)
    named = {names[number]: place for number, place in zip(numbers, mesh[["x", "y"]].to_numpy(np.float64), strict=True)}
    return [openness(named, side) for side in SIDES]
