"""Animation of the figure: two takes, smooth in time.

The arms pass in front of the torso and shadow it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.spatial.transform
from jaxtyping import Float64

from pipeline.synthesis.skeleton import Skeleton

PERIOD_S = 1.6
"""Duration of one stride or wave: an unhurried walk."""


@dataclass(frozen=True)
class Pose:
    """Local joint rotations, and displacement of the root from its rest position.

    Rotations are unit quaternions, wxyz; the displacement is in metres.
    """

    rotations: Float64[np.ndarray, "joints 4"]
    root_translation: Float64[np.ndarray, "3"]


def pose_at(skeleton: Skeleton, time_s: float, segment: str, floor_y: float) -> Pose:
    """Pose at a time within segment `a` or `b`.

    Segment `a` strides with swinging, folding arms; `b` reaches and turns. `floor_y` is the height of the ground in the
    stage frame, metres.
    """
    phase = 2 * np.pi * time_s / PERIOD_S
    angles = _stride(phase) if segment == "a" else _reach(phase)
    euler = np.zeros((len(skeleton.names), 3))
    for joint, degrees in angles.items():
        euler[skeleton.index(joint)] = degrees
    # Extrinsic x, then z, then y: bend and raise a limb first, then swing it about the vertical.
    rotations = scipy.spatial.transform.Rotation.from_euler("xzy", euler[:, [0, 2, 1]], degrees=True)
    sway = np.array([0.03 * np.sin(phase), floor_y + 0.012 * np.cos(2 * phase), 0.025 * np.cos(phase)])
    return Pose(rotations.as_quat(scalar_first=True), sway)


def _stride(phase: float) -> dict[str, tuple[float, float, float]]:
    """Degrees about x, y, z per joint of a stride.

    Left and right are half a period apart, arms fold across the chest in turn.
    """
    angles = {
        "pelvis": (0.0, 10 * np.sin(phase), 2 * np.sin(phase)),
        "spine": (4.0, -6 * np.sin(phase), 0.0),
        "chest": (3.0, -8 * np.sin(phase), 0.0),
        "neck": (4 * np.sin(2 * phase), 6 * np.sin(phase + 0.5), 0.0),
        "head": (0.0, 12 * np.sin(phase + 0.8), 4 * np.cos(phase)),
    }
    for side, sign, offset in (("l", 1.0, 0.0), ("r", -1.0, np.pi)):
        swing = 0.5 - 0.5 * np.cos(phase + offset)  # 0: at the side, 1: in front of the chest
        lift = np.sin(phase + offset)
        angles |= {
            f"upper_arm_{side}": (0.0, -sign * (5 + 65 * swing), -sign * (32 - 30 * swing)),
            f"forearm_{side}": (0.0, -sign * (12 + 68 * swing), sign * 8 * swing),
            f"hand_{side}": (0.0, -sign * 10 * swing, sign * 8 * lift),
            f"thigh_{side}": (-10 - 20 * lift, 0.0, 0.0),
            f"shin_{side}": (22 + 20 * np.sin(phase + offset - 0.9), 0.0, 0.0),
            f"foot_{side}": (-8 + 6 * lift, 0.0, 0.0),
        }
    return angles


def _reach(phase: float) -> dict[str, tuple[float, float, float]]:
    """Degrees about x, y, z per joint of reaching and turning.

    One arm reaches up and forward, the other across the belly; then they change.
    """
    angles = {
        "pelvis": (0.0, 14 * np.cos(phase), 0.0),
        "spine": (6.0, 8 * np.cos(phase), 5 * np.sin(phase)),
        "chest": (2.0, 8 * np.cos(phase), 5 * np.sin(phase)),
        "neck": (6 * np.sin(phase), 8 * np.cos(phase), 0.0),
        "head": (5 * np.sin(phase), 10 * np.cos(phase), 0.0),
    }
    for side, sign, offset in (("l", 1.0, 0.6), ("r", -1.0, np.pi + 0.6)):
        reach = 0.5 + 0.5 * np.sin(phase + offset)
        bend = 0.5 - 0.5 * np.sin(phase + offset)
        angles |= {
            f"upper_arm_{side}": (0.0, -sign * (62 + 8 * bend), sign * (58 * reach - 12)),
            f"forearm_{side}": (0.0, -sign * (56 + 29 * bend), sign * 15 * reach),
            f"hand_{side}": (0.0, -sign * 12 * bend, sign * 10 * np.cos(phase)),
            f"thigh_{side}": (-14 - 8 * np.sin(phase + offset), 0.0, sign * 4),
            f"shin_{side}": (26 + 12 * np.sin(phase + offset), 0.0, 0.0),
            f"foot_{side}": (-11.0, 0.0, 0.0),
        }
    return angles
