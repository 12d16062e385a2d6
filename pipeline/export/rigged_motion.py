"""Poses of a rigged template that track_mesh found, for formats that have skins.

A tracked vertex is the blend of its joints' transforms, applied to its place in the bind pose plus the frame's offset:
both are here, in metres.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from pipeline.base.errors import InputError, listed
from pipeline.base.files import read_arrays, read_json
from pipeline.geometry.kinematics import Pose
from pipeline.geometry.skin import Template
from pipeline.geometry.template_file import read_joint_names, read_template

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class RiggedMotion:
    """A rigged template and what moves it.

    Attributes:
        template: its vertices are in the order of the atlas.
        joint_names: of its joints, in the skin's order.
        frames: their numbers, in order.
        pose: of these frames.
        offsets: of vertices before skinning, metres; 0 where the pose alone was tracked.
    """

    template: Template
    joint_names: list[str]
    frames: list[int]
    pose: Pose
    offsets: Float64[np.ndarray, "frames vertices 3"]


def read_rigged_motion(
    capture: Path, index: Path, tracking: Sequence[Path], frames: Sequence[int]
) -> RiggedMotion | None:
    """Motion of these frames; None without joints.

    Neither a template without them has any, nor meshes that were tracked elsewhere.

    Args:
        capture: folder with the template.
        index: folder of index_capture, which says where in it.
        tracking: chunks of track_mesh.
        frames: numbers, in order.

    Raises:
        InputError: if a frame was not tracked.
    """
    described = read_json(index / "capture.json")["template"]
    path = capture / described["mesh"]
    if not path.is_file():
        log.warning("%s: no such template: the mesh moves by morph targets, without a skin", path)
        return None
    template = read_template(path, float(described["scale_to_m"]))
    chunks = [read_arrays(chunk) for chunk in tracking]
    if not template.rigged or not all("joint_rotations" in chunk for chunk in chunks):
        return None
    row_of = {
        number: (chunk, row) for chunk in chunks for row, number in enumerate(chunk["frames"].tolist())
    }  # fmt: skip
    if absent := [number for number in frames if number not in row_of]:
        raise InputError(f"--tracking: expected all frames of the shards, found none of {listed(absent)}; track again")

    def rows(name: str) -> np.ndarray:
        return np.stack([row_of[number][0][name][row_of[number][1]] for number in frames]).astype(np.float64)

    pose = Pose(rows("root_rotation"), rows("root_translation"), rows("joint_rotations"))
    return RiggedMotion(template, read_joint_names(path, template), list(frames), pose, rows("offsets"))
