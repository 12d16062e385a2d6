"""Orders in which detectors number keypoints, and the points of a template they mean.

`keypoint_orders.csv` has a row for each keypoint of each order: its number, its label there if it has one, and the
point, a name that all orders share. `keypoint_names.csv` has further names of points, those of templates. Sources:
OpenPose's BODY_25; COCO's 17; iBUG's 68 of 300-W, which FLAME's 68 follow; WFLW's 98; SMPL-X's joints and landmarks as
the package smplx names them; MediaPipe's pose, face mesh with irises and hands (OpenPose counts a hand's alike).
What an order has alone keeps a name of its own, such as wflw_1.
"""

from __future__ import annotations

import csv
import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from types import MappingProxyType

import pandas as pd

ORDERS_FILE, NAMES_FILE = "keypoint_orders.csv", "keypoint_names.csv"

CHOICES = (
    "openpose_body_25", "coco_17", "ibug_68", "flame_68", "wflw_98", "smplx_144", "mediapipe_pose_33",
    "mediapipe_face_478", "left_hand_21", "right_hand_21",
)  # fmt: skip
"""Orders that `keypoints_order` of capture.yaml may name; the rows of the table, which a test holds in step."""

NOTHING_GIVEN: Mapping[str, str] = MappingProxyType({})


@dataclass(frozen=True)
class KeypointOrder:
    """One way to number keypoints.

    Attributes:
        points: the point that each number means.
        labels: number by the label that the order's authors gave it.
    """

    points: tuple[str, ...]
    labels: Mapping[str, int]

    def point(self, keypoint: str) -> str | None:
        """The point that a label or a number means; None if the order has no such."""
        if keypoint in self.labels:
            return self.points[self.labels[keypoint]]
        number = int(keypoint) if keypoint.isdigit() else len(self.points)
        return self.points[number] if number < len(self.points) else None


@functools.cache
def read_orders() -> dict[str, KeypointOrder]:
    """All orders of the table, by name."""
    points: dict[str, list[str]] = {}
    labels: dict[str, dict[str, int]] = {}
    for row in _rows(ORDERS_FILE):
        own = points.setdefault(row["order"], [])
        if int(row["number"]) != len(own):
            raise ValueError(f"{ORDERS_FILE}: {row['order']}: expected number {len(own)}, found {row['number']}")
        # A label of digits, as iBUG counts from 1, would be taken for a number.
        if row["label"] and not row["label"].isdigit():
            labels.setdefault(row["order"], {})[row["label"]] = len(own)
        own.append(row["point"])
    return {name: KeypointOrder(tuple(own), labels.get(name, {})) for name, own in points.items()}


@functools.cache
def _point_names() -> dict[str, str]:
    names = {row["name"]: row["point"] for row in _rows(NAMES_FILE)}
    for order in read_orders().values():
        names |= {point: point for point in order.points}
    return names


def points_of_template(names: Sequence[str], given: Mapping[str, str] = NOTHING_GIVEN) -> dict[str, str]:
    """The template's keypoint that each point is, of those keypoints of which that is known.

    Args:
        names: keypoints of the template: points as the tables name them, or other names of `keypoint_names.csv`.
        given: points by keypoint, for names that say nothing.
    """
    known = {**_point_names(), **given}
    return {known[name]: name for name in names if name in known}


def as_template_keypoints(table: pd.DataFrame, orders: Sequence[str], template: Mapping[str, str]) -> pd.DataFrame:
    """Detections by the template's keypoints; what the template does not have is left out.

    Where several orders mean the same point of an image, as both a body and a face have a nose, the surest stays.

    Args:
        table: frame, camera, keypoint (label or number of its order), x, y, confidence.
        orders: the order of each row.
        template: its keypoint by point, of `points_of_template`.
    """
    known = read_orders()
    points = [known[order].point(str(key)) for order, key in zip(orders, table["keypoint"], strict=True)]
    mine = table.assign(keypoint=[template.get(point) if point else None for point in points])
    mine = mine[mine["keypoint"].notna()].sort_values("confidence", ascending=False, kind="stable")
    mine = mine.drop_duplicates(["frame", "camera", "keypoint"])
    return mine.sort_values(["frame", "camera", "keypoint"], kind="stable", ignore_index=True)


EYE_POINTS = frozenset(
    [f"face_{k}" for k in range(36, 48)]
    + [f"{side}_{part}" for side in ("left", "right") for part in ("eye_upper", "eye_lower", "pupil")]
)
"""Points of contours of eyes, and the middles of irises."""

EYE_COLUMNS = ("frame", "camera", "point", "x", "y", "confidence")


def points_of_eyes(table: pd.DataFrame, orders: Sequence[str]) -> pd.DataFrame:
    """Detections of eyes, `EYE_COLUMNS`, whether the template has such keypoints or not.

    Args:
        table: frame, camera, keypoint (label or number of its order), x, y, confidence.
        orders: the order of each row.
    """
    known = read_orders()
    points = [known[order].point(str(key)) for order, key in zip(orders, table["keypoint"], strict=True)]
    eyes = table.assign(point=pd.Series(points, table.index, "object"))
    eyes = eyes[eyes["point"].isin(EYE_POINTS)].astype({"point": "str", "camera": "str"})
    eyes = eyes.sort_values("confidence", ascending=False, kind="stable").drop_duplicates(["frame", "camera", "point"])
    return eyes.sort_values(["frame", "camera", "point"], ignore_index=True)[list(EYE_COLUMNS)]


def _rows(name: str) -> list[dict[str, str]]:
    with files("pipeline.capture").joinpath(name).open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))
