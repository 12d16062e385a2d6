"""Joints that bend about one axis and one way only, as elbows and knees do.

They tell the twist of a round limb, which neither keypoints nor outlines do.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from pipeline.base.errors import Complaints, listed
from pipeline.config.track_mesh import Axis
from pipeline.geometry.skin import Template
from pipeline.geometry.template_file import read_joint_names


def hinge_axes(hinges: Mapping[str, Axis], path: Path, template: Template) -> Float64[np.ndarray, "joints 3"] | None:
    """Axis of each joint that is a hinge, in the joint's frame; 0 where it is free. None if there is no hinge.

    Args:
        hinges: joint, by the name of its node -> axis.
        path: the template's file, which has the names.
        template: what was read of it.

    Raises:
        InputError: naming every hinge that is no joint of the template.
    """
    if not hinges:
        return None
    complaints, names = Complaints(path), read_joint_names(path, template)
    axes = np.zeros((len(names), 3))
    for name, axis in hinges.items():
        if name in names:
            axes[names.index(name), "xyz".index(axis[-1])] = -1.0 if axis.startswith("negative") else 1.0
        else:
            known = listed(names, 30) if names else "none, as the template has no skin"
            complaints.add(path, f"track_mesh.hinges.{name}", expected=f"a joint: {known}", found="no such joint")
    complaints.raise_if_any()
    return axes
