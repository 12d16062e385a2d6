"""Joints of the procedural figure, and the round cones that make up its body.

In metres: y up, facing +z, left is +x.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

_MIDLINE = {
    "pelvis": (None, (0.0, 0.93, 0.0)),
    "spine": ("pelvis", (0.0, 1.05, 0.0)),
    "chest": ("spine", (0.0, 1.22, 0.0)),
    "neck": ("chest", (0.0, 1.43, -0.01)),
    "head": ("neck", (0.0, 1.53, 0.0)),
    "head_top": ("head", (0.0, 1.74, 0.01)),
}
_LEFT = {
    "upper_arm": ("chest", (0.185, 1.385, -0.01)),
    "forearm": ("upper_arm", (0.395, 1.205, -0.01)),
    "hand": ("forearm", (0.585, 1.045, 0.0)),
    "fingertip": ("hand", (0.71, 0.935, 0.0)),
    "thigh": ("pelvis", (0.10, 0.89, 0.0)),
    "shin": ("thigh", (0.135, 0.49, 0.01)),
    "foot": ("shin", (0.155, 0.085, -0.02)),
    "toe": ("foot", (0.17, 0.03, 0.17)),
}


@dataclass(frozen=True)
class Skeleton:
    """Joints in an order in which parents come first.

    Attributes:
        names: joint names.
        parents: index of each joint's parent, -1 for the root.
        positions: rest positions in metres; every rest rotation is the identity.
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    positions: Float64[np.ndarray, "joints 3"]

    def index(self, name: str) -> int:
        """Index of a joint by name."""
        return self.names.index(name)


@dataclass(frozen=True)
class RoundCone:
    """Solid swept by a sphere whose radius changes linearly from `start` to `end`.

    It is squeezed in z by `flatten`.
    """

    joint: str
    start: tuple[float, float, float]
    end: tuple[float, float, float]
    start_radius: float
    end_radius: float
    flatten: float = 1.0


def mirrored(point: tuple[float, float, float]) -> tuple[float, float, float]:
    """The point's mirror image in x, from the left side of the body to the right."""
    return (-point[0], point[1], point[2])


def human_skeleton() -> Skeleton:
    """22 joints: five along the midline, eight on either side, and the top of the head."""
    table = dict(_MIDLINE)
    for side, mirror in (("l", False), ("r", True)):
        for name, (parent, position) in _LEFT.items():
            parent_name = parent if parent in _MIDLINE else f"{parent}_{side}"
            table[f"{name}_{side}"] = (parent_name, mirrored(position) if mirror else position)
    names = tuple(table)
    parents = tuple(-1 if parent is None else names.index(parent) for parent, _ in table.values())
    return Skeleton(names, parents, np.array([position for _, position in table.values()], dtype=np.float64))


def human_solids() -> list[RoundCone]:
    """The body as round cones, each owned by the joint that moves it."""
    at = {name: position for name, (_, position) in _MIDLINE.items()}
    solids = [
        RoundCone("pelvis", (-0.075, 0.93, 0.0), (0.075, 0.93, 0.0), 0.115, 0.115, 0.85),
        RoundCone("spine", at["spine"], (0.0, 1.16, 0.0), 0.125, 0.125, 0.8),
        RoundCone("chest", (-0.085, 1.27, 0.0), (0.085, 1.27, 0.0), 0.125, 0.125, 0.8),
        RoundCone("chest", (-0.14, 1.375, -0.01), (0.14, 1.375, -0.01), 0.065, 0.065),
        RoundCone("neck", at["neck"], at["head"], 0.055, 0.05),
        RoundCone("head", (0.0, 1.575, 0.012), (0.0, 1.64, 0.0), 0.085, 0.105),
        RoundCone("head", (0.0, 1.60, 0.10), (0.0, 1.575, 0.118), 0.014, 0.02),
    ]
    left = {name: position for name, (_, position) in _LEFT.items()}
    limbs = [
        ("upper_arm", left["upper_arm"], left["forearm"], 0.056, 0.042, 1.0),
        ("forearm", left["forearm"], left["hand"], 0.043, 0.031, 1.0),
        ("hand", left["hand"], (0.675, 0.967, 0.0), 0.034, 0.042, 0.8),
        ("thigh", left["thigh"], left["shin"], 0.088, 0.06, 1.0),
        ("shin", left["shin"], left["foot"], 0.06, 0.04, 1.0),
        ("foot", (0.155, 0.05, -0.04), (0.168, 0.04, 0.13), 0.048, 0.04, 1.0),
    ]
    for joint, start, end, start_radius, end_radius, flatten in limbs:
        solids.append(RoundCone(f"{joint}_l", start, end, start_radius, end_radius, flatten))
        solids.append(RoundCone(f"{joint}_r", mirrored(start), mirrored(end), start_radius, end_radius, flatten))
    return solids
