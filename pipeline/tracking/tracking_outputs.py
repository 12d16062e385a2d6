"""Tables and arrays that tracking writes of its frames."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from jaxtyping import Float64, Int64

from pipeline.geometry.signed_distance import View, silhouette_overlap
from pipeline.geometry.skin import Template
from pipeline.tracking.cues import posed_vertices
from pipeline.tracking.mesh_tracker import Tracking
from pipeline.tracking.vertex_offsets import skinning_jacobians


def tracked_vertices(template: Template, tracking: Tracking, kept: slice) -> Float64[np.ndarray, "kept vertices 3"]:
    """Posed vertices of some frames, with their offsets, metres."""
    pose = tracking.pose.at(kept)
    moved = np.einsum("fvab,fvb->fva", skinning_jacobians(template, pose), tracking.offsets[kept], optimize=True)
    return posed_vertices(template, pose) + moved


def frame_table(
    frames: Int64[np.ndarray, " frames"], kept: slice, template: Template, tracking: Tracking,
    vertices: Float64[np.ndarray, "kept vertices 3"], views: Sequence[View], between: Sequence[View], inlier_px: float,
) -> pd.DataFrame:  # fmt: skip
    """Make a row per kept frame: its status, and how well keypoints and outlines fit.

    Args:
        vertices, views, between: of the kept frames; masks that were seen, and those interpolated.
        inlier_px: up to which a keypoint counts.
    """
    residual = tracking.residual_px[:, kept]
    inlier = residual < inlier_px
    count = inlier.sum((0, 2))
    rms = np.sqrt((np.where(inlier, residual, 0.0) ** 2).sum((0, 2)) / np.maximum(count, 1))
    return pd.DataFrame(
        {
            "frame": frames[kept],
            "status": tracking.status[kept],
            "rms_px": np.where(count > 0, rms, np.nan),
            "inliers": count,
            "observations": np.isfinite(residual).sum((0, 2)),
            "keypoints": np.isfinite(tracking.keypoints_m[kept]).all(-1).sum(1),
            "masks": np.sum([view.usable for view in views], axis=0) if views else 0,
            "masks_interpolated": np.sum([view.usable for view in between], axis=0) if between else 0,
            "silhouette_iou": silhouette_overlap(views, vertices, template.faces),
        }
    )


def tracked_arrays(
    frames: Int64[np.ndarray, " frames"], kept: slice, template: Template, tracking: Tracking,
    vertices: Float64[np.ndarray, "kept vertices 3"],
) -> dict[str, np.ndarray]:  # fmt: skip
    """Arrays of the kept frames as their file has them; without joints, no rotations of joints."""
    pose = tracking.pose.at(kept)
    arrays = {
        "vertices": vertices, "joint_rotations": pose.joint_rotations, "root_rotation": pose.root_rotation,
        "root_translation": pose.root_translation, "offsets": tracking.offsets[kept],
        "keypoints": tracking.keypoints_m[kept], "keypoint_sigma_m": tracking.keypoint_sigma_m[kept],
    }  # fmt: skip
    if not template.rigged:
        del arrays["joint_rotations"]
    return {"frames": frames[kept], **{name: array.astype(np.float32) for name, array in arrays.items()}}
