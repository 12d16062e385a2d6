"""Writing tracked meshes in Goliath's layout.

Vertices lie in the frame of the head, in millimetres; head poses stand beside them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from pipeline.base.errors import InputError, listed
from pipeline.datasets.goliath_cameras import METRES_PER_UNIT
from pipeline.export.archives import write_zip
from pipeline.geometry.rotations import matrix_from_quaternion
from pipeline.geometry.skin import Template


def write_motion(root: Path, frames: Sequence[int], tracked: dict[str, np.ndarray], template: Template) -> None:
    """Write meshes and poses of those frames that have one; the set interpolates the others.

    The mean and the faces are the template's at rest.

    Args:
        tracked: frames, root_rotation (wxyz), root_translation and vertices (metres, world).

    Raises:
        InputError: if no frame has a mesh.
    """
    kept = [row for row, frame in enumerate(tracked["frames"].tolist()) if frame in set(frames)]
    if not kept:
        raise InputError(f"--tracking: expected meshes of frames {listed(frames)}, found none; track again")
    folder = root / "kinematic_tracking"
    write_zip(folder / "registration_vertices.zip", _meshes(tracked, kept))
    write_zip(root / "head_pose/head_pose.zip", _poses(tracked, kept))
    rest = template.vertices_rest / METRES_PER_UNIT
    np.save(folder / "registration_vertices_mean.npy", rest)
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in rest.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (template.faces + 1).tolist()]
    (folder / "template_mesh.obj").write_text("\n".join(lines) + "\n")


def _pose(tracked: dict[str, np.ndarray], row: int) -> tuple[Float64[np.ndarray, "3 3"], Float64[np.ndarray, " 3"]]:
    quaternion = tracked["root_rotation"][row].astype(np.float64)
    R = matrix_from_quaternion(quaternion / np.linalg.norm(quaternion))
    return R, tracked["root_translation"][row].astype(np.float64)


def _meshes(tracked: dict[str, np.ndarray], kept: Sequence[int]) -> Iterator[tuple[str, bytes]]:
    for row in kept:
        R, t = _pose(tracked, row)
        in_head = (tracked["vertices"][row].astype(np.float64) - t) @ R / METRES_PER_UNIT
        yield f"registration_vertices/{tracked['frames'][row]:06d}.ply", _ply(in_head)


def _poses(tracked: dict[str, np.ndarray], kept: Sequence[int]) -> Iterator[tuple[str, bytes]]:
    for row in kept:
        R, t = _pose(tracked, row)
        lines = np.concatenate([R, t[:, None] / METRES_PER_UNIT], 1).tolist()
        text = "\n".join(" ".join(map(repr, line)) for line in lines) + "\n"
        yield f"{tracked['frames'][row]:06d}.txt", text.encode()


def _ply(vertices: Float64[np.ndarray, "vertices 3"]) -> bytes:
    """Vertices alone, as the set has them."""
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz") + "end_header\n"
    return head.encode() + vertices.astype("<f4").tobytes()
