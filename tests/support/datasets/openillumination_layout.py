"""OpenIllumination objects in the exact layout of the set, with its traps.

One light at a time, numbered from 0, or patterns, numbered from 1, each in a calibration of its own: here y points down
in one world and z up in the other. Poses by camera's name in a dictionary, in OpenCV's or in Blender's axes, perhaps
with positions times four; angles of view of images of another width; masks of 0 and 1, and others with what the object
stands on; cameras without images, images without a pose, folders of images that are not undistorted.
"""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from tests.support.datasets.turning_head import TrueCamera, TurningHead, dome_of_lights, ring_of_cameras

OBJECT = "obj_01_egg"
OLAT, PATTERNS = "OLAT", "lighting_patterns"
CAMERAS = ["A1", "B2", "C5", "CA2", "D3", "D6"]
TEST_CAMERA = "C5"
BLIND_CAMERA, LOST_CAMERA = "A3", "B6"
"""One with a pose and no images, one with images and no pose."""

LIGHTS = 12
INTENSITY = 1.0
CALIBRATED_WIDTH = 3000
LIT_BY = {1: range(6), 2: range(6, 12), 4: (0, 3, 5, 8), 13: (1, 2, 4, 6, 7, 9, 10, 11)}
"""Lights of some of the patterns."""

WORLDS = {OLAT: np.diag([1.0, -1.0, -1.0]), PATTERNS: np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])}
"""The set's world from the truth's."""


def true_object(
    kind: str = OLAT, image: tuple[int, int] = (48, 72), names: Sequence[str] = tuple(CAMERAS)
) -> TurningHead:
    """The truth: pixels are square, principal points in the middle, and CA2's images are larger."""
    shown = {n: (n,) for n in range(LIGHTS)} if kind == OLAT else LIT_BY
    frames = {number: dict.fromkeys(lights, INTENSITY) for number, lights in shown.items()}
    ring = ring_of_cameras(list(names), image, arc=300)
    cameras = {name: _plain(camera, 1.25 if name == "CA2" else 1.0) for name, camera in ring.items()}
    return TurningHead(cameras, 1, dome_of_lights(LIGHTS, 1.0), frames, (min(frames),), still=True)


def _plain(camera: TrueCamera, larger: float) -> TrueCamera:
    width, height, f = round(larger * camera.width), round(larger * camera.height), larger * camera.K[0, 0]
    K = np.array([[f, 0, (width - 1) / 2], [0, f, (height - 1) / 2], [0, 0, 1]])
    return replace(camera, K=K, dist=np.zeros(5), width=width, height=height)


def write_openillumination(
    folder: Path, truth: TurningHead, kind: str = OLAT, axes: str = "opencv", times: float = 1.0
) -> Path:
    """Write one object below a folder; returns its own folder.

    Args:
        axes: opencv or blender.
        times: of the positions of cameras.
    """
    root = folder / kind / OBJECT
    for name in truth.cameras:
        # Machine vision cameras ship as .JPG here, the others as .png: the set has both.
        suffix = ".png" if name == "CA2" else ".JPG"
        for number in truth.frames:
            view = root / f"Lights/{number:03d}"
            _write(view / f"raw_undistorted/{name}{suffix}", encoded(truth.image(name, number), suffix))
            _write(view / f"raw/{name}{suffix}", b"distorted")
        mask = truth.labels(name, min(truth.frames), np.ones(len(truth.faces)))
        _write(root / f"output/obj_masks/{name}.png", cv2.imencode(".png", mask)[1].tobytes())
        support = np.where(mask > 0, 255, 0).astype(np.uint8)
        support[-8:] = 255
        _write(root / f"output/com_masks/{name}.png", cv2.imencode(".png", support)[1].tobytes())
    _write(root / f"Lights/{min(truth.frames):03d}/raw_undistorted/{LOST_CAMERA}.JPG", b"an image without a pose")
    poses = {name: pose(camera, kind, axes, times) for name, camera in truth.cameras.items()}
    blind = {BLIND_CAMERA: poses[CAMERAS[0]]}
    tested = {TEST_CAMERA: poses[TEST_CAMERA]}
    trained = {name: entry for name, entry in poses.items() if name != TEST_CAMERA}
    for split, entries in (("train", trained | blind), ("val", tested), ("test", tested)):
        _write(root / f"output/transforms_{split}.json", json.dumps({"frames": entries}).encode())
    # In the world of the single lights, whatever the kind.
    file = io.BytesIO()
    np.save(file, truth.lights_m @ WORLDS[OLAT].T)
    _write(folder / "light_pos.npy", file.getvalue())
    return root


def pose(camera: TrueCamera, kind: str, axes: str, times: float) -> dict:
    """A camera's entry in the files of poses."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = WORLDS[kind] @ camera.R.T, times * WORLDS[kind] @ (-camera.R.T @ camera.t)
    if axes == "blender":
        matrix = matrix @ np.diag([1.0, -1.0, -1.0, 1.0])
    angle = 2 * np.arctan(camera.width / 2 / camera.K[0, 0])
    # Nobody fills in light_idx, and file_path names folders that are not there.
    return {
        "file_path": "./images/x", "rotation": 0, "transform_matrix": matrix.tolist(), "camera_angle_x": float(angle),
        "calib_imgw": CALIBRATED_WIDTH, "light_idx": 0,
    }  # fmt: skip


def write_mesh(path: Path, truth: TurningHead, kind: str = OLAT, times: float = 1.0) -> Path:
    """A mesh of the object as a user has it: in the world of the cameras."""
    vertices = times * truth.vertices(min(truth.frames)) @ WORLDS[kind].T
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in truth.faces + 1]
    _write(path, "\n".join(lines).encode())
    return path


def write_light_table(path: Path, truth: TurningHead) -> Path:
    """The lights of the patterns as a user has found them out: in the world of the patterns' cameras."""
    lines = ["pattern,light,x,y,z,intensity"]
    for number, lights in truth.frames.items():
        for light, intensity in lights.items():
            x, y, z = (WORLDS[PATTERNS] @ truth.lights_m[light]).tolist()
            lines.append(f"{number},{light},{x!r},{y!r},{z!r},{intensity}")
    _write(path, ("\n".join(lines) + "\n").encode())
    return path


def encoded(linear: np.ndarray, suffix: str) -> bytes:
    """A file of linear light as 8-bit sRGB."""
    clipped = np.clip(linear, 0, 1)
    curve = np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1 / 2.4) - 0.055)
    file = io.BytesIO()
    kind = {"format": "PNG"} if suffix == ".png" else {"format": "JPEG", "quality": 97, "subsampling": 0}
    Image.fromarray(np.round(255 * curve).astype(np.uint8)).save(file, **kind)
    return file.getvalue()


def _write(path: Path, content: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
