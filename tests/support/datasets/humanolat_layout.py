"""A HumanOLAT capture in the exact layout of the set, with its traps, in either direction of its cameras.

Lights in metres and a model and cameras in millimetres; intrinsics over the image's width, p1 and p2 exchanged; lights
that fire in an order of their own, in images that skip 34, 55, ...; images before 14 that show white
light and environments, and nothing says how bright each light was in these; a dome whose centre is not the origin.
"""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from tests.support.datasets.turning_head import TurningHead, dome_of_lights, environment, ring_of_cameras

SUBJECT, POSE, CAPTURE = "SUBJECT_C001", "POSE_01", "capture"
CAMERAS = [f"Cam{number:02d}" for number in range(1, 6)]
TEST_CAMERA = "Cam01"
LIGHTS = 20
ORDER = [(7 * k + 3) % LIGHTS for k in range(LIGHTS)]
"""Lights in the order in which they fire."""

FULL, WHITE = 14, 0
ENVIRONMENTS = {3: (1.0, 0.5, 0.6), 13: (-0.7, 0.2, 1.0)}
"""Images under environments, and the direction of their lamp."""

FULL_INTENSITY = 1.0
SKIPPED = range(34, 362, 21)


def images_of_lights() -> dict[int, int]:
    """Image -> light."""
    numbers = [number for number in range(FULL + 1, FULL + 1 + 2 * LIGHTS) if number not in SKIPPED]
    return dict(zip(numbers, ORDER, strict=False))


def true_head(image: tuple[int, int] = (48, 72)) -> TurningHead:
    """The truth: a still head, images as large as the sensor and free of distortion."""
    frames = {FULL: dict.fromkeys(range(LIGHTS), FULL_INTENSITY)}
    frames |= {number: {light: FULL_INTENSITY} for number, light in images_of_lights().items()}
    lights_m = dome_of_lights(LIGHTS)
    frames |= {number: environment(lights_m, lamp) for number, lamp in ENVIRONMENTS.items()}
    cameras = {name: replace(c, dist=np.zeros(5)) for name, c in ring_of_cameras(CAMERAS, image).items()}
    return TurningHead(cameras, 1, lights_m, frames, (FULL,), still=True)


def write_humanolat(folder: Path, truth: TurningHead, direction: str = "camera-from-world") -> Path:
    """Write the capture below a folder; returns that of its pose."""
    root, shared = folder / SUBJECT / POSE, folder / SUBJECT / POSE / "shared"
    for name in CAMERAS:
        for number in [WHITE, *truth.frames, SKIPPED[0]]:
            shown = truth.image(name, number if number in truth.frames else FULL)
            _write(root / f"images_processed/{name}/{CAPTURE}.{number:06d}.avif", avif(srgb(shown)))
        mask = truth.labels(name, FULL, np.full(len(truth.faces), 255))
        _write(root / f"segmentations/masks/000/{name}.png", cv2.imencode(".png", mask)[1].tobytes())
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in (1000 * truth.vertices(FULL)).tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in truth.faces + 1]
    _write(root / "model/model.obj", "\n".join(lines).encode())
    _write(shared / "cameras.calib", calibration(truth, direction).encode())
    points = [f"v {x!r} {y!r} {z!r}" for x, y, z in truth.lights_m.tolist()]
    _write(shared / "LSX_light_positions_aligned.pc", ("\n".join(points) + "\n").encode())
    _write(shared / "LSX3_light_z_spiral.txt", ("\n".join(str(light + 1) for light in ORDER) + "\n").encode())
    return root


def calibration(truth: TurningHead, direction: str) -> str:
    """cameras.calib, its extrinsics in one of the directions; origin, up and right are always right."""
    lines = ["tc camera calibration v0.3"]
    for number, camera in enumerate(truth.cameras.values()):
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = camera.R, 1000 * camera.t
        if direction != "camera-from-world":
            T = np.linalg.inv(T)
        K = camera.K.copy()
        K[:2, 2] += 0.5
        K[:2] /= camera.width
        place = -1000 * camera.R.T @ camera.t
        lines += [
            f"camera\t{number}\tCamera_{number + 1}", "color\t1 0 0", "frame\t0",
            f"sensorSize\t{camera.width} {camera.height}", f"focalLength\t{camera.K[0, 0]}", "pixelAspect\t1",
            "centerOffset\t0 0", "distortionModel\tOpenCV", "distortion\t0.01 0.002 0.0003 0.0001 0",
            "origin\t" + _row(place), "up\t" + _row(-camera.R[1]), "right\t" + _row(camera.R[0]),
            "# extrinsics", *("# " + _row(row) for row in T[:3]), "# intrinsics", *("# " + _row(row) for row in K),
        ]  # fmt: skip
    return "\n".join(lines) + "\n"


def _row(values: np.ndarray) -> str:
    return " ".join(repr(float(value)) for value in values)


def srgb(linear: np.ndarray) -> np.ndarray:
    """Counts of linear light."""
    clipped = np.clip(linear, 0, 1)
    return np.round(255 * np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1 / 2.4) - 0.055)).astype(
        np.uint8
    )


def avif(rgb: np.ndarray) -> bytes:
    """An AVIF file."""
    file = io.BytesIO()
    Image.fromarray(rgb).save(file, "AVIF", quality=90, subsampling="4:4:4")
    return file.getvalue()


def _write(path: Path, content: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
