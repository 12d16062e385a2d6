"""OLATverse objects in the exact layout of the set, with its traps.

Cameras and model in millimetres, lights in metres, or all in metres; poses world-from-camera, in Blender's axes or in
OpenCV's; lights that repeat; images before 14 that show environments and white light, and 34, 55, ... of full light;
polarised cameras; a camera without images; images twice as bright; objects without a model and without a split.
"""

from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from tests.support.datasets.turning_head import TrueCamera, TurningHead, dome_of_lights, environment, ring_of_cameras

OBJECT, CAPTURE = "data-040325-C091", "C091"
CAMERAS = ["Cam01", "Cam03", "Cam05", "Cam20", "Cam27"]
POLARISED, BLIND_CAMERA = "Cam07", "Cam40"
BENCHMARK_TEST_CAMERA = "Cam27"
"""The one that the object's own files test."""

LIGHTS = 20
FULL, WHITE = 14, 0
ENVIRONMENTS = {5: (0.8, 0.6, 0.7)}
"""Images under environments, and the direction of their lamp."""

SKIPPED = range(34, 363, 21)
REPEATED = 4
INTENSITY, BRIGHTER = 0.5, 2.0
MILLIMETRES, METRES = 1000.0, 1.0


def images_of_lights() -> dict[int, int]:
    """Image -> light: they fire in their order."""
    numbers = [number for number in range(FULL + 1, FULL + 1 + 2 * LIGHTS) if number not in SKIPPED]
    return dict(zip(numbers, range(LIGHTS), strict=False))


def true_object(image: tuple[int, int] = (48, 72)) -> TurningHead:
    """The truth: an object that stands still; one camera looks through a polariser."""
    frames = {FULL: dict.fromkeys(range(LIGHTS), INTENSITY)}
    frames |= {number: {light: INTENSITY} for number, light in images_of_lights().items()}
    lights_m = dome_of_lights(LIGHTS)
    for number, lamp in ENVIRONMENTS.items():
        frames[number] = {light: INTENSITY * weight for light, weight in environment(lights_m, lamp).items()}
    ring = ring_of_cameras([*CAMERAS, POLARISED, BLIND_CAMERA], image, arc=300)
    cameras = {name: replace(camera, dist=np.zeros(5)) for name, camera in ring.items()}
    return TurningHead(cameras, 1, lights_m, frames, (FULL,), still=True)


def write_olatverse(
    folder: Path, truth: TurningHead, axes: str = "blender", unit: float = MILLIMETRES, validation: bool = True
) -> Path:
    """Write one object and the shared lights below a folder; returns the object's folder.

    Args:
        axes: blender or opencv.
        unit: of cameras and model, per metre.
        validation: True for an object with a model and a split.
    """
    root = folder / OBJECT
    for name in [*CAMERAS, POLARISED]:
        for number in [WHITE, *truth.frames, SKIPPED[0]]:
            shown = truth.image(name, number if number in truth.frames else FULL)
            darker = 0.4 if name == POLARISED else 1.0
            _write(root / f"masked_olat/{name}/{CAPTURE}.{number:06d}.avif", avif(BRIGHTER * darker * shown))
        mask = truth.labels(name, FULL, np.full(len(truth.faces), 255))
        _write(root / f"mask/{name}.png", cv2.imencode(".png", mask)[1].tobytes())
        _write(root / f"pbr/{name}_diff.png", b"albedo")
    cameras = [camera_entry(name, camera, axes, unit) for name, camera in truth.cameras.items()]
    _write_json(root / "all_cam.json", {"frames": cameras})
    if validation:
        lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in (unit * truth.vertices(FULL)).tolist()]
        lines += [f"f {a} {b} {c}" for a, b, c in truth.faces + 1]
        _write(root / "model/model.obj", "\n".join(lines).encode())
        write_splits(root, truth, cameras)
    lights = [light_entry(truth, number, light) for number, light in images_of_lights().items()]
    _write_json(folder / "shared/all_lights.json", {"frames": [*lights, *lights[:REPEATED]]})
    return root


def camera_entry(name: str, camera: TrueCamera, axes: str, unit: float) -> dict:
    """A camera in all_cam.json; intrinsics are cx, cy, fx, fy, counted from the image's corner."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = camera.R.T, -unit * camera.R.T @ camera.t
    if axes == "blender":
        matrix = matrix @ np.diag([1.0, -1.0, -1.0, 1.0])
    K = camera.K
    lens = [K[0, 2] + 0.5, K[1, 2] + 0.5, K[0, 0], K[1, 1]]
    return {"cam_idx": name, "transform_matrix": matrix.tolist(), "camera_intrinsics": [float(each) for each in lens]}


def light_entry(truth: TurningHead, number: int, light: int, capture: str = "obj_id") -> dict:
    """A light in all_lights.json."""
    place = truth.lights_m[light].tolist()
    return {
        "file_path": f"{capture}.{number:06d}", "light_idx": light, "pl_intensity": [1.0, 1.0, 1.0], "pl_pos": place
    }  # fmt: skip


def write_splits(root: Path, truth: TurningHead, cameras: list[dict]) -> None:
    """The files of the benchmark: every third light trains, the next tests."""
    lit = list(images_of_lights().items())
    trained = [each for each in cameras if each["cam_idx"] in CAMERAS and each["cam_idx"] != BENCHMARK_TEST_CAMERA]
    tested = [each for each in cameras if each["cam_idx"] == BENCHMARK_TEST_CAMERA]
    for split, views, lights in (("train", trained, lit[0::3]), ("test", tested, lit[1::3])):
        frames = [
            {"file_ext": ".png", **light_entry(truth, number, light, f"{view['cam_idx']}/{CAPTURE}"), **view}
            for view in views
            for number, light in lights
        ]
        _write_json(root / f"transforms_{split}.json", {"frames": frames})


def avif(linear: np.ndarray) -> bytes:
    """An AVIF file of linear light as sRGB."""
    clipped = np.clip(linear, 0, 1)
    curve = np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1 / 2.4) - 0.055)
    file = io.BytesIO()
    Image.fromarray(np.round(255 * curve).astype(np.uint8)).save(file, "AVIF", quality=90, subsampling="4:4:4")
    return file.getvalue()


def _write(path: Path, content: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)


def _write_json(path: Path, content: dict) -> None:
    _write(path, json.dumps(content).encode())
