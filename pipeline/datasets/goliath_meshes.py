"""Meshes of Goliath: vertices in the head's frame or in the world, head poses, and faces."""

from __future__ import annotations

import logging
from collections.abc import Collection
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.errors import InputError, listed
from pipeline.capture.archives import members, read_bytes
from pipeline.config.import_capture import ImportCapture
from pipeline.datasets.goliath_cameras import METRES_PER_UNIT
from pipeline.datasets.goliath_kinds import VERTICES
from pipeline.datasets.imported_capture import TrackedMeshes
from pipeline.datasets.meshes_beside import STILL, meshes_beside
from pipeline.geometry.mesh_files import Mesh, decode_mesh

log = logging.getLogger(__name__)

TEMPLATES = ("kinematic_tracking/template_mesh.obj", "kinematic_tracking/template_mesh.ply", "template_mesh.obj",
             "template_mesh.ply", "kinematic_tracking/template_mesh_unscaled.ply")  # fmt: skip
"""Where faces are looked for: datasheet and loader differ; the last is that of hands."""

MEAN = "kinematic_tracking/registration_vertices_mean.npy"

FOLDER = "registration_vertices/"

MAKES_MESHES = (
    "the set's programs pose such a template by the skeleton of its shared assets, a pickle, which is not read: write "
    "one mesh per frame by them, in the world of camera_calibration.json"
)


def tracked_meshes(
    root: Path, frames: Collection[int], in_head: bool, settings: ImportCapture
) -> tuple[TrackedMeshes, str]:  # fmt: skip
    """The meshes of these frames, as far as there are any, and what they are.

    Args:
        root: folder of the capture.
        frames: their numbers.
        in_head: True if vertices are in the frame of a head that moves; False if they are in the world.
        settings: which name faces, and meshes where the set has none.

    Raises:
        InputError: if there are no vertices or no faces, or they do not fit.
    """
    if in_head:
        rest, origin = read_rest(root, settings.topology)
        said = f"registration_vertices in the frame of the head, moved by head_pose; {origin}"
        return TrackedMeshes(find_meshes(root, frames), METRES_PER_UNIT, rest), said
    if settings.mesh or not (root / VERTICES).is_file():
        return meshes_beside(settings.mesh, frames, MAKES_MESHES), "import_capture.mesh, in the world"
    there = members(root / VERTICES)
    found = {frame: f"{FOLDER}{frame:06d}.ply" for frame in frames if f"{FOLDER}{frame:06d}.ply" in there}
    if not found:
        raise InputError(f"{root / VERTICES}: expected members {FOLDER}000000.ply of listed frames, found none")
    path, (faced, origin) = root / VERTICES / next(iter(found.values())), read_faces(root, settings.topology)
    vertices = decode_mesh(read_bytes(path), path).vertices
    if len(vertices) != len(faced.vertices):
        raise InputError(f"{path}: expected {len(faced.vertices)} vertices, as {origin} has, found {len(vertices)}")
    table = pd.DataFrame({"frame": list(found), "path": [f"{VERTICES}/{name}" for name in found.values()]})
    tracked = TrackedMeshes(
        table.assign(world_from_mesh=[STILL] * len(found)), METRES_PER_UNIT,
        Mesh(METRES_PER_UNIT * vertices, faced.faces), "fitted",
    )  # fmt: skip
    return tracked, f"registration_vertices in the world; {origin}"


def find_meshes(root: Path, frames: Collection[int], folder: str = FOLDER) -> pd.DataFrame:
    """frame, path and world_from_mesh (metres) of the frames that have vertices and a head pose.

    Args:
        folder: that the archive has its members in.
    """
    vertices, poses = root / VERTICES, root / "head_pose/head_pose.zip"
    rows, bare = [], []
    for frame in frames:
        name = f"{folder}{frame:06d}.ply"
        if name not in members(vertices):
            continue
        if f"{frame:06d}.txt" not in members(poses):
            bare.append(frame)
            continue
        rows.append((frame, f"{VERTICES}/{name}", read_pose(poses / f"{frame:06d}.txt")))
    if bare:
        log.warning("%d frames have vertices and no head pose; their meshes are not used: %s", len(bare), bare)
    return pd.DataFrame(rows, columns=["frame", "path", "world_from_mesh"])


def read_pose(path: Path) -> list[float]:
    """The 12 numbers of world-from-head, its translation in metres.

    Raises:
        InputError: if there are not three rows of four finite numbers.
    """
    try:
        pose = np.array([line.split() for line in read_bytes(path).decode().splitlines() if line.strip()], np.float64)
    except ValueError:  # Rows of unequal length, words.
        pose = np.zeros(0)
    if pose.shape != (3, 4) or not np.isfinite(pose).all():
        raise InputError(f"{path}: expected three rows of four numbers, found shape {pose.shape}")
    pose[:, 3] *= METRES_PER_UNIT
    return pose.ravel().tolist()


def read_faces(root: Path, topology: str) -> tuple[Mesh, str]:
    """A mesh with the faces of all meshes, in the set's unit, and where it comes from.

    Raises:
        InputError: if no file has them.
    """
    there = [Path(topology)] if topology else [root / name for name in TEMPLATES if (root / name).is_file()]
    meshes = [(path, decode_mesh(read_bytes(path), path)) for path in there]
    if not (faced := [(path, mesh) for path, mesh in meshes if len(mesh.faces)]):
        found = f"no faces in {listed([path.name for path in there])}" if there else "no such file"
        raise InputError(
            f"{root}: expected the faces of its meshes in {' or '.join(TEMPLATES[:2])}, found {found}; set "
            "import_capture.topology to an .obj of the same vertices, as ava-256 has in assets/face_topology.obj"
        )
    path, mesh = faced[0]
    return mesh, f"faces of {path.name}"


def read_rest(root: Path, topology: str) -> tuple[Mesh, str]:
    """The mesh at rest, metres, in the frame of the head, and where it comes from.

    Raises:
        InputError: if no file has its faces, or they are of another mesh.
    """
    mesh, origin = read_faces(root, topology)
    vertices = METRES_PER_UNIT * mesh.vertices
    if (root / MEAN).is_file():
        mean = np.asarray(np.load(root / MEAN, allow_pickle=False), np.float64).reshape(-1, 3)
        if len(mean) != len(vertices):
            raise InputError(f"{root}: {origin}: expected the {len(mean)} vertices of {MEAN}, found {len(vertices)}")
        vertices, origin = METRES_PER_UNIT * mean, f"{origin}, shape of {Path(MEAN).name}"
    return Mesh(vertices, mesh.faces), origin
