"""A BecomingLit capture in the exact layout of the set, with its traps.

The world's y points down and its z away from the face; one K for all cameras, counted from the corner; a singular
`light_pattern`; durations of partially lit frames that are 0.66 times what they stand for; sRGB of colours before each
camera's matrix, over a black level that comes after it; frames that count from 0 in each sequence; sequences without a
subject; meshes of fully lit frames alone; landmarks as shares of the image's sides, some of which are no point of the
mesh but of its outline, another in each view.
"""

from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from tests.support.datasets.turning_head import TurningHead, dome_of_lights, ring_of_cameras

SUBJECT = "1001"
CAMERAS = ["220700191", "221501007", "222200036", "222200037", "222200038", "222200041"]
TEST_CAMERA = "222200037"
LIGHTS = 12
SEQUENCES = {"EXP-2": range(7), "FREE": range(9, 14)}
"""Frames of the truth in each; the files count from 0."""

EMPTY_SEQUENCES = ("BACKGROUND", "CALIB-1")
DURATION, DIMMED = 3000, 0.66
BLACK = 4 / 255
FACE, HAIR, CLOTH = 2, 14, 3
LANDMARKS, ON_OUTLINE = 98, range(33)
"""Landmarks of WFLW; the first are the outline of the face."""

TURN = np.diag([1.0, -1.0, -1.0])
"""The set's world from the truth's."""


def pattern_of(frame: int) -> int:
    """Number of the light pattern of a frame of the truth: every third fully lit, one light in the others."""
    return 0 if frame % 3 == 0 else 1 + frame % LIGHTS


def light_pattern(number: int) -> list[list[int]]:
    """The set's list of lights and durations."""
    return [[light, DURATION] for light in range(LIGHTS)] if number == 0 else [[number - 1, 9 * DURATION + number]]


def intensity(number: int, duration: int) -> float:
    """Radiant intensity of a light that is on for so long in a frame of that pattern."""
    return duration / DURATION if number == 0 else duration / DURATION / DIMMED


def true_head(image: tuple[int, int] = (48, 72)) -> TurningHead:
    """The truth; images are as large as the sensor, and no lens distorts."""
    numbers = [frame for span in SEQUENCES.values() for frame in span]
    frames = {n: {light: intensity(pattern_of(n), d) for light, d in light_pattern(pattern_of(n))} for n in numbers}
    ring = ring_of_cameras(CAMERAS, image)
    shared = next(iter(ring.values())).K
    cameras = {name: replace(camera, K=shared, dist=np.zeros(5)) for name, camera in ring.items()}
    return TurningHead(cameras, 1, dome_of_lights(LIGHTS), frames, tuple(n for n in numbers if pattern_of(n) == 0))


def matrix_of(name: str) -> np.ndarray:
    """Colour matrix of a camera."""
    k = CAMERAS.index(name)
    return np.array([[1.3 + 0.02 * k, -0.2, 0.05], [-0.1, 1.2, -0.05 - 0.01 * k], [0.02, -0.15, 1.25]])


def write_becominglit(folder: Path, truth: TurningHead) -> Path:
    """Write the capture below a folder, with what the set's preprocessing makes; returns its own folder."""
    root = folder / SUBJECT
    (root / "calibration").mkdir(parents=True)
    _write_calibration(root / "calibration", truth)
    for name, span in SEQUENCES.items():
        sequence = root / "sequences" / name
        for camera in CAMERAS:
            for frame in span:
                here = frame - span[0]
                image = stored(truth.image(camera, frame), matrix_of(camera))
                _write(sequence / f"images/cam_{camera}/frame_{here:06d}.avif", avif(image))
                labels = part_labels(truth, camera, frame)
                _write(sequence / f"facer_segmentation/cam_{camera}/frame_{here:06d}.png", encoded(".png", labels))
                alpha = np.where(labels > 0, 255, 0).astype(np.uint8)
                _write(sequence / f"alpha_birefnet/cam_{camera}/frame_{here:06d}.jpg", encoded(".jpg", alpha))
        per_frame = [[frame - span[0], pattern_of(frame)] for frame in span]
        _write(sequence / "light_pattern_per_frame.json", json.dumps(per_frame).encode())
        for camera in CAMERAS:
            write_landmarks(sequence / f"landmark2d/PIPnet/cam_{camera}.npz", truth, camera, span)
        for frame in span:
            if pattern_of(frame) == 0:
                mesh = ply(truth.vertices(frame) @ TURN.T, truth.faces)
                _write(sequence / f"flame_tracking/meshes_posed/frame_{frame - span[0]:06d}.ply", mesh)
    for name in EMPTY_SEQUENCES:
        _write(root / f"sequences/{name}/light_pattern_per_frame.json", b"[[0, 0]]")
    return root


def marked_vertices(truth: TurningHead) -> np.ndarray:
    """The vertex of each landmark, all in front; those of the outline have none that is theirs."""
    front = np.argsort(-truth.in_head(0)[:, 2])
    return front[np.arange(LANDMARKS) % 50]


def write_landmarks(path: Path, truth: TurningHead, camera: str, span: range) -> None:
    """Landmarks of the fully lit frames, 98 x 2 of 0 to 1, by the frame's number in its sequence."""
    width, height = truth.image_size(camera)
    found = {}
    for frame in span:
        if pattern_of(frame) == 0:
            # Pixels count from the corner here.
            pixels = truth.cameras[camera].project(truth.vertices(frame)) + 0.5
            points = pixels[marked_vertices(truth)]
            around = np.linspace(0, np.pi, len(ON_OUTLINE))
            reach = (pixels.max(0) - pixels.min(0)) / 2
            points[: len(ON_OUTLINE)] = pixels.mean(0) + reach * np.stack([np.cos(around), np.sin(around)], 1)
            found[str(frame - span[0])] = points / [width, height]
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez(path, **found)


def stored(linear: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Counts whose sRGB, decoded and multiplied by the matrix, is the light and the black level."""
    raw = np.clip((linear + BLACK) @ np.linalg.inv(matrix).T, 0, 1)
    curve = np.where(raw <= 0.0031308, 12.92 * raw, 1.055 * raw ** (1 / 2.4) - 0.055)
    return np.round(255 * curve).astype(np.uint8)


def part_labels(truth: TurningHead, name: str, frame: int) -> np.ndarray:
    """Part labels of an image: hair, face, and clothes below them."""
    labels = truth.labels(name, frame, np.where(truth.hair, HAIR, FACE))
    labels[-4:][labels[-4:] == 0] = CLOTH
    return labels


def avif(rgb: np.ndarray) -> bytes:
    """An AVIF file."""
    file = io.BytesIO()
    Image.fromarray(rgb).save(file, "AVIF", quality=90, subsampling="4:4:4")
    return file.getvalue()


def encoded(suffix: str, pixels: np.ndarray) -> bytes:
    """A file of one channel."""
    return cv2.imencode(suffix, pixels)[1].tobytes()


def ply(vertices: np.ndarray, faces: np.ndarray) -> bytes:
    """A binary .ply of vertices and triangles, as trimesh writes them."""
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz")
    head += f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    rows = np.zeros(len(faces), [("count", "u1"), ("corners", "<i4", 3)])
    rows["count"], rows["corners"] = 3, faces
    return head.encode() + vertices.astype("<f4").tobytes() + rows.tobytes()


def _write(path: Path, content: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)


def _write_calibration(folder: Path, truth: TurningHead) -> None:
    K = truth.cameras[CAMERAS[0]].K
    poses = {}
    for name, camera in truth.cameras.items():
        pose = np.eye(4)
        # camera = R x + t with x = TURN^T x_set.
        pose[:3, :3], pose[:3, 3] = camera.R @ TURN.T, camera.t
        poses[name] = pose.tolist()
    shared = {"fx": K[0, 0], "fy": K[1, 1], "cx": K[0, 2] + 0.5, "cy": K[1, 2] + 0.5}
    content = {"cam_data": shared, "world_to_cam": poses}
    (folder / "camera_calibration.json").write_text(json.dumps(content))
    colors = {name: matrix_of(name).tolist() for name in CAMERAS}
    (folder / "color_calibration.json").write_text(json.dumps(colors))
    patterns = [{"light_index_durations": light_pattern(number)} for number in range(LIGHTS + 1)]
    content = {"light_positions": (truth.lights_m @ TURN.T).tolist(), "light_pattern": patterns}
    (folder / "light_pattern_metadata.json").write_text(json.dumps(content))
