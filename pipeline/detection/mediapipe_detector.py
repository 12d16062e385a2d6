"""MediaPipe's landmarks and masks of images: a program that another environment runs.

    PYTHON mediapipe_detector.py landmarks --images images.csv --out points.csv --parts body face hands
    PYTHON mediapipe_detector.py masks --images images.csv --out FOLDER

It imports nothing of this project, and `mediapipe` only when it runs: that wants another NumPy (envs/detect.yaml). Its
models are those that the wheel of 0.10.21 holds; nothing is fetched. Images are 8-bit PNG in sRGB. Points are
in pixels, the image's corner being (0, 0); numbers are those of the orders that keypoint_orders.csv lists.
"""

from __future__ import annotations

import argparse
import csv
import os
from collections.abc import Iterator
from pathlib import Path

POINT_COLUMNS = ("image", "order", "number", "x", "y", "confidence")
"""Columns of a table of points: of which image, which point of which order, where, and how sure."""

FACE_CONFIDENCE = 0.9
"""Of every point of a face: the mesh comes as a whole, without a confidence of its own."""

Row = tuple[str, str, int, float, float, float]


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("landmarks", "masks"))
    parser.add_argument("--images", type=Path, required=True, help="csv: image, path, camera, frame")
    parser.add_argument("--out", type=Path, required=True, help="csv of points, or folder of masks IMAGE.png")
    parser.add_argument("--parts", nargs="+", choices=tuple(FINDERS), default=list(FINDERS), help="of a person")
    parser.add_argument("--least", type=float, default=0.5, help="least confidence of a detection, 0 to 1")
    options = parser.parse_args()
    os.environ.setdefault("GLOG_minloglevel", "2")
    with open(options.images, newline="", encoding="utf-8") as file:
        images = [(row["image"], row["path"]) for row in csv.DictReader(file)]
    if options.what == "masks":
        write_masks(images, options.out)
        return
    with open(options.out, "w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(POINT_COLUMNS)
        for part in options.parts:
            table.writerows(FINDERS[part](images, options.least))


def find_bodies(images: list[tuple[str, str]], least: float) -> Iterator[Row]:
    """Rows of order mediapipe_pose_33; a point's confidence is its visibility."""
    import mediapipe

    with mediapipe.solutions.pose.Pose(
        static_image_mode=True, model_complexity=1, min_detection_confidence=least
    ) as model:
        for name, picture in _squares(images):
            found = model.process(picture).pose_landmarks
            if found is not None:
                confidence = [point.visibility for point in found.landmark]
                yield from _rows(name, "mediapipe_pose_33", found.landmark, confidence, picture.shape)


def find_faces(images: list[tuple[str, str]], least: float) -> Iterator[Row]:
    """Rows of order mediapipe_face_478, irises included."""
    import mediapipe

    with mediapipe.solutions.face_mesh.FaceMesh(
        static_image_mode=True, refine_landmarks=True, min_detection_confidence=least
    ) as model:
        for name, picture in _squares(images):
            for face in model.process(picture).multi_face_landmarks or []:
                confidence = [FACE_CONFIDENCE] * len(face.landmark)
                yield from _rows(name, "mediapipe_face_478", face.landmark, confidence, picture.shape)


def find_hands(images: list[tuple[str, str]], least: float) -> Iterator[Row]:
    """Rows of orders left_hand_21 and right_hand_21, of each side the surer hand.

    MediaPipe names the sides of a mirrored picture, as of a webcam: what it calls left is right.
    """
    import mediapipe

    with mediapipe.solutions.hands.Hands(
        static_image_mode=True, max_num_hands=2, model_complexity=1, min_detection_confidence=least
    ) as model:
        for name, picture in _squares(images):
            found = model.process(picture)
            sides: dict[str, tuple[float, list]] = {}
            for hand, side in zip(found.multi_hand_landmarks or [], found.multi_handedness or [], strict=True):
                label = {"Left": "right", "Right": "left"}[side.classification[0].label]
                score = side.classification[0].score
                if score > sides.get(label, (0.0, []))[0]:
                    sides[label] = (score, hand.landmark)
            for label, (score, points) in sides.items():
                yield from _rows(name, f"{label}_hand_21", points, [score] * len(points), picture.shape)


FINDERS = {"body": find_bodies, "face": find_faces, "hands": find_hands}


def write_masks(images: list[tuple[str, str]], out: Path) -> None:
    """Write a mask per image, 255 = person, by selfie segmentation (256 x 256)."""
    import cv2
    import mediapipe
    import numpy

    out.mkdir(parents=True, exist_ok=True)
    with mediapipe.solutions.selfie_segmentation.SelfieSegmentation(model_selection=0) as model:
        for name, picture in _read(images):
            share = model.process(picture).segmentation_mask
            cv2.imwrite(str(out / f"{name}.png"), numpy.round(255 * share.clip(0, 1)).astype(numpy.uint8))


def _read(images: list[tuple[str, str]]) -> Iterator[tuple[str, object]]:
    import cv2

    for name, path in images:
        stored = cv2.imread(path, cv2.IMREAD_COLOR)
        if stored is None:
            raise SystemExit(f"{path}: expected an image that can be read, found none")
        yield name, cv2.cvtColor(stored, cv2.COLOR_BGR2RGB)


def _squares(images: list[tuple[str, str]]) -> Iterator[tuple[str, object]]:
    """Pictures with black below or beside them: MediaPipe projects landmarks of squares alone without an error."""
    import numpy

    for name, picture in _read(images):
        height, width = picture.shape[:2]
        side = max(height, width)
        yield name, numpy.pad(picture, ((0, side - height), (0, side - width), (0, 0)))


def _rows(name: str, order: str, points: list, confidence: list[float], shape: tuple[int, ...]) -> Iterator[Row]:
    height, width = shape[:2]
    for number, (point, sure) in enumerate(zip(points, confidence, strict=True)):
        yield name, order, number, point.x * width, point.y * height, sure


if __name__ == "__main__":
    main()
