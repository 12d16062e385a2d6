"""Nodes of a glTF file: the trees that they form, checked before anybody climbs them.

Source: Khronos glTF 2.0 specification, section 3.5 (nodes form disjoint strict trees).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.errors import Complaints, listed

TRANSFORMS = {"matrix": 16, "translation": 3, "rotation": 4, "scale": 3}
"""Keys of a node that place it, and how many numbers each has."""


def parents_of(nodes: Sequence[Any], path: Path) -> list[int]:
    """Index of each node's parent, or -1.

    Raises:
        InputError: if a child is no node or has two parents, nodes form a circle, a transform is not finite, or a
            rotation has no length.
    """
    complaints = Complaints(path)
    parents = [-1] * len(nodes)
    for index, node in enumerate(nodes):
        for child in node.children or []:
            if not 0 <= child < len(nodes):
                expected = f"nodes, 0 to {len(nodes) - 1}"
                complaints.add(path.name, f"nodes[{index}].children", expected=expected, found=str(child))
            elif parents[child] >= 0:
                found = f"{parents[child]} and {index}"
                complaints.add(path.name, f"nodes[{child}]", expected="one parent", found=found)
            else:
                parents[child] = index
        for key, count in TRANSFORMS.items():
            values = getattr(node, key)
            if values is not None and (len(values) != count or not np.isfinite(np.asarray(values, np.float64)).all()):
                expected = f"{count} finite numbers"
                complaints.add(path.name, f"nodes[{index}].{key}", expected=expected, found=listed(values, count))
            elif key == "rotation" and values is not None and not np.any(values):
                found = listed([f"{value:g}" for value in values])
                complaints.add(path.name, f"nodes[{index}].{key}", expected="a unit quaternion", found=found)
    if circle := [index for index in range(len(nodes)) if _climbs_for_ever(index, parents)]:
        found = f"circles below or through nodes {listed(circle)}"
        complaints.add(path.name, "nodes.children", expected="trees", found=found, hint="export the template anew")
    complaints.raise_if_any()
    return parents


def _climbs_for_ever(index: int, parents: Sequence[int]) -> bool:
    for _ in parents:
        index = parents[index]
        if index < 0:
            return False
    return bool(parents)
