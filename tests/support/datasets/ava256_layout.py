"""An ava-256 capture in the exact layout of the set, with its traps.

All is in a folder `decoder`. K and T are stored transposed, in sensor pixels and millimetres, while images are four
times smaller, in zips of AVIF; members of the archive of vertices have no folder; vertices lie in the frame of the head
and list no faces, which are in the set's programs; the light never changes and is not described; a listed frame has no
image.
"""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path

import numpy as np

from tests.support.datasets.goliath_layout import avif, ply, png, pose_text
from tests.support.datasets.turning_head import TurningHead, dome_of_lights, ring_of_cameras

NAME = "m--20210223--1023--AVW368--GHS"
CAMERAS = ["400940", "400943", "401031", "401168"]
SMALLER = 4
SEGMENTS = {"EXP_neutral_peak": range(100, 108), "EXP_free_face": range(112, 116)}
TEST_SEGMENT = "EXP_free_face"
DROPPED = 120
"""In the list of frames, without images and all else."""

LIGHTS, INTENSITY = 24, 0.3
BODY, HAIR, CHAIR = 2, 1, 3


def true_head(image: tuple[int, int] = (32, 48)) -> TurningHead:
    """The truth; `image` is width and height of the shipped images."""
    numbers = [frame for span in SEGMENTS.values() for frame in span]
    cameras = ring_of_cameras(CAMERAS, (SMALLER * image[0], SMALLER * image[1]))
    lit = dict.fromkeys(range(LIGHTS), INTENSITY)
    return TurningHead(cameras, SMALLER, dome_of_lights(LIGHTS), dict.fromkeys(numbers, lit), tuple(numbers))


def write_ava256(folder: Path, truth: TurningHead) -> Path:
    """Write the capture below a folder; returns its own folder."""
    root = folder / NAME
    inside = root / "decoder"
    for part in ("image", "segmentation_parts", "kinematic_tracking", "head_pose", "uv_image", "keypoints_3d"):
        (inside / part).mkdir(parents=True)
    (root / "encoder/image").mkdir(parents=True)
    rows = [f"{segment},{frame:06d}" for segment, span in SEGMENTS.items() for frame in span]
    rows.append(f"{TEST_SEGMENT},{DROPPED:06d}")
    (inside / "frame_list.csv").write_text("\n".join(["seg_id,frame_id", *rows]) + "\n")
    (inside / "camera_calibration.json").write_text(json.dumps({"KRT": [_entry(truth, name) for name in CAMERAS]}))
    for name in CAMERAS:
        images = {f"cam{name}/{n:06d}.avif": avif(stored(truth.image(name, n))) for n in truth.frames}
        _write_zip(inside / f"image/cam{name}.zip", images)
        masks = {f"cam{name}/{n:06d}.png": png(part_labels(truth, name, n)) for n in truth.frames}
        _write_zip(inside / f"segmentation_parts/cam{name}.zip", masks)
    tracking, points = inside / "kinematic_tracking", io.BytesIO()
    _write_zip(
        tracking / "registration_vertices.zip", {f"{n:06d}.ply": ply(1000 * truth.in_head(n)) for n in truth.frames}
    )
    np.save(tracking / "registration_vertices_mean.npy", (1000 * truth.mean_in_head).astype(np.float64))
    (tracking / "registration_vertices_variance.txt").write_text("12.5\n")
    _write_zip(inside / "head_pose/head_pose.zip", {f"{n:06d}.txt": pose_text(truth, n).encode() for n in truth.frames})
    np.save(points, np.zeros((1, 6)))
    _write_zip(inside / "keypoints_3d/keypoints_3d.zip", {f"{n:06d}.npy": points.getvalue() for n in truth.frames})
    texture = avif(np.full((8, 8, 3), 90, np.uint8))
    _write_zip(inside / "uv_image/color.zip", {f"color/{n:06d}.avif": texture for n in truth.frames})
    return root


def write_topology(folder: Path, truth: TurningHead) -> Path:
    """Write the faces of the meshes, as the set's programs have them; returns the file."""
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in 1000 * truth.mean_in_head]
    lines += [f"f {a}/{a} {b}/{b} {c}/{c}" for a, b, c in truth.faces + 1]
    path = folder / "face_topology.obj"
    path.write_text("\n".join(lines) + "\n")
    return path


def settings(folder: Path, truth: TurningHead) -> str:
    """Settings of import_capture as YAML; writes the topology that they name."""
    return f"{{topology: {write_topology(folder, truth)}}}"


def stored(linear: np.ndarray) -> np.ndarray:
    """Counts of linear light, sRGB."""
    clipped = np.clip(linear, 0, 1)
    curve = np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1 / 2.4) - 0.055)
    return np.round(255 * curve).astype(np.uint8)


def part_labels(truth: TurningHead, name: str, frame: int) -> np.ndarray:
    """Part labels of an image: hair, body, and a chair beside them."""
    labels = truth.labels(name, frame, np.where(truth.hair, HAIR, BODY))
    chair = np.zeros_like(labels)
    chair[-3:] = CHAIR
    return np.where(labels > 0, labels, chair)


def _entry(truth: TurningHead, name: str) -> dict[str, object]:
    camera, T = truth.cameras[name], np.eye(4)
    T[:3, :3], T[:3, 3] = camera.R, 1000 * camera.t
    return {
        "cameraId": name, "projectionModel": "Pinhole", "distortionModel": "RadialAndTangential",
        "K": camera.K.T.tolist(), "T": T.T.tolist(), "distortion": camera.dist[:4].tolist(),
    }  # fmt: skip


def _write_zip(path: Path, files: dict[str, bytes]) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
