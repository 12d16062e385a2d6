"""An ActorsHQ sequence in the exact layout of the set, with its traps.

Cameras are world-from-camera by axis and angle, in a world whose z points up; lenses are shares of the image's size;
images lie and stand; cameras are named from 001 while the authors' lists count from 0; nothing says where light is
from; the meshes of the set have other vertices in each frame, so that tracked ones lie elsewhere.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from tests.support.datasets.turning_head import TurningHead, dome_of_lights, ring_of_cameras

SCALE = "4x"
CAMERAS = ["Cam002", "Cam003", "Cam014", "Cam020", "Cam021"]
"""Of the authors' lists, which count from 0, the third is a camera for testing and the fourth for validation."""

TEST_CAMERA, VALIDATION_CAMERA, UNUSED_CAMERA = "Cam014", "Cam020", "Cam129"
LYING = "Cam003"
FRAMES = range(15, 25)
MESH_EVERY = 3
LIGHTS, INTENSITY = 24, 0.3
TURN = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""The set's world, z up, from the truth's."""


def true_head(image: tuple[int, int] = (36, 48)) -> TurningHead:
    """The truth, whose images are as large as the sensor, free of distortion; one lies."""
    ring = ring_of_cameras([*CAMERAS, UNUSED_CAMERA], image)
    cameras = {name: replace(camera, dist=np.zeros(5)) for name, camera in ring.items()}
    width, height = image
    K = cameras[LYING].K.copy()
    K[:2, 2] += [(height - width) / 2, (width - height) / 2]
    K[:2, :2] *= width / height
    cameras[LYING] = replace(cameras[LYING], K=K, width=height, height=width)
    lit = dict.fromkeys(range(LIGHTS), INTENSITY)
    return TurningHead(cameras, 1, dome_of_lights(LIGHTS), dict.fromkeys(FRAMES, lit), (*FRAMES[::MESH_EVERY],))


def write_actorshq(folder: Path, truth: TurningHead) -> Path:
    """Write the sequence below a folder; returns the folder of its scale."""
    sequence = folder / "Actor01/Sequence1"
    root = sequence / SCALE
    for name in truth.cameras:
        for number in FRAMES:
            image = cv2.imencode(".jpg", stored(truth.image(name, number))[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 97])[
                1
            ]
            _write(root / f"rgbs/{name}/{name}_rgb{number:06d}.jpg", image.tobytes())
            mask = truth.labels(name, number, np.full(len(truth.faces), 255))
            _write(root / f"masks/{name}/{name}_mask{number:06d}.png", cv2.imencode(".png", mask)[1].tobytes())
    _write(root / "calibration.csv", calibration(truth).encode())
    _write(root / "light_annotations.csv", b"name, x, y\n")
    _write(sequence / "meshes.abc", b"Ogawa")
    _write(sequence / "scene.json", b'{"num_frames": 10}')
    return root


def calibration(truth: TurningHead) -> str:
    """The table of cameras."""
    lines = ["name,w,h,rx,ry,rz,tx,ty,tz,fx,fy,px,py"]
    for name, camera in truth.cameras.items():
        axis_angle = cv2.Rodrigues(TURN @ camera.R.T)[0].ravel()
        place = TURN @ (-camera.R.T @ camera.t)
        K, size = camera.K, (camera.width, camera.height)
        lens = [K[0, 0] / size[0], K[1, 1] / size[1], (K[0, 2] + 0.5) / size[0], (K[1, 2] + 0.5) / size[1]]
        numbers = [*(float(value) for value in (*axis_angle, *place, *lens))]
        lines.append(",".join([name, *map(str, size), *map(repr, numbers)]))
    return "\n".join(lines) + "\n"


def write_meshes(folder: Path, truth: TurningHead) -> Path:
    """Write tracked meshes of some frames, in the set's world, as another program would; returns their folder."""
    place = folder / "tracked"
    for frame in truth.keyed:
        lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in (truth.vertices(frame) @ TURN.T).tolist()]
        lines += [f"f {a} {b} {c}" for a, b, c in truth.faces + 1]
        _write(place / f"Frame{frame:06d}.obj", "\n".join(lines).encode())
    return place


def settings(folder: Path, truth: TurningHead) -> str:
    """Settings of import_capture as YAML; writes the meshes that they name."""
    return f"{{mesh: {write_meshes(folder, truth)}}}"


def stored(linear: np.ndarray) -> np.ndarray:
    """Counts of linear light, sRGB."""
    clipped = np.clip(linear, 0, 1)
    curve = np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1 / 2.4) - 0.055)
    return np.round(255 * curve).astype(np.uint8)


def _write(path: Path, content: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
