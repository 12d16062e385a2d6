"""Small smooth offsets of a posed template's vertices per frame (cloth, cheeks, bellies).

Offsets live in the template before skinning, so that they move along with it. They are the minimum of the cues'
Gauss-Newton model and of a prior: a membrane (neighbouring offsets differ by a share of their distance) that is
anchored (offsets are millimetres). Both are integrals over the surface, per `CORRELATION_M2`, so that a finer mesh is
not held more tightly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse
from jaxtyping import Float64, Int64
from scipy.sparse.linalg import cg

from pipeline.geometry.kinematics import Pose
from pipeline.geometry.mesh import area_vectors, weld_vertices
from pipeline.geometry.rotations import matrix_from_quaternion
from pipeline.geometry.skin import Template, blended_transforms
from pipeline.geometry.surface_points import SurfacePoints
from pipeline.tracking.cues import Cue, require_finite
from pipeline.tracking.pose_equations import PointQuadratic

CORRELATION_M2 = 0.05**2
"""Area over which an offset is one independent number: a fold of cloth."""

STRETCH = 0.1
"""Typical difference of two offsets over their distance: a tenth, as a belly or the edge of a loose sleeve has it."""

ROUNDS = 3
"""Rounds of linearising the cues: robust losses let go of a silhouette pixels away, and take it up again nearer."""

SOLVED = 1e-3
"""Relative residual at which conjugate gradients end: a hundredth of a millimetre of a centimetre."""


@dataclass(frozen=True)
class Membrane:
    """The prior's matrix, for one coordinate of the offsets of the welded vertices.

    Attributes:
        weld: unknown of each vertex: vertices in one place share it.
        matrix: inverse covariance, 1 / m^2.
    """

    weld: Int64[np.ndarray, " vertices"]
    matrix: scipy.sparse.csr_array


def membrane(template: Template, typical_m: float) -> Membrane:
    """The prior on offsets of about `typical_m`, on the rest mesh."""
    lowest = weld_vertices(template.vertices_rest, template.faces)
    _, weld = np.unique(lowest, return_inverse=True)
    count = int(weld.max()) + 1
    corner_area = np.repeat(np.linalg.norm(area_vectors(template.vertices_rest, template.faces), axis=1) / 3, 3)
    start, end = template.faces.ravel(), np.roll(template.faces, -1, 1).ravel()
    length = np.linalg.norm(template.vertices_rest[start] - template.vertices_rest[end], axis=1)
    used = length > 0
    spring = corner_area[used] / CORRELATION_M2 / (STRETCH * length[used]) ** 2
    i, j = weld[start[used]], weld[end[used]]
    springs = scipy.sparse.coo_array(
        (np.concatenate([spring, spring, -spring, -spring]), (np.r_[i, j, i, j], np.r_[i, j, j, i])), (count, count)
    )
    area = np.bincount(weld[start], corner_area, count)
    # A vertex without any area (of a degenerate face only) is held where it is.
    anchor = np.maximum(area, area.mean()) / CORRELATION_M2 / typical_m**2
    return Membrane(weld, (springs + scipy.sparse.diags_array(anchor)).tocsr())


def skinning_jacobians(template: Template, pose: Pose) -> Float64[np.ndarray, "frames vertices 3 3"]:
    """Jacobians of linear blend skinning: world displacement by offset before skinning."""
    root = matrix_from_quaternion(pose.root_rotation)
    if not template.rigged:
        return np.broadcast_to(root[:, None], (len(pose), len(template.vertices_rest), 3, 3))
    return root[:, None] @ blended_transforms(template, pose.joint_rotations)[..., :3]


def fit_offsets(
    template: Template, vertices: Float64[np.ndarray, "frames vertices 3"],
    jacobians: Float64[np.ndarray, "frames vertices 3 3"], cues: Sequence[Cue], typical_m: float,
) -> Float64[np.ndarray, "frames vertices 3"]:  # fmt: skip
    """Offsets before skinning, metres, that bring posed `vertices` to where cues want them.

    Args:
        vertices: of the posed template, world, metres.
        jacobians: `skinning_jacobians` of the pose.
        cues: of these frames.
        typical_m: of an offset.
    """
    prior = membrane(template, typical_m)
    matrix = scipy.sparse.kron(prior.matrix, np.eye(3), "bsr")
    offsets = np.zeros((len(vertices), prior.matrix.shape[0], 3))
    for _ in range(ROUNDS):
        moved = vertices + np.einsum("fvab,fvb->fva", jacobians, offsets[:, prior.weld], optimize=True)
        require_finite(moved)
        terms = [(cue.points, cue.around(moved)(cue.points.carried(moved))) for cue in cues]
        for frame in range(len(vertices)):
            slope = (prior.matrix @ offsets[frame]).ravel()
            total = matrix
            for points, quadratic in terms:
                more, gradient = _by_offsets(prior, jacobians[frame], points, quadratic, frame)
                total, slope = total + more, slope + gradient
            step, _ = cg(total, -slope, rtol=SOLVED, M=scipy.sparse.diags_array(1 / total.diagonal()))
            offsets[frame] += step.reshape(-1, 3)
    return offsets[:, prior.weld]


def _by_offsets(
    prior: Membrane, jacobians: np.ndarray, points: SurfacePoints, quadratic: PointQuadratic, frame: int
) -> tuple[scipy.sparse.bsr_array, Float64[np.ndarray, " all"]]:
    """Gauss-Newton matrix and gradient by one frame's offsets, from those by the points' positions."""
    borne = np.flatnonzero(quadratic.normal[frame].any((1, 2)) | quadratic.gradient[frame].any(1))
    corners, count = points.corners[borne], len(borne)
    # Blocks of 3 x 3 numbers: by row a point, by column an offset of one of its corners; or a point in both.
    blocks = points.barycentric[borne][..., None, None] * jacobians[corners]
    shape = (3 * count, 3 * prior.matrix.shape[0])
    jacobian = scipy.sparse.bsr_array(
        (blocks.reshape(-1, 3, 3), prior.weld[corners].ravel(), 3 * np.arange(count + 1)), shape
    )
    normal = scipy.sparse.bsr_array(
        (quadratic.normal[frame, borne], np.arange(count), np.arange(count + 1)), (3 * count, 3 * count)
    )
    return jacobian.T @ (normal @ jacobian), jacobian.T @ quadratic.gradient[frame, borne].ravel()
