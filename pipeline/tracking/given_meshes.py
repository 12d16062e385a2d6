"""The template as it was tracked elsewhere: given meshes, and what lies between them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float64, Int64

from pipeline.base.errors import InputError
from pipeline.base.progress import progress
from pipeline.capture.archives import read_bytes
from pipeline.geometry.kinematics import Pose
from pipeline.geometry.mesh_files import decode_mesh
from pipeline.geometry.pose_interpolation import fill_between, neighbours
from pipeline.geometry.rigid_alignment import align_rigid
from pipeline.geometry.rotations import matrix_from_quaternion, quaternion_from_matrix
from pipeline.geometry.signed_distance import View, silhouette_overlap
from pipeline.geometry.skin import Template


@dataclass(frozen=True)
class GivenTracking:
    """Motion of an unrigged template that was tracked elsewhere.

    Attributes:
        pose: world from template; it has no joints.
        offsets: from the rest vertices, in the template's frame, metres.
        vertices: in the world, metres.
        status: "given" for frames with a mesh, "between" for those between two, "held" beside one only.
    """

    pose: Pose
    offsets: Float64[np.ndarray, "frames vertices 3"]
    vertices: Float64[np.ndarray, "frames vertices 3"]
    status: list[str]

    def table(
        self, frames: Int64[np.ndarray, " frames"], views: Sequence[View], faces: Int64[np.ndarray, "faces 3"],
        residual_px: Float64[np.ndarray, "cameras frames keypoints"], inlier_px: float,
    ) -> pd.DataFrame:  # fmt: skip
        """Table of track_mesh: a row per frame.

        Args:
            frames: their numbers.
            views: of masks.
            faces: of the template.
            residual_px: distance of keypoints, where some were detected, from the meshes'; NaN elsewhere.
            inlier_px: up to which it counts as near.
        """
        none, near = np.zeros(len(frames), np.int64), residual_px < inlier_px
        count = near.sum((0, 2))
        rms = np.sqrt((np.where(near, residual_px, 0.0) ** 2).sum((0, 2)) / np.maximum(count, 1))
        return pd.DataFrame(
            {
                "frame": frames, "status": self.status, "rms_px": np.where(count > 0, rms, np.nan), "inliers": count,
                "observations": np.isfinite(residual_px).sum((0, 2)), "keypoints": none,
                "masks": np.sum([view.usable for view in views], axis=0) if views else none,
                "masks_interpolated": none, "silhouette_iou": silhouette_overlap(views, self.vertices, faces),
            }
        )  # fmt: skip

    def arrays(self, frames: Int64[np.ndarray, " frames"], keypoints: int) -> dict[str, np.ndarray]:
        """Arrays of track_mesh, without joints; as many keypoints are triangulated nowhere."""
        count = len(frames)
        return {
            "frames": frames, "vertices": self.vertices.astype(np.float32),
            "root_rotation": self.pose.root_rotation.astype(np.float32),
            "root_translation": self.pose.root_translation.astype(np.float32),
            "offsets": self.offsets.astype(np.float32), "keypoints": np.full((count, keypoints, 3), np.nan, np.float32),
            "keypoint_sigma_m": np.full((count, keypoints), np.nan, np.float32),
        }  # fmt: skip


def read_given(
    capture: Path, meshes: pd.DataFrame, facts: Mapping[str, Any], template: Template, frames: pd.DataFrame, kept: slice
) -> GivenTracking:
    """Meshes of some frames, given or interpolated between the nearest of their segment.

    A frame between two meshes turns by slerp, goes along a line at the rest vertices' centre, and deforms linearly in
    the frame of the template. One that has a mesh on one side only holds that.

    Args:
        capture: folder that the meshes' paths are relative to.
        meshes: frame, path, world_from_mesh, as index_capture has them.
        facts: `meshes` of capture.json: scale_to_m, motion.
        template: its rest vertices are in the frame of the meshes, if these have poses and these are its motion.
        frames: all frames of the capture in order: frame, segment.
        kept: those that are wanted.

    Raises:
        InputError: if the template has joints, whose rotations meshes do not say, or a mesh cannot be read.
    """
    if template.rigged:
        raise InputError("meshes: expected a template without a skin, found one with; leave out its joints and weights")
    rows = meshes.set_index("frame")
    known = np.flatnonzero(frames.frame.isin(rows.index)).astype(np.int64)
    takes = pd.factorize(frames.segment)[0].astype(np.int64)
    kept_rows = np.arange(len(frames))[kept]
    before, after, share = (part[kept] for part in neighbours(known, len(frames), takes))
    needed, where = np.unique(np.stack([before, after]), return_inverse=True)
    numbers = frames.frame.to_numpy(np.int64)[known[needed]]
    given, cached = progress([rows.loc[number] for number in numbers], "meshes"), lru_cache(2)(_read_vertices)
    posed = [_posed(facts["scale_to_m"] * cached(capture / row.path), row, facts["motion"], template) for row in given]
    rotations, shifts, offsets = (np.stack(part) for part in zip(*posed, strict=True))
    pose = Pose(rotations, shifts, np.zeros((len(needed), 0, 4)))
    filled = fill_between(pose, known[needed], len(frames), template.vertices_rest.mean(0), takes).at(kept_rows)
    # Not by `carry_offsets`: those of all frames of a long capture would not fit in memory.
    (first, second), later = where.reshape(2, -1), share[:, None, None]
    bent = offsets[first] * (1 - later) + offsets[second] * later
    moved = np.einsum("fab,fvb->fva", matrix_from_quaternion(filled.root_rotation), template.vertices_rest + bent)
    exact, alone = np.isin(kept_rows, known), before == after
    status = np.where(exact, "given", np.where(alone, "held", "between")).tolist()
    return GivenTracking(filled, bent, moved + filled.root_translation[:, None], status)


def _read_vertices(path: Path) -> Float64[np.ndarray, "vertices 3"]:
    return decode_mesh(read_bytes(path), path).vertices


def _posed(
    vertices: np.ndarray, row: pd.Series, motion: str, template: Template
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rotation (wxyz), translation and offsets of one mesh."""
    rest = template.vertices_rest
    if vertices.shape != rest.shape:
        raise InputError(f"{row.path}: expected the template's {len(rest)} vertices, found {len(vertices)}")
    if row.world_from_mesh is not None:
        pose = np.asarray(row.world_from_mesh, np.float64).reshape(3, 4)
        if motion == "given":
            return quaternion_from_matrix(pose[:, :3]), pose[:, 3], vertices - rest
        vertices = vertices @ pose[:, :3].T + pose[:, 3]
    fit = align_rigid(rest, vertices)
    return quaternion_from_matrix(fit.R), fit.t, (vertices - fit.t) @ fit.R - rest
