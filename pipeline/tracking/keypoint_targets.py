"""Joints and vertices of a template that a detector's keypoints name; a check of its unit."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float64, Int64

from pipeline.base.errors import Complaints, InputError
from pipeline.geometry.skin import Template

LARGEST_SIZE_RATIO = 3.0
"""Measured over template bone length beyond which (or below whose inverse) the template's unit must be wrong: people
differ by a factor of two at most, units by ten or more (cm, inch: 39, mm)."""


@dataclass(frozen=True)
class KeypointTargets:
    """Name of each keypoint, and its joint or, where that is -1, its vertex.

    Joints are indices into the skin's joints.
    """

    names: tuple[str, ...]
    joints: Int64[np.ndarray, " keypoints"]
    vertices: Int64[np.ndarray, " keypoints"]


NO_TARGETS = KeypointTargets((), np.zeros(0, np.int64), np.zeros(0, np.int64))
"""Of a capture whose meshes were tracked elsewhere."""


def read_keypoint_targets(path: Path, template: Template) -> KeypointTargets:
    """Read a csv of `keypoint,node_index` or `keypoint,vertex`.

    Nodes are glTF nodes that are joints of the skin.
    Raises:
        InputError: naming every keypoint that is listed twice, or whose node or vertex the template does not have.
    """
    try:
        table = pd.read_csv(path)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: expected a csv table, found: {error}") from error
    columns = set(table.columns)
    if columns not in ({"keypoint", "node_index"}, {"keypoint", "vertex"}):
        found = ",".join(table.columns)
        raise InputError(f"{path}: columns: expected keypoint,node_index or keypoint,vertex, found {found}")
    complaints = Complaints(path)
    for name in table.keypoint[table.keypoint.duplicated()]:
        complaints.add(path, str(name), expected="one row", found="several", hint="delete all but one")
    numbers = table["vertex" if "vertex" in columns else "node_index"].to_numpy()
    names = tuple(str(name) for name in table.keypoint)
    if "vertex" in columns:
        count = len(template.vertices_rest)
        for name, number in zip(names, numbers, strict=True):
            if not 0 <= number < count:
                complaints.add(path, name, expected=f"a vertex below {count}", found=str(number))
        complaints.raise_if_any()
        return KeypointTargets(names, np.full(len(names), -1, np.int64), numbers.astype(np.int64))
    joint_of_node = {int(node): joint for joint, node in enumerate(template.joint_nodes)}
    for name, number in zip(names, numbers, strict=True):
        if number not in joint_of_node:
            complaints.add(path, name, expected=f"a joint's node, one of {sorted(joint_of_node)}", found=str(number))
    complaints.raise_if_any()
    joints = np.array([joint_of_node[int(number)] for number in numbers], np.int64)
    return KeypointTargets(names, joints, np.full(len(names), -1, np.int64))


def _neighbours(template: Template, targets: KeypointTargets) -> list[tuple[int, int]]:
    """Pairs of keypoints a fixed length apart.

    Joints are paired with their nearest ancestor that has a keypoint, vertices with all others.
    """
    if (targets.joints < 0).any():
        return [(a, b) for a in range(len(targets.names)) for b in range(a)]
    keypoint_of_joint = {int(joint): keypoint for keypoint, joint in enumerate(targets.joints)}
    pairs = []
    for joint, keypoint in keypoint_of_joint.items():
        above = int(template.parents[joint])
        while above >= 0 and above not in keypoint_of_joint:
            above = int(template.parents[above])
        if above >= 0:
            pairs.append((keypoint, keypoint_of_joint[above]))
    return pairs


def size_ratio(
    template: Template,
    targets: KeypointTargets,
    measured: Float64[np.ndarray, "frames keypoints 3"],
    rest: Float64[np.ndarray, "keypoints 3"],
) -> float:
    """Median of measured over template bone length; NaN if no bone was measured.

    Raises:
        InputError: if the ratio is so far from 1 that the template's unit must be wrong.
    """
    pairs = np.array(_neighbours(template, targets), np.int64).reshape(-1, 2)
    lengths = np.linalg.norm(measured[:, pairs[:, 0]] - measured[:, pairs[:, 1]], axis=-1)
    expected = np.linalg.norm(rest[pairs[:, 0]] - rest[pairs[:, 1]], axis=-1)
    ratios = (lengths / np.where(expected > 0, expected, np.nan)).ravel()
    ratios = ratios[np.isfinite(ratios)]
    if not len(ratios):
        return float("nan")
    ratio = float(np.median(ratios))
    if not 1 / LARGEST_SIZE_RATIO < ratio < LARGEST_SIZE_RATIO:
        raise InputError(
            f"template: scale_to_m: expected bones as long as the triangulated ones, found them {1 / ratio:.3g} times "
            f"as long; set template.scale_to_m in capture.yaml to about {template.scale_to_m * ratio:.3g} (now "
            f"{template.scale_to_m:g}), or check the unit of cameras.json"
        )
    return ratio
