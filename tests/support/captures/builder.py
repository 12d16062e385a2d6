"""A tiny valid native capture: 2 cameras, 3 frames of 8 x 6 pixels, 3 lights, a tetrahedron.

Files are written with OpenCV, OpenEXR and plain text, not with the code that reads them.
"""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import OpenEXR
import pandas as pd
import yaml

from tests.support.meshes.glb_files import GlbFile

CAMERAS = ("left", "right")
FRAMES = (0, 1, 2)
LIGHTS = {"A": (0.0, 1.0, 2.0), "B": (1.5, 0.5, 1.0), "C": (-1.0, -0.25, 1.5)}
WIDTH, HEIGHT, DOWNSAMPLE = 8, 6, 2
SENSOR = (WIDTH * DOWNSAMPLE, HEIGHT * DOWNSAMPLE)

MANIFEST: dict[str, Any] = {
    "format": "lightstage-capture/1",
    "subject": "tiny",
    "kind": "body",
    "units": "m",
    "up": "+y",
    "fps": 30,
    "images": {
        "path": "images/{camera}/{frame:06d}.exr", "transfer": "linear", "black_level": 0.0,
        "downsample_from_sensor": DOWNSAMPLE,
    },
    "masks": {"path": "masks/{camera}/{frame:06d}.png"},
    "cameras": "cameras.csv",
    "frames": "frames.csv",
    "lights": "lights.csv",
    "patterns": "patterns.csv",
    "keypoints_2d": "keypoints_2d.parquet",
    "template": {"mesh": "template/template.glb", "keypoints": "template/keypoints.csv", "scale_to_m": 0.5},
    "calibration": {
        "cameras": {"method": "known", "path": "calibration/cameras.json"},
        "lights": {"method": "known"},
        "color": {"method": "none"},
    },
    "splits": {"test_cameras": ["right"], "test_frames": [1], "test_segments": ["b"]},
}  # fmt: skip

MEASURED: dict[str, Any] = {
    "cameras": {
        "method": "charuco", "path": "calibration/charuco/{camera}/{view:03d}.png", "squares_x": 7, "squares_y": 5,
        "square_m": 0.12, "marker_m": 0.09, "dictionary": "DICT_5X5_250",
    },
    "lights": {
        "method": "mirror_ball", "path": "calibration/ball/{position}/{camera}/{light}.png",
        "silhouette": "calibration/ball/{position}/{camera}/silhouette.png", "radius_m": 0.1,
    },
    "color": {
        "method": "chart", "path": "calibration/chart/{camera}.exr", "patches": "calibration/chart/chart.csv",
        "transfer": "linear",
    },
}  # fmt: skip
"""The calibration section of a capture built with `measured=True`."""


def build_capture(root: Path, *, measured: bool = False) -> Path:
    """Write the capture; its calibration is known, or `measured`.

    A measured one has images that only look the part.
    """
    rng = np.random.default_rng(7)
    manifest = copy.deepcopy(MANIFEST)
    if measured:
        manifest["calibration"] = copy.deepcopy(MEASURED)
    root.mkdir(parents=True, exist_ok=True)
    (root / "capture.yaml").write_text(yaml.safe_dump(manifest, sort_keys=False))
    _write_tables(root)
    for camera in CAMERAS:
        for frame in FRAMES:
            save_exr(root / f"images/{camera}/{frame:06d}.exr", rng.uniform(-0.01, 1, (HEIGHT, WIDTH, 3)))
            mask = np.zeros((HEIGHT, WIDTH), np.uint8)
            mask[1:5, 2:6] = 255
            save(root / f"masks/{camera}/{frame:06d}.png", mask)
    write_template(root / "template/template.glb")
    (_write_measured_calibration if measured else _write_known_calibration)(root)
    return root


def _write_tables(root: Path) -> None:
    sensor_width, sensor_height = SENSOR
    cameras = [f"{camera},{WIDTH},{HEIGHT},{sensor_width},{sensor_height}" for camera in CAMERAS]
    write_lines(root / "cameras.csv", "camera,width,height,sensor_width,sensor_height", *cameras)
    write_lines(root / "frames.csv", "frame,timestamp_s,segment", "0,0.0,a", "1,0.03333333333333333,a", "2,0.5,b")
    write_lines(root / "lights.csv", "light,x,y,z", *[f"{name},{x},{y},{z}" for name, (x, y, z) in LIGHTS.items()])
    write_lines(root / "patterns.csv", "frame,light,intensity", "0,A,1.0", "0,B,1.0", "0,C,0.5", "1,A,2.0", "2,C,1.0")
    template = root / "template"
    template.mkdir(exist_ok=True)
    write_lines(template / "keypoints.csv", "keypoint,node_index", "hip,1", "head,2")
    rows = [(f, c, k, 3.25, 2.5, 0.9) for f in FRAMES for c in CAMERAS for k in ("hip", "head")]
    keypoints = pd.DataFrame(rows, columns=["frame", "camera", "keypoint", "x", "y", "confidence"])
    keypoints.to_parquet(root / "keypoints_2d.parquet", index=False)


def _write_known_calibration(root: Path) -> None:
    """Cameras 2 m from the origin that look at it, 1.2 radians apart."""
    cameras = {}
    for camera, angle in zip(CAMERAS, (-0.6, 0.6), strict=True):
        backward = np.array([np.sin(angle), 0.0, np.cos(angle)])
        right = np.cross([0.0, 1.0, 0.0], backward)
        R = np.stack([right, [0.0, -1.0, 0.0], -backward])
        K = [[20.0, 0.0, SENSOR[0] / 2], [0.0, 20.0, SENSOR[1] / 2], [0.0, 0.0, 1.0]]
        cameras[camera] = {
            "R": R.tolist(), "t": (-R @ (2 * backward)).tolist(), "K": K, "dist": [0.0] * 5,
            "width": SENSOR[0], "height": SENSOR[1],
        }  # fmt: skip
    (root / "calibration").mkdir(exist_ok=True)
    (root / "calibration/cameras.json").write_text(json.dumps({"cameras": cameras}))


def _write_measured_calibration(root: Path) -> None:
    rng = np.random.default_rng(8)
    gray = rng.integers(0, 255, SENSOR[::-1], dtype=np.uint8)
    for camera in CAMERAS:
        for view in (0, 3):
            save(root / f"calibration/charuco/{camera}/{view:03d}.png", gray)
        for name in ("silhouette", *LIGHTS):
            save(root / f"calibration/ball/low/{camera}/{name}.png", gray)
        save_exr(root / f"calibration/chart/{camera}.exr", rng.uniform(0, 1, (10, 12, 3)))
    rows = [f"{patch},{patch / 30},{patch / 40},{patch / 50}" for patch in range(1, 25)]
    write_lines(root / "calibration/chart/chart.csv", "patch,r,g,b", *rows)


def write_template(path: Path, mode: int = 4, copies: int = 1) -> None:
    """Equal tetrahedra with a skin of two joints, nodes 1 and 2; glTF's mode 4 is triangles."""
    file = GlbFile()
    positions = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float32)
    faces = np.array([0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3], np.uint16)
    joints = np.array([[0, 0, 0, 0], [0, 1, 0, 0], [1, 0, 0, 0], [1, 0, 0, 0]], np.uint8)
    weights = np.array([[1, 0, 0, 0], [0.5, 0.5, 0, 0], [1, 0, 0, 0], [1, 0, 0, 0]], np.float32)
    faces = np.concatenate([faces + 4 * copy for copy in range(copies)]).astype(np.uint16)
    positions, joints, weights = (np.tile(values, (copies, 1)) for values in (positions, joints, weights))
    attributes = {
        "POSITION": file.accessor(positions), "JOINTS_0": file.accessor(joints), "WEIGHTS_0": file.accessor(weights)
    }  # fmt: skip
    inverse_bind = np.stack([np.eye(4, dtype=np.float32)] * 2)
    primitive = {"attributes": attributes, "indices": file.accessor(faces), "mode": mode}
    file.content["meshes"] = [{"primitives": [primitive]}]
    file.content["nodes"] = [{"mesh": 0, "skin": 0}, {"children": [2]}, {}]
    file.content["skins"] = [{"joints": [1, 2], "inverseBindMatrices": file.accessor(inverse_bind)}]
    file.content |= {"scene": 0, "scenes": [{"nodes": [0, 1]}]}
    path.parent.mkdir(parents=True, exist_ok=True)
    file.write(path)


def save(path: Path, pixels: np.ndarray) -> None:
    """Write pixels (BGR if coloured) with OpenCV."""
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), pixels)


def save_exr(path: Path, rgb: np.ndarray, names: str = "RGB", dtype: type = np.float16) -> None:
    """Write [h, w, channels] with OpenEXR under these channel names."""
    path.parent.mkdir(parents=True, exist_ok=True)
    planes = {name: np.ascontiguousarray(rgb[..., index].astype(dtype)) for index, name in enumerate(names)}
    OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}, planes).write(str(path))


def write_lines(path: Path, *lines: str) -> None:
    """Write a text file."""
    path.write_text("\n".join(lines) + "\n")


def edit_manifest(root: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """Let `change` alter the content of capture.yaml."""
    manifest = yaml.safe_load((root / "capture.yaml").read_text())
    change(manifest)
    (root / "capture.yaml").write_text(yaml.safe_dump(manifest, sort_keys=False))


def replace_text(path: Path, old: str, new: str) -> None:
    """Replace the only occurrence of `old`."""
    text = path.read_text()
    assert text.count(old) == 1, f"{old!r} occurs {text.count(old)} times"
    path.write_text(text.replace(old, new))


def truncate(path: Path, share: float = 0.6) -> None:
    """Cut the end of a file off."""
    content = path.read_bytes()
    path.write_bytes(content[: int(len(content) * share)])
