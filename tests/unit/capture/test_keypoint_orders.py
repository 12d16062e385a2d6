"""Orders of keypoints against what their authors publish, and detections named by a template."""

from __future__ import annotations

import pandas as pd
import pytest

from pipeline.capture.keypoint_orders import (
    CHOICES,
    EYE_POINTS,
    as_template_keypoints,
    points_of_eyes,
    points_of_template,
    read_orders,
)

PUBLISHED = {
    # OpenPose's documentation of BODY_25.
    ("openpose_body_25", "LElbow"): (6, "left_elbow"), ("openpose_body_25", "MidHip"): (8, "mid_hip"),
    ("openpose_body_25", "RHeel"): (24, "right_heel"),
    # COCO's person_keypoints_train2017.json.
    ("coco_17", "left_shoulder"): (5, "left_shoulder"), ("coco_17", "right_ankle"): (16, "right_ankle"),
    # The names of joints of the package smplx.
    ("smplx_144", "left_wrist"): (20, "left_wrist"), ("smplx_144", "left_index1"): (25, "left_index_1"),
    ("smplx_144", "right_thumb3"): (54, "right_thumb_3"), ("smplx_144", "nose"): (55, "nose"),
    ("smplx_144", "right_eye_brow1"): (76, "face_17"), ("smplx_144", "left_mouth_1"): (113, "face_54"),
    ("smplx_144", "contour_middle"): (135, "face_8"),
    # MediaPipe's PoseLandmark.
    ("mediapipe_pose_33", "left_hip"): (23, "left_hip"), ("mediapipe_pose_33", "right_heel"): (30, "right_heel"),
}  # fmt: skip

SIZES = (25, 17, 68, 68, 98, 144, 33, 478, 21, 21)


def test_orders_have_as_many_points_as_they_say():
    orders = read_orders()
    assert tuple(orders) == CHOICES
    assert tuple(len(order.points) for order in orders.values()) == SIZES
    assert all(len(set(order.points)) == len(order.points) for order in orders.values())


@pytest.mark.parametrize(("order", "label"), PUBLISHED)
def test_labels_and_numbers_are_the_published_ones(order, label):
    number, point = PUBLISHED[order, label]
    assert read_orders()[order].point(label) == read_orders()[order].point(str(number)) == point


def test_faces_of_all_orders_meet_at_the_same_points():
    """Nose tip, outer corners of the eyes and of the mouth, chin: iBUG's figure, WFLW's and MediaPipe's."""
    numbers = {
        "ibug_68": (30, 36, 45, 48, 54, 8), "flame_68": (30, 36, 45, 48, 54, 8), "wflw_98": (54, 60, 72, 76, 82, 16),
        "smplx_144": (89, 95, 104, 107, 113, 135), "mediapipe_face_478": (4, 33, 263, 61, 291, 152),
    }  # fmt: skip
    orders = read_orders()
    assert len({tuple(orders[name].points[n] for n in own) for name, own in numbers.items()}) == 1


@pytest.mark.parametrize("order", ["openpose_body_25", "coco_17", "smplx_144", "mediapipe_pose_33"])
def test_what_is_on_the_left_is_on_the_right_too(order):
    points = [point for point in read_orders()[order].points if not point.startswith("pose_mouth")]
    left = {point.replace("left_", "") for point in points if "left_" in point}
    assert left == {point.replace("right_", "") for point in points if "right_" in point}


def test_number_beyond_the_order_and_unknown_label_mean_nothing():
    order = read_orders()["coco_17"]
    assert order.point("17") is None and order.point("LElbow") is None and order.point("-1") is None


def test_templates_are_understood_by_shared_names_own_names_and_a_table():
    names = ["left_elbow", "forearm_r", "kp03", "tail"]
    assert points_of_template(names, {"kp03": "nose"}) == {
        "left_elbow": "left_elbow",
        "right_elbow": "forearm_r",
        "nose": "kp03",
    }


def test_of_two_detections_of_one_point_the_surer_stays():
    rows = [
        (0, "c", "0", 1.0, 1.0, 0.4),  # The body's nose,
        (0, "c", "4", 9.0, 9.0, 0.3),  # its right ear, which the template does not have,
        (0, "c", "0", 2.0, 2.0, 0.8),  # and SMPL-X's pelvis; 55 is its nose.
        (0, "c", "55", 3.0, 3.0, 0.9),
        (1, "c", "0", 4.0, 4.0, 0.4),
    ]
    table = pd.DataFrame(rows, columns=["frame", "camera", "keypoint", "x", "y", "confidence"])
    orders = ["coco_17", "coco_17", "smplx_144", "smplx_144", "coco_17"]
    found = as_template_keypoints(table, orders, {"nose": "snout", "mid_hip": "hips"})
    assert [(row.frame, row.keypoint, row.x) for row in found.itertuples()] == [
        (0, "hips", 2.0),
        (0, "snout", 3.0),
        (1, "snout", 4.0),
    ]


def test_irises_and_contours_are_kept_though_the_template_has_none():
    rows = [(0, "c", "96", 1.0, 2.0, 0.4), (0, "c", "96", 3.0, 2.0, 0.8), (0, "c", "60", 5.0, 6.0, 0.9)]
    table = pd.DataFrame(
        [*rows, (0, "c", "16", 0.0, 0.0, 1.0)], columns=["frame", "camera", "keypoint", "x", "y", "confidence"]
    )
    found = points_of_eyes(table, ["wflw_98"] * 4)
    assert list(zip(found.point, found.x, strict=True)) == [("face_36", 5.0), ("right_pupil", 3.0)]
    eyes = {name: {point for point in order.points if point in EYE_POINTS} for name, order in read_orders().items()}
    assert eyes["wflw_98"] == eyes["mediapipe_face_478"] == EYE_POINTS
    assert len(eyes["ibug_68"]) == len(eyes["flame_68"]) == len(eyes["smplx_144"]) == 12
