"""Joints that bend about one axis and one way only, as elbows and knees do.

They tell the twist of a round limb, which neither keypoints nor outlines do.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from pipeline.base.errors import Complaints, listed
from pipeline.config.track_mesh import Axis
from pipeline.geometry.kinematics import Pose
from pipeline.geometry.rotations import multiply_quaternions, quaternion_from_rotation_vector

START_BEND_RAD = 0.5
"""Bend of a hinge where a fit begins: of a straight limb, nothing says to which side it is going to bend."""


def hinge_axes(
    hinges: Mapping[str, Axis], joint_names: Sequence[str], template: Path
) -> Float64[np.ndarray, "joints 3"] | None:
    """Axis of each joint that is a hinge, in the joint's frame; 0 where it is free.

    Args:
        hinges: joint -> axis.
        joint_names: in the skin's order; none of a template without a skin.
        template: path of the file, for messages.

    Returns:
        None if there is no hinge.

    Raises:
        InputError: naming every hinge that is no joint of the template.
    """
    if not hinges:
        return None
    complaints = Complaints(template)
    axes = np.zeros((len(joint_names), 3))
    for name, axis in hinges.items():
        if name in joint_names:
            axes[list(joint_names).index(name), "xyz".index(axis[-1])] = -1.0 if axis.startswith("negative") else 1.0
        else:
            known = listed(list(joint_names), 30) if joint_names else "none, as the template has no skin"
            complaints.add(template, f"track_mesh.hinges.{name}", expected=f"a joint: {known}", found="no such joint")
    complaints.raise_if_any()
    return axes


def with_bent_hinges(pose: Pose, axes: Float64[np.ndarray, "joints 3"] | None) -> Pose:
    """A pose whose hinges are bent by `START_BEND_RAD` more."""
    if axes is None:
        return pose
    bend = quaternion_from_rotation_vector(START_BEND_RAD * axes)
    return replace(pose, joint_rotations=multiply_quaternions(pose.joint_rotations, bend))
