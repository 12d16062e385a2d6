"""A detector for tests, run as a program: points and masks where the test says, from the standard library and OpenCV.

    python fake_detector.py PLAN landmarks --images images.csv --out points.csv --parts ... --least 0.5

PLAN is JSON: `points`, rows of order, number, x, y, confidence for every image; `mask`, [top, bottom, left, right] of a
rectangle; `fails`, true to end with an error; `shown`, a folder that the pictures are copied to.
"""

from __future__ import annotations

import argparse
import csv
import json
import shutil
import sys
from pathlib import Path

import cv2
import numpy as np


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("plan", type=Path)
    parser.add_argument("what", choices=("landmarks", "masks"))
    parser.add_argument("--images", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--parts", nargs="+")
    parser.add_argument("--least", type=float)
    words = parser.parse_args()
    plan = json.loads(words.plan.read_text())
    if plan.get("fails"):
        sys.exit("no model here")
    with open(words.images, newline="") as file:
        images = list(csv.DictReader(file))
    if "shown" in plan:
        Path(plan["shown"]).mkdir(parents=True, exist_ok=True)
        for row in images:
            shutil.copy(row["path"], Path(plan["shown"]) / f"{row['camera']}_{row['frame']}.png")
    if words.what == "masks":
        write_masks(images, plan["mask"], words.out)
        return
    with open(words.out, "w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["image", "order", "number", "x", "y", "confidence"])
        table.writerows([row["image"], *point] for row in images for point in plan["points"])


def write_masks(images: list[dict], box: list[int], out: Path) -> None:
    out.mkdir()
    for row in images:
        mask = np.zeros(cv2.imread(row["path"]).shape[:2], np.uint8)
        mask[box[0] : box[1], box[2] : box[3]] = 255
        cv2.imwrite(str(out / f"{row['image']}.png"), mask)


if __name__ == "__main__":
    main()
