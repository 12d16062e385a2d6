"""Table of meshes that were tracked elsewhere."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.errors import Complaints, InputError, listed
from pipeline.base.files import digest_bytes
from pipeline.capture.archives import read_bytes
from pipeline.capture.index.csv_tables import complain_repeats, complain_unknown
from pipeline.capture.index.parquet_tables import read_parquet
from pipeline.capture.paths import check_relative, check_suffix, locate
from pipeline.capture.schema.given_schema import Meshes
from pipeline.geometry.mesh_files import SUFFIXES, decode_mesh

log = logging.getLogger(__name__)

MESH_COLUMNS = ("frame", "path", "world_from_mesh", "digest")

POSE_NUMBERS = 12
"""Numbers of a rigid motion: three rows [R | t]."""

ROTATION_TOLERANCE = 1e-4
"""Largest entry of R R^T - I: a rotation written with five digits passes."""


def no_meshes() -> pd.DataFrame:
    """The empty table: of a capture that is tracked here."""
    kinds = {"frame": "int64", "path": "str", "world_from_mesh": "object", "digest": "str"}
    return pd.DataFrame({column: pd.Series(dtype=kinds[column]) for column in MESH_COLUMNS})


def read_meshes(
    root: Path, section: Meshes | None, frames: pd.DataFrame | None, vertices: int | None, imported: bool,
    complaints: Complaints, threads: int = 4,
) -> pd.DataFrame:  # fmt: skip
    """Table of tracked meshes by frame, each with its digest; empty if there are none.

    Args:
        frames: the capture's; None if they are in doubt.
        vertices: number of the template's; None if it is in doubt.
        imported: True if files may lie behind the link of an imported capture.
    """
    if section is None:
        return no_meshes()
    path = section.table
    table = read_parquet(root, path, {"frame": "whole", "path": "text"}, complaints)
    if table is None:
        return no_meshes()
    table["world_from_mesh"] = _poses(root, path, len(table), complaints)
    complain_repeats(complaints, path, table, ["frame"])
    if table.empty:
        complaints.add(path, "frame", expected="at least one row", found="none")
    if frames is not None:
        complain_unknown(complaints, path, "frame", table["frame"], list(frames["frame"]), "the table of frames")
    with ThreadPoolExecutor(threads) as pool:
        names = table["path"].astype(str).unique().tolist()
        read = dict(zip(names, pool.map(lambda name: _inspect(root, name, vertices, imported), names), strict=True))
    found = [read[str(name)] for name in table["path"]]
    if wrong := [message for _, message in read.values() if message]:
        complaints.messages += wrong[:5]
        if len(wrong) > 5:
            complaints.add(path, "path", expected="whole meshes", found=f"{len(wrong) - 5} more that cannot be used")
    table["digest"] = [digest for digest, _ in found]
    return table[list(MESH_COLUMNS)].sort_values("frame", kind="stable", ignore_index=True)


def _inspect(root: Path, path: str, vertices: int | None, imported: bool) -> tuple[str, str]:
    """Digest of a mesh's file, and what is wrong with it."""
    try:
        check_suffix(check_relative(path), SUFFIXES)
        content = read_bytes(locate(root, path, imported=imported))
        count = len(decode_mesh(content, Path(path)).vertices)
    except (InputError, ValueError) as error:
        return "", f"{path}: {error}" if isinstance(error, ValueError) else str(error)
    wrong = vertices is not None and count != vertices
    return digest_bytes(content), f"{path}: expected the template's {vertices} vertices, found {count}" if wrong else ""


def _poses(root: Path, path: str, rows: int, complaints: Complaints) -> Sequence[np.ndarray | None]:
    """The poses of a table, 12 numbers each; None where the vertices are in the world."""
    table = pd.read_parquet(locate(root, path))
    if "world_from_mesh" not in table:
        return [None] * rows
    poses = [None if pose is None else np.asarray(pose, np.float64) for pose in table["world_from_mesh"]]
    bad = [frame for frame, pose in zip(table["frame"], poses, strict=True) if pose is not None and not _is_rigid(pose)]
    if bad:
        expected = "12 numbers, the rows of [R | t] with a rotation R, or null"
        complaints.add(path, "world_from_mesh", expected=expected, found=f"others in frame {listed(bad)}")
    return poses


def _is_rigid(pose: np.ndarray) -> bool:
    if pose.shape != (POSE_NUMBERS,) or not np.isfinite(pose).all():
        return False
    R = pose.reshape(3, 4)[:, :3]
    return bool(np.abs(R @ R.T - np.eye(3)).max() < ROTATION_TOLERANCE and np.linalg.det(R) > 0)
