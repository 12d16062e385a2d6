"""Linear blend skinning of the synthetic figure, the truth for tracking.

Written apart from `pipeline.geometry` on purpose: an error in one does not hide in the other.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.spatial.transform
from jaxtyping import Float64, Int64

from pipeline.synthesis.implicit_surface import distance_to_solids, neighbor_average
from pipeline.synthesis.skeleton import RoundCone, Skeleton

BLEND_ROUNDS = 8
"""Rounds of diffusing weights over the mesh. Joints blend over about sqrt(8) edge lengths to either side."""

INFLUENCES = 4
"""Joints per vertex, as glTF's JOINTS_0 and WEIGHTS_0 hold."""


def smooth_weights(
    vertices: Float64[np.ndarray, "v 3"],
    faces: Int64[np.ndarray, "f 3"],
    solids: Sequence[RoundCone],
    skeleton: Skeleton,
) -> Float64[np.ndarray, "v joints"]:
    """Skin weights, diffused along the surface from the joints that own the nearest solids.

    Each vertex starts with weight 1 for one joint. Diffusion follows the mesh, so limbs that are close in space but not
    along the skin never share weights. At most `INFLUENCES` joints per vertex; rows sum to 1.
    """
    owners = np.array([skeleton.index(solid.joint) for solid in solids])
    nearest = owners[distance_to_solids(vertices, solids).argmin(axis=1)]
    weights = np.eye(len(skeleton.names))[nearest]
    average = neighbor_average(faces, len(vertices))
    for _ in range(BLEND_ROUNDS):
        weights = 0.5 * (weights + average @ weights)
    smallest_kept = np.sort(weights, axis=1)[:, -INFLUENCES][:, None]
    weights = np.where(weights >= smallest_kept, weights, 0.0)
    return weights / weights.sum(axis=1, keepdims=True)


def joint_transforms(
    skeleton: Skeleton,
    rotations: Float64[np.ndarray, "joints 4"],
    root_translation: Float64[np.ndarray, "3"],
) -> Float64[np.ndarray, "joints 4 4"]:
    """World-from-joint transforms from local rotations, by forward kinematics.

    Rotations are unit quaternions, wxyz. The root joint stands at its rest position plus `root_translation`.
    """
    matrices = scipy.spatial.transform.Rotation.from_quat(rotations, scalar_first=True).as_matrix()
    world = np.zeros((len(skeleton.names), 4, 4))
    for joint, parent in enumerate(skeleton.parents):
        local = np.eye(4)
        local[:3, :3] = matrices[joint]
        if parent < 0:
            local[:3, 3] = skeleton.positions[joint] + root_translation
            world[joint] = local
        else:
            local[:3, 3] = skeleton.positions[joint] - skeleton.positions[parent]
            world[joint] = world[parent] @ local
    return world


def pose_vertices(
    vertices: Float64[np.ndarray, "v 3"],
    weights: Float64[np.ndarray, "v joints"],
    skeleton: Skeleton,
    world_from_joint: Float64[np.ndarray, "joints 4 4"],
) -> Float64[np.ndarray, "v 3"]:
    """Posed vertices by linear blend skinning (glTF 2.0 section 3.7.3.3).

    The sum over joints of weight * world * inverse bind * vertex.
    """
    moved = np.einsum(
        "jab,vjb->vja", world_from_joint[:, :3, :3], vertices[:, None, :] - skeleton.positions[None, :, :]
    )
    return np.einsum("vj,vja->va", weights, moved + world_from_joint[None, :, :3, 3])
