"""Parts of a template's surface by name: those that are labelled, and a rigged head."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Int64

from pipeline.geometry.skin import Template
from pipeline.geometry.texels import HEAD

MOST_OF_IT = 0.5
"""Share of a vertex's weights above which no other part of the body moves it more."""


def read_regions(path: Path) -> dict[str, Int64[np.ndarray, " _"]]:
    """Vertices of each region of a csv of `region,vertex`, which index_capture has checked."""
    table = pd.read_csv(path)
    return {str(name): np.sort(rows.vertex.to_numpy(np.int64)) for name, rows in table.groupby("region")}


def head_of_skin(template: Template, keypoints: Path | None) -> dict[str, Int64[np.ndarray, " _"]]:
    """Vertices that the joint of the keypoint `head` and those below it move most.

    Nothing without such a joint.

    Args:
        keypoints: csv of `keypoint,node_index`, which index_capture has checked.
    """
    table = None if keypoints is None else pd.read_csv(keypoints)
    if table is None or "node_index" not in table or not template.rigged:
        return {}
    nodes = table.node_index[table.keypoint.astype(str).str.lower() == HEAD]
    above = np.isin(template.joint_nodes, nodes)
    for _ in range(len(above)):  # a skeleton is no deeper than it has joints
        above = above | ((template.parents >= 0) & above[template.parents])
    inside = np.flatnonzero(template.weights[:, above].sum(1) > MOST_OF_IT)
    return {HEAD: inside} if len(inside) else {}
