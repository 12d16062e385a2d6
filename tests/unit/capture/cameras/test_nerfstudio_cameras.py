"""Cameras of nerfstudio's transforms against its published convention."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest

from tests.support.rigs.camera_files import (
    CENTERS,
    POINTS,
    SAME_PX,
    looking_at_the_stage,
    read,
)

INTRINSICS = {"fl_x": 500.0, "fl_y": 510.0, "cx": 310.0, "cy": 250.0, "w": 640, "h": 480}


def opengl_pose(center):
    """World-from-camera, columns right, up, backward, centre."""
    right, down, forward = looking_at_the_stage(center)
    pose = np.eye(4)
    pose[:3] = np.stack([right, -down, -forward, center], 1)
    return pose


def transforms(change=None, **keys):
    """A transforms.json of both cameras."""
    frames = [
        {"file_path": f"./images/{name}/00001.png", "transform_matrix": opengl_pose(center).tolist()}
        for name, center in CENTERS.items()
    ]
    content = {"camera_model": "OPENCV", **INTRINSICS, **keys, "frames": frames}
    if change:
        change(content)
    return content


def read_transforms(folder, content, **keys):
    (folder / "transforms.json").write_text(json.dumps(content))
    return read(folder, format="nerfstudio", path="transforms.json", **keys)


def projected(center, points=POINTS):
    """By the convention: x right, y up, z backward; pixels right and down from the corner of the image."""
    pose = opengl_pose(center)
    x, y, z = pose[:3, :3].T @ (points - pose[:3, 3]).T
    return np.stack([310 + 500 * x / -z, 250 - 510 * y / -z], 1)


NERFSTUDIO_BREAKS = {
    "panorama": (lambda c: c.update(camera_model="EQUIRECTANGULAR"), ["found EQUIRECTANGULAR; undistort"]),
    "fisheye with tangential terms": (
        lambda c: c.update(camera_model="OPENCV_FISHEYE", p1=0.1),
        ["expected k1, k2, k3 and k4 only, found p1 of 0.1"],
    ),
    "another fisheye": (lambda c: c.update(is_fisheye=True), ["camera_model: expected one of SIMPLE_PINHOLE"]),
    "k4": (lambda c: c.update(k4=0.1), ["expected k1, k2, p1, p2 and k3 only, found k4 of 0.1"]),
    "no focal length": (lambda c: c.pop("fl_y"), ["fl_y: expected a finite number, found none"]),
    "angle": (
        lambda c: (c.pop("fl_x"), c.update(camera_angle_x=1.2)),
        ["only camera_angle_x; give fl_x = w / (2 tan(camera_angle_x / 2))"],
    ),
    "twice": (
        lambda c: c["frames"][0].update(cx=311.0),
        ["cam00/00001.png: expected a value for this frame or one for all frames, found cx of 311.0 and of 310.0"],
    ),
    "half a pose": (
        lambda c: c["frames"][1]["transform_matrix"].pop(),
        ["frame ./images/cam01/00001.png: transform_matrix: expected 4 x 4 finite numbers"],
    ),
    "mirrored": (
        lambda c: [row.__setitem__(0, -row[0]) for row in c["frames"][0]["transform_matrix"]],
        ["cam00: image ./images/cam00/00001.png: R: expected a rotation", "found a mirrored one"],
    ),
    "scaled": (
        lambda c: c.update(applied_transform=np.diag([2.0, 2, 2, 1])[:3].tolist()),
        ["cam00: image ./images/cam00/00001.png: R: expected a rotation", "rows off by 0.75"],
    ),
    "applied nothing": (lambda c: c.update(applied_scale=0), ["expected what can be undone, found a scale of 0"]),
    "no name": (lambda c: c["frames"][0].pop("file_path"), ["frames[0]: file_path: expected text, found None"]),
    "frames by name": (lambda c: c.update(frames={"a": {}}), ["frames: expected a list of sections"]),
    "other size": (lambda c: c.update(w=641), ["width x height: expected the sensor's 640 x 480, found 641 x 480"]),
    "half pixel": (lambda c: c.update(w=640.5), ["w, h: expected whole numbers of pixels, found 640.5"]),
    "all at once": (
        lambda c: (c["frames"][0].update(cx="wide"), c.pop("cx"), c["frames"][1].update(cx=1.0, k5=2.0)),
        ["cam00/00001.png: cx: expected a finite number, found wide", "cam01/00001.png: distortion: expected k1"],
    ),
}  # fmt: skip


class TestNerfstudio:
    def test_projections_are_the_conventions(self, tmp_path):
        cameras, complaints = read_transforms(tmp_path, transforms())
        assert not complaints
        for name, center in CENTERS.items():
            pixels, depth = cameras[name].project(POINTS)
            assert (depth > 0).all()
            assert np.abs(pixels - projected(center)).max() < SAME_PX

    def test_distortion_is_opencvs(self, tmp_path):
        terms = {"k1": -0.12, "k2": 0.05, "p1": 0.002, "p2": -0.003, "k3": 0.01}
        cameras, complaints = read_transforms(tmp_path, transforms(**terms))
        assert not complaints
        for name, center in CENTERS.items():
            ideal = (projected(center) - [310, 250]) / [500, 510]
            K = np.array([[500.0, 0, 309.5], [0, 510, 249.5], [0, 0, 1]])
            points = np.concatenate([ideal, np.ones((50, 1))], 1)
            expected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), K, np.array([*terms.values()]))
            assert np.abs(cameras[name].project(POINTS)[0] - expected[:, 0] - 0.5).max() < SAME_PX

    def test_fisheye_is_opencvs(self, tmp_path):
        terms = {"k1": -0.03, "k2": 0.012, "k3": -0.005, "k4": 0.0007}
        cameras, complaints = read_transforms(tmp_path, transforms(camera_model="OPENCV_FISHEYE", **terms))
        assert not complaints
        for name, center in CENTERS.items():
            pose = opengl_pose(center)
            in_camera = (POINTS - pose[:3, 3]) @ pose[:3, :3] * [1, -1, -1]
            K = np.array([[500.0, 0, 309.5], [0, 510, 249.5], [0, 0, 1]])
            expected, _ = cv2.fisheye.projectPoints(
                in_camera[:, None], np.zeros(3), np.zeros(3), K, np.array([*terms.values()])
            )
            assert np.abs(cameras[name].project(POINTS)[0] - expected[:, 0] - 0.5).max() < SAME_PX

    def test_intrinsics_of_each_frame(self, tmp_path):
        def move(content):
            for key in INTRINSICS:
                value = content.pop(key)
                for frame in content["frames"]:
                    frame[key] = value

        cameras, complaints = read_transforms(tmp_path, transforms(move))
        assert not complaints
        assert np.abs(cameras["cam01"].project(POINTS)[0] - projected(CENTERS["cam01"])).max() < SAME_PX

    def test_applied_transform_and_scale_are_undone(self, tmp_path):
        """As ns-process-data applies them: axes swapped, moved, then scaled."""
        applied = np.array([[1.0, 0, 0, 0.2], [0, 0, 1, -0.4], [0, -1, 0, 1.1]])

        def apply(content):
            for frame in content["frames"]:
                pose = np.array(frame["transform_matrix"])
                pose[:3] = applied @ pose
                pose[:3, 3] *= 0.25
                frame["transform_matrix"] = pose.tolist()

        content = transforms(apply, applied_transform=applied.tolist(), applied_scale=0.25)
        cameras, complaints = read_transforms(tmp_path, content)
        assert not complaints
        for name, center in CENTERS.items():
            assert np.abs(cameras[name].project(POINTS)[0] - projected(center)).max() < SAME_PX
            assert cameras[name].center == pytest.approx(center)

    def test_a_file_in_centimetres(self, tmp_path):
        def apply(content):
            for frame in content["frames"]:
                for row in frame["transform_matrix"][:3]:
                    row[3] *= 100

        cameras, complaints = read_transforms(tmp_path, transforms(apply), scale_to_m=0.01)
        assert not complaints
        for name, center in CENTERS.items():
            assert np.abs(cameras[name].project(POINTS)[0] - projected(center)).max() < SAME_PX

    @pytest.mark.parametrize("name", NERFSTUDIO_BREAKS)
    def test_what_is_wrong_is_named(self, tmp_path, name):
        change, words = NERFSTUDIO_BREAKS[name]
        _, complaints = read_transforms(tmp_path, transforms(change))
        for text in words:
            assert text in complaints
        assert all(line.startswith("transforms.json: ") for line in complaints.splitlines())
