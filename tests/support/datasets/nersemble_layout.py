"""A NeRSemble v2 participant in the exact layout of the set, with its traps.

Images are frames of one video per camera and sequence; one K for all cameras, of images of 2200 x 3208 pixels, counted
from the corner, while the videos are smaller; camera-from-world of OpenCV's axes in a world whose z points up; colours
of each camera by a polynomial of linear light, stored in sRGB; frames that count from 0 in each sequence; a video that
ends a frame early; a sequence without a subject, which has images in place of videos; neither meshes nor masks, though
the set's benchmark has videos of masks.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from tests.support.datasets.turning_head import TurningHead, dome_of_lights, ring_of_cameras

PARTICIPANT = "240"
CAMERAS = ["220700191", "221501007", "222200036", "222200037", "222200041"]
TEST_CAMERA = "222200037"
CALIBRATED_ALONE = "222200049"
"""Of the calibration; it has no video."""

SEQUENCES = {"EXP-2-eyes": range(7), "FREE": range(9, 14)}
"""Frames of the truth in each; the files count from 0."""

TEST_SEQUENCE = "FREE"
SHORT = ("FREE", "221501007")
"""Sequence and camera whose video lacks the last frame."""

MESH_EVERY = 3
FPS = 24.0
LIGHTS, INTENSITY = 24, 0.3
CALIBRATED = np.array([2200, 3208])
TURN = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""The set's world, z up, from the truth's."""


def true_head(image: tuple[int, int] = (48, 70)) -> TurningHead:
    """The truth; images are as large as the sensor, no lens distorts, and all have one K."""
    numbers = [frame for span in SEQUENCES.values() for frame in span]
    ring = ring_of_cameras([*CAMERAS, CALIBRATED_ALONE], image)
    shared = next(iter(ring.values())).K
    cameras = {name: replace(camera, K=shared, dist=np.zeros(5)) for name, camera in ring.items()}
    lit = dict.fromkeys(range(LIGHTS), INTENSITY)
    keyed = tuple(frame for span in SEQUENCES.values() for frame in span[::MESH_EVERY])
    return TurningHead(cameras, 1, dome_of_lights(LIGHTS), dict.fromkeys(numbers, lit), keyed)


def polynomial_of(name: str) -> np.ndarray:
    """Polynomial of a camera's colours: r g b, rg rb gb, rr gg bb, rgb, 1 of linear light as recorded."""
    k = [*CAMERAS, CALIBRATED_ALONE].index(name)
    linear = np.array([[1.2 + 0.02 * k, -0.15, 0.04], [-0.08, 1.15, -0.05], [0.02, -0.1 - 0.01 * k, 1.25]])
    bent = np.array([[0.03, -0.02, 0.01, 0.05, -0.01, 0.02, 0.02, 0.002]])
    return np.concatenate([linear, np.concatenate([bent, -bent, 0.5 * bent])], axis=1)


def expanded(raw: np.ndarray) -> np.ndarray:
    """The eleven products of channels that a polynomial weighs."""
    r, g, b = np.moveaxis(raw, -1, 0)
    return np.stack([r, g, b, r * g, r * b, g * b, r**2, g**2, b**2, r * g * b, np.ones_like(r)], -1)


def raw_of(linear: np.ndarray, polynomial: np.ndarray) -> np.ndarray:
    """Recorded light whose polynomial is `linear`, by fixed-point iteration: its bent part is small."""
    raw, inverse = linear @ np.linalg.inv(polynomial[:, :3]).T, np.linalg.inv(polynomial[:, :3])
    for _ in range(30):
        raw = (linear - expanded(raw)[..., 3:] @ polynomial[:, 3:].T) @ inverse.T
    return raw


def write_nersemble(folder: Path, truth: TurningHead, masks: bool = True) -> Path:
    """Write the participant below a folder, with the benchmark's masks or without; returns their own folder."""
    root = folder / PARTICIPANT
    (root / "calibration").mkdir(parents=True)
    _write_calibration(root / "calibration", truth)
    for name, span in SEQUENCES.items():
        for camera in CAMERAS:
            frames = span[:-1] if (name, camera) == SHORT else span
            images = [stored(truth.image(camera, frame), polynomial_of(camera)) for frame in frames]
            write_video(root / f"sequences/{name}/images/cam_{camera}.mp4", images)
            if masks:
                labels = [truth.labels(camera, frame, np.full(len(truth.faces), 255)) for frame in frames]
                write_video(root / f"sequences/{name}/alpha_maps/cam_{camera}.mp4", [_gray(each) for each in labels])
    empty = root / "sequences/BACKGROUND"
    empty.mkdir()
    for camera in CAMERAS:
        width, height = truth.image_size(camera)
        cv2.imwrite(str(empty / f"image_{camera}.jpg"), np.zeros((height, width, 3), np.uint8))
    return root


def write_meshes(folder: Path, truth: TurningHead) -> Path:
    """Write tracked meshes of some frames, in the set's world, as another program would; returns their folder."""
    place = folder / "tracked"
    for name, span in SEQUENCES.items():
        (place / name).mkdir(parents=True)
        for frame in span[::MESH_EVERY]:
            lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in (truth.vertices(frame) @ TURN.T).tolist()]
            lines += [f"f {a} {b} {c}" for a, b, c in truth.faces + 1]
            (place / name / f"{frame - span[0]:06d}.obj").write_text("\n".join(lines))
    return place


def settings(folder: Path, truth: TurningHead) -> str:
    """Settings of import_capture as YAML; writes the meshes that they name."""
    return f"{{mesh: {write_meshes(folder, truth)}}}"


def stored(linear: np.ndarray, polynomial: np.ndarray) -> np.ndarray:
    """Counts whose sRGB, decoded and put into the polynomial, is the light."""
    raw = np.clip(raw_of(linear.astype(np.float64), polynomial), 0, 1)
    curve = np.where(raw <= 0.0031308, 12.92 * raw, 1.055 * raw ** (1 / 2.4) - 0.055)
    return np.round(255 * curve).astype(np.uint8)


def write_video(path: Path, images: list[np.ndarray]) -> None:
    """Write R, G, B images as an .mp4."""
    path.parent.mkdir(parents=True, exist_ok=True)
    height, width = images[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter_fourcc(*"vp09"), FPS, (width, height))
    for image in images:
        writer.write(np.ascontiguousarray(image[..., ::-1]))
    writer.release()


def _gray(labels: np.ndarray) -> np.ndarray:
    return np.repeat(labels[..., None], 3, axis=2)


def _write_calibration(folder: Path, truth: TurningHead) -> None:
    poses = {}
    for name, camera in truth.cameras.items():
        pose = np.eye(4)
        # camera = R x + t with x = TURN^T x_set.
        pose[:3, :3], pose[:3, 3] = camera.R @ TURN.T, camera.t
        poses[name] = pose.tolist()
    K = truth.cameras[CAMERAS[0]].K.copy()
    K[:2, 2] += 0.5
    K[:2] *= (CALIBRATED / np.array(truth.image_size(CAMERAS[0])))[:, None]
    (folder / "camera_params.json").write_text(json.dumps({"world_2_cam": poses, "intrinsics": K.tolist()}))
    colors = {name: polynomial_of(name).tolist() for name in truth.cameras}
    (folder / "color_calibration.json").write_text(json.dumps(colors))
