"""A Goliath capture of a head in the exact layout of the set, with its traps.

K and T are stored transposed, in sensor pixels and millimetres; images are half as large, in zips of AVIF; part labels
half as large again; vertices lie in the frame of the head and list no faces; labels, vertices and head poses exist in
fully lit frames alone; one camera of the calibration has no images; the first frames of the second segment, and the
last one, lie between no two meshes.
"""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from tests.support.datasets.turning_head import TurningHead, dome_of_lights, ring_of_cameras

NAME = "m--20230306--0707--AAA000--pilot--ProjectGoliath--Head"
CAMERAS = ["400001", "400017", "401645", "400130", "400262", "400299"]
"""With images; the third is one of the loader's example test cameras."""

BLIND_CAMERA = "400331"
LIGHTS = 16
SEGMENTS = {"EXP_brow": range(7), "SEN_fox": range(7, 14)}
TEST_SEGMENT = "SEN_fox"
LIT_EVERY, PARTLY = 3, 5
DURATION = 5555
WHITE_BALANCE, BLACK = np.array([1.4, 1.1, 1.6]), np.array([2, 1, 2])
BODY, HAIR, CHAIR = 2, 1, 3
AVIF_QUALITY = 90


def pattern_of(frame: int) -> int:
    """Number of the light pattern of a frame: 0 in every third one."""
    return 0 if frame % LIT_EVERY == 0 else frame


def light_pattern(number: int) -> list[list[int]]:
    """The set's list of lights and durations."""
    if number == 0:
        return [[light, DURATION] for light in range(LIGHTS)]
    return [[(5 * number + 3 * k) % LIGHTS, 2 * DURATION + 100 * k] for k in range(PARTLY)]


def true_head(image: tuple[int, int] = (48, 72)) -> TurningHead:
    """The truth; `image` is width and height of the shipped images."""
    numbers = [frame for span in SEGMENTS.values() for frame in span]
    frames = {n: {light: d / DURATION for light, d in light_pattern(pattern_of(n))} for n in numbers}
    cameras = ring_of_cameras([*CAMERAS, BLIND_CAMERA], (2 * image[0], 2 * image[1]))
    lit = tuple(n for n in numbers if pattern_of(n) == 0)
    return TurningHead(cameras, 2, dome_of_lights(LIGHTS), frames, lit)


def write_goliath(folder: Path, truth: TurningHead) -> Path:
    """Write the capture below a folder; returns its own folder."""
    root = folder / NAME
    for part in ("image", "segmentation_parts", "kinematic_tracking", "head_pose", "lights", "uv_image",
                 "per_view_background", "keypoints_3d"):  # fmt: skip
        (root / part).mkdir(parents=True)
    lit = [frame for frame in truth.frames if pattern_of(frame) == 0]
    write_cameras(root, truth)
    write_lists(root, SEGMENTS)
    write_lights(root, truth)
    for name in CAMERAS:
        images = {f"cam{name}/{n:06d}.avif": avif(stored(truth.image(name, n))) for n in truth.frames}
        write_zip(root / f"image/cam{name}.zip", images)
        masks = {f"cam{name}/{n:06d}.png": png(part_labels(truth, name, n)) for n in lit}
        write_zip(root / f"segmentation_parts/cam{name}.zip", masks)
    _write_tracking(root, truth, lit)
    _write_assets(root, truth, lit)
    return root


def stored(linear: np.ndarray) -> np.ndarray:
    """Counts of linear light: its white balance undone, over the black level."""
    return np.clip(np.round(255 * linear / WHITE_BALANCE + BLACK), 0, 255).astype(np.uint8)


def part_labels(truth: TurningHead, name: str, frame: int) -> np.ndarray:
    """Part labels at half the image's size: hair, body, and a chair beside them."""
    labels = truth.labels(name, frame, np.where(truth.hair, HAIR, BODY), coarser=2)
    chair = np.zeros_like(labels)
    chair[-3:] = CHAIR
    return np.where(labels > 0, labels, chair)


def avif(rgb: np.ndarray) -> bytes:
    """An AVIF file."""
    file = io.BytesIO()
    Image.fromarray(rgb).save(file, "AVIF", quality=AVIF_QUALITY, subsampling="4:4:4")
    return file.getvalue()


def png(pixels: np.ndarray) -> bytes:
    """A PNG file."""
    return cv2.imencode(".png", pixels)[1].tobytes()


def write_zip(path: Path, files: dict[str, bytes]) -> None:
    """An archive of these members."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)


def write_cameras(root: Path, truth: TurningHead) -> None:
    """camera_calibration.json: K and T transposed, in sensor pixels and millimetres."""
    entries = []
    for name, camera in truth.cameras.items():
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = camera.R, 1000 * camera.t
        entries.append(
            {
                "cameraId": name, "projectionModel": "Pinhole", "distortionModel": "RadialAndTangential",
                "K": camera.K.T.tolist(), "T": T.T.tolist(), "distortion": camera.dist[:4].tolist(),
            }
        )  # fmt: skip
    (root / "camera_calibration.json").write_text(json.dumps({"KRT": entries}))


def write_lists(root: Path, segments: Mapping[str, range]) -> None:
    """Lists of splits and segments."""
    rows = [(segment, frame) for segment, span in segments.items() for frame in span]
    splits = [f"{frame},{'test' if segment == TEST_SEGMENT else 'train'}" for segment, frame in rows]
    (root / "frame_splits_list.csv").write_text("\n".join(["frame,split", *splits]) + "\n")
    listed = [f"{segment},{frame}" for segment, frame in rows]
    (root / "frame_segments_list.csv").write_text("\n".join(["segment_name,frame", *listed]) + "\n")


def write_lights(root: Path, truth: TurningHead) -> None:
    """Patterns, light positions, and a light that no pattern turns on."""
    (root / "lights").mkdir(exist_ok=True)
    per_frame = [[frame, pattern_of(frame)] for frame in truth.frames]
    (root / "lights/light_pattern_per_frame.json").write_text(json.dumps(per_frame))
    patterns = [{"light_index_durations": light_pattern(number)} for number in range(max(truth.frames) + 1)]
    places = [*(1000 * truth.lights_m).tolist(), [0.0, 0.0, 0.0]]
    content = {"light_positions": places, "light_patterns": patterns}
    (root / "lights/light_pattern_metadata.json").write_text(json.dumps(content))


def _write_tracking(root: Path, truth: TurningHead, lit: list[int]) -> None:
    folder = root / "kinematic_tracking"
    meshes = {f"registration_vertices/{n:06d}.ply": ply(1000 * truth.in_head(n)) for n in lit}
    write_zip(folder / "registration_vertices.zip", meshes)
    np.save(folder / "registration_vertices_mean.npy", (1000 * truth.mean_in_head).astype(np.float64))
    (folder / "registration_vertices_variance.txt").write_text("12.5\n")
    (folder / "template_mesh.obj").write_text(obj(1000 * truth.mean_in_head, truth.faces))
    write_zip(root / "head_pose/head_pose.zip", {f"{n:06d}.txt": pose_text(truth, n).encode() for n in lit})


def pose_text(truth: TurningHead, frame: int) -> str:
    """World-from-head in millimetres, three rows of four."""
    R, t = truth.pose(frame)
    rows = np.concatenate([R, 1000 * t[:, None]], axis=1)
    return "\n".join(" ".join(repr(float(value)) for value in row) for row in rows) + "\n"


def obj(vertices: np.ndarray, faces: np.ndarray) -> str:
    """An .obj of triangles with texture coordinates' numbers."""
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in vertices]
    return "\n".join([*lines, *(f"f {a}/{a} {b}/{b} {c}/{c}" for a, b, c in faces + 1)]) + "\n"


def ply(vertices: np.ndarray, faces: np.ndarray | None = None) -> bytes:
    """A binary .ply of vertices alone, or of triangles."""
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz")
    body = vertices.astype("<f4").tobytes()
    if faces is not None:
        head += f"element face {len(faces)}\nproperty list uchar int vertex_indices\n"
        rows = np.zeros(len(faces), [("count", "u1"), ("corners", "<i4", 3)])
        rows["count"], rows["corners"] = 3, faces
        body += rows.tobytes()
    return (head + "end_header\n").encode() + body


def _write_assets(root: Path, truth: TurningHead, lit: list[int]) -> None:
    """What the set's loader reads beside: textures, backgrounds, keypoints."""
    gray = png(np.full((8, 8, 3), 90, np.uint8))
    write_zip(root / "uv_image/color.zip", {f"color/{n:06d}.png": gray for n in lit})
    (root / "uv_image/color_mean.png").write_bytes(gray)
    (root / "uv_image/color_variance.txt").write_text("100.0\n")
    backgrounds = {}
    for name in CAMERAS:
        width, height = truth.image_size(name)
        backgrounds[f"{name}.png"] = png(np.tile(BLACK[::-1].astype(np.uint8), (height, width, 1)))
    write_zip(root / "per_view_background/per_view_background.zip", backgrounds)
    points = {f"{n:06d}.json": json.dumps({"0": [0.0, 0.0, 0.0, 1.0]}).encode() for n in lit}
    write_zip(root / "keypoints_3d/keypoints_3d.zip", points)
