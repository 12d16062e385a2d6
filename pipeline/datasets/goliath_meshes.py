"""Meshes of Goliath: vertices in the frame of the head, head poses, and faces."""

from __future__ import annotations

import logging
from collections.abc import Collection
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.errors import InputError, listed
from pipeline.capture.archives import members, read_bytes
from pipeline.datasets.goliath_cameras import METRES_PER_UNIT
from pipeline.geometry.mesh_files import Mesh, decode_mesh

log = logging.getLogger(__name__)

TEMPLATES = ("kinematic_tracking/template_mesh.obj", "kinematic_tracking/template_mesh.ply", "template_mesh.obj",
             "template_mesh.ply")  # fmt: skip
"""Where faces are looked for: datasheet and loader differ."""

MEAN = "kinematic_tracking/registration_vertices_mean.npy"


FOLDER = "registration_vertices/"


def find_meshes(root: Path, frames: Collection[int], folder: str = FOLDER) -> pd.DataFrame:
    """frame, path and world_from_mesh (metres) of the frames that have vertices and a head pose.

    Args:
        folder: that the archive has its members in.
    """
    vertices, poses = root / "kinematic_tracking/registration_vertices.zip", root / "head_pose/head_pose.zip"
    rows, bare = [], []
    for frame in frames:
        name = f"{folder}{frame:06d}.ply"
        if name not in members(vertices):
            continue
        if f"{frame:06d}.txt" not in members(poses):
            bare.append(frame)
            continue
        rows.append((frame, f"kinematic_tracking/{vertices.name}/{name}", read_pose(poses / f"{frame:06d}.txt")))
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


def read_rest(root: Path, topology: str) -> tuple[Mesh, str]:
    """The mesh at rest, metres, in the frame of the head, and where it comes from.

    Raises:
        InputError: if no file has its faces, or they are of another mesh.
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
    vertices, origin = METRES_PER_UNIT * mesh.vertices, f"faces of {path.name}"
    if (root / MEAN).is_file():
        mean = np.asarray(np.load(root / MEAN, allow_pickle=False), np.float64).reshape(-1, 3)
        if len(mean) != len(vertices):
            raise InputError(f"{path}: expected the {len(mean)} vertices of {MEAN}, found {len(vertices)}")
        vertices, origin = METRES_PER_UNIT * mean, f"{origin}, shape of {Path(MEAN).name}"
    return Mesh(vertices, mesh.faces), origin
