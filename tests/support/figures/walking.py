"""A jointed figure made of tubes, its motion and cameras: planted truth for tracking tests."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from pipeline.geometry.cameras import Camera
from tests.support.meshes.glb_files import GlbFile

BONES = [
    # name, parent, start in the parent's frame, direction and length of its tube, radii across
    ("pelvis", -1, (0.0, 0.9, 0.0), (0.0, 0.15, 0.0), (0.13, 0.09)),
    ("spine", 0, (0.0, 0.15, 0.0), (0.0, 0.4, 0.0), (0.14, 0.09)),
    ("head", 1, (0.0, 0.45, 0.0), (0.0, 0.25, 0.0), (0.08, 0.13)),
    ("left_arm", 1, (0.2, 0.36, 0.0), (0.28, -0.05, 0.0), (0.05, 0.045)),
    ("left_forearm", 3, (0.28, -0.05, 0.0), (0.25, 0.0, 0.08), (0.045, 0.03)),
    ("right_arm", 1, (-0.2, 0.36, 0.0), (-0.28, -0.05, 0.0), (0.05, 0.045)),
    ("right_forearm", 5, (-0.28, -0.05, 0.0), (-0.25, 0.0, 0.08), (0.045, 0.03)),
    ("left_leg", 0, (0.1, 0.0, 0.0), (0.0, -0.42, 0.02), (0.07, 0.06)),
    ("left_shin", 7, (0.0, -0.42, 0.02), (0.0, -0.4, 0.05), (0.05, 0.04)),
    ("right_leg", 0, (-0.1, 0.0, 0.0), (0.0, -0.42, 0.02), (0.07, 0.06)),
    ("right_shin", 9, (0.0, -0.42, 0.02), (0.0, -0.4, 0.05), (0.05, 0.04)),
]
PARENTS = [bone[1] for bone in BONES]
STARTS = np.array([bone[2] for bone in BONES])
RINGS, SIDES = 6, 10


def _tube(start: np.ndarray, along: np.ndarray, radii: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of a closed elliptic tube."""
    across = np.cross(along, [0.0, 0.0, 1.0] if abs(along[2]) < 0.5 * np.linalg.norm(along) else [1.0, 0.0, 0.0])
    across /= np.linalg.norm(across)
    other = np.cross(along, across)
    other /= np.linalg.norm(other)
    angle = 2 * np.pi * np.arange(SIDES) / SIDES
    ring = radii[0] * np.cos(angle)[:, None] * across + radii[1] * np.sin(angle)[:, None] * other
    swell = 1 - 0.3 * (np.linspace(-1, 1, RINGS) ** 4)
    sides = [start + t * along + s * ring for t, s in zip(np.linspace(0, 1, RINGS), swell, strict=True)]
    vertices = np.concatenate([*sides, [start - 0.1 * along, start + 1.1 * along]])
    faces = []
    for i in range(SIDES):
        j = (i + 1) % SIDES
        for r in range(RINGS - 1):
            a, b, c, d = r * SIDES + i, r * SIDES + j, (r + 1) * SIDES + i, (r + 1) * SIDES + j
            faces += [(a, b, c), (b, d, c)]
        faces += [(i, RINGS * SIDES, j), ((RINGS - 1) * SIDES + i, (RINGS - 1) * SIDES + j, RINGS * SIDES + 1)]
    return vertices, np.array(faces)


@dataclass(frozen=True)
class Motion:
    """World positions of joints [F, J, 3] and vertices [F, V, 3] of every frame, and the faces."""

    times_s: np.ndarray
    joints: np.ndarray
    vertices: np.ndarray
    faces: np.ndarray


def rest_joints() -> np.ndarray:
    """Positions of the joints in the rest pose [J, 3]; no bone is turned in it."""
    where = np.zeros((len(BONES), 3))
    for bone, parent in enumerate(PARENTS):
        where[bone] = STARTS[bone] + (where[parent] if parent >= 0 else 0.0)
    return where


def mesh() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rest vertices, faces, and the bone of each vertex."""
    where = rest_joints()
    tubes = [_tube(where[i], np.array(bone[3]), bone[4]) for i, bone in enumerate(BONES)]
    first = np.cumsum([0] + [len(v) for v, _ in tubes])
    faces = np.concatenate([f + start for (_, f), start in zip(tubes, first[:-1], strict=True)])
    return np.concatenate([v for v, _ in tubes]), faces, np.repeat(np.arange(len(BONES)), np.diff(first))


def write_template(path: Path, units_per_m: float = 1.0, rigged: bool = True, flaw: bool = False) -> Path:
    """The figure's .glb; each vertex follows one bone. Joint i is node i + 1, below a plain node 0.

    With a `flaw`, some of its triangles have two equal corners, or three on one line.
    """
    vertices, faces, owner = mesh()
    if flaw:
        faces = np.concatenate([faces, [[0, 0, 1], [5, 5, 5], [60, 0, 61]]])
    file = GlbFile()
    attributes = {"POSITION": file.accessor((units_per_m * vertices).astype(np.float32))}
    indices = file.accessor(faces.reshape(-1, 1).astype(np.uint16))
    body: dict = {"mesh": 0}
    if rigged:
        joints, weights = np.zeros((len(owner), 4), np.uint8), np.zeros((len(owner), 4), np.float32)
        joints[:, 0], weights[:, 0] = owner, 1.0
        attributes["JOINTS_0"], attributes["WEIGHTS_0"] = file.accessor(joints), file.accessor(weights)
        bind = np.tile(np.eye(4, dtype=np.float32), (len(BONES), 1, 1))
        bind[:, :3, 3] = -units_per_m * rest_joints()
        matrices = file.accessor(bind.transpose(0, 2, 1).copy())
        file.content["skins"] = [{"joints": list(range(1, len(BONES) + 1)), "inverseBindMatrices": matrices}]
        body["skin"] = 0
    nodes: list[dict] = [{"children": [1]}]
    for bone in range(len(BONES)):
        children = [child + 1 for child, parent in enumerate(PARENTS) if parent == bone]
        node = {"name": BONES[bone][0], "translation": (units_per_m * STARTS[bone]).tolist()}
        nodes.append(node | ({"children": children} if children else {}))
    file.content["nodes"] = [*nodes, body]
    file.content["meshes"] = [{"primitives": [{"attributes": attributes, "indices": indices}]}]
    return file.write(path)


def walk(frames: int, fps: float = 24.0, rigid: bool = False, turn: float = 0.0, stride: float = 0.3) -> Motion:
    """A smooth motion of every joint, leaf joints and twists included, and of the whole figure.

    `turn`: about the vertical from the first frame to the last, radians; `stride`: along z, m/s.
    """
    times = np.arange(frames) / fps
    rest, faces, owner = mesh()
    rng = np.random.default_rng(7)
    amplitude = np.zeros((len(BONES), 3)) if rigid else 0.25 * rng.uniform(-1, 1, (len(BONES), 3))
    offset = np.zeros((len(BONES), 3)) if rigid else 0.2 * rng.uniform(-1, 1, (len(BONES), 3))
    amplitude[0], offset[0] = [0.1, 0.5, 0.1], [0.0, 1.0, 0.0]
    phase = rng.uniform(0, 2 * np.pi, len(BONES))
    joints, vertices = np.zeros((frames, len(BONES), 3)), np.zeros((frames, *rest.shape))
    where_rest = rest_joints()
    for f, t in enumerate(times):
        turns: list[Rotation] = []
        for bone, parent in enumerate(PARENTS):
            own = Rotation.from_rotvec(offset[bone] + amplitude[bone] * np.sin(2 * np.pi * t + phase[bone]))
            above = turns[parent] if parent >= 0 else Rotation.from_rotvec([0, turn * f / max(frames - 1, 1), 0])
            turns.append(above * own)
            if parent >= 0:
                joints[f, bone] = turns[parent].apply(STARTS[bone]) + joints[f, parent]
            else:
                joints[f, bone] = STARTS[bone] + [0.2 * np.sin(3 * t), 0.03 * np.cos(9 * t), stride * t]
            mine = owner == bone
            vertices[f, mine] = turns[bone].apply(rest[mine] - where_rest[bone]) + joints[f, bone]
    return Motion(times, joints, vertices, faces)


def ring_of_cameras(count: int, width: int = 640, height: int = 768) -> dict[str, Camera]:
    """Cameras around the figure, 3.5 m away, at three heights, distorted, at sensor resolution."""
    cameras = {}
    for c in range(count):
        azimuth, level = 2 * np.pi * c / count + 0.1, (0.4, 1.2, 2.1)[c % 3]
        center = np.array([3.5 * np.cos(azimuth), level, 3.5 * np.sin(azimuth)])
        forward = np.array([0.0, 0.9, 0.2]) - center
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0.0, 1.0, 0.0])
        right /= np.linalg.norm(right)
        R = np.stack([right, np.cross(forward, right), forward])
        K = np.array([[1.8 * width, 0.0, 0.51 * width], [0.0, 1.8 * width, 0.49 * height], [0.0, 0.0, 1.0]])
        dist = np.array([-0.06, 0.02, 1e-3, -5e-4, 0.0])
        cameras[f"cam{c:02d}"] = Camera(R, -R @ center, K, dist, width, height)
    return cameras


def draw_mask(camera: Camera, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Coverage 0..255 by OpenCV's polygon filling at eight times the resolution."""
    factor, bits = 8, 4
    pixels, _ = camera.project(vertices)
    corners = np.round((pixels * factor - 0.5) * 2**bits).astype(np.int32)[faces]
    large = np.zeros((camera.height * factor, camera.width * factor), np.uint8)
    for triangle in corners:
        cv2.fillConvexPoly(large, triangle, 255, shift=bits)
    return cv2.resize(large, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
