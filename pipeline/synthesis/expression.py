"""Motion of the procedural head: expressions, turns, and gaze.

Expressions are smooth displacement fields of the rest shape. They are written apart from `pipeline.geometry` on
purpose, and are of no form that a tracker assumes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.spatial.transform
from jaxtyping import Float64

from pipeline.synthesis.head_shape import MOUTH_CENTER_M

PERIOD_S = 1.8
"""Duration of one turn of the head to either side and back."""

JAW_HINGE_M = np.array([0.0, -0.012, -0.008])
"""A point of the jaw's axis, which runs from ear to ear."""

LIP_BLEND_M, CHEEK_BLEND_M = 0.0015, 0.022
"""Width of the band in which skin goes from still to moving with the jaw.

The first holds between the lips, the second from the corners of the mouth on.
"""


@dataclass(frozen=True)
class Bump:
    """A displacement (metres) that falls off as a Gaussian, mirrored to the other side.

    Attributes:
        center: of the displacement on the left side, metres in the rest shape.
        displacement: at the center, metres.
        width_m: standard deviation of the Gaussian.
    """

    center: tuple[float, float, float]
    displacement: tuple[float, float, float]
    width_m: float


BUMPS = {
    "smile": [
        Bump((0.024, -0.053, 0.078), (0.007, 0.006, -0.004), 0.016),
        Bump((0.043, -0.022, 0.066), (0.001, 0.004, 0.004), 0.018),
    ],
    "brows": [Bump((0.028, 0.032, 0.078), (0.0, 0.008, 0.001), 0.014)],
    "frown": [Bump((0.014, 0.030, 0.082), (-0.003, -0.004, 0.001), 0.011)],
    "puff": [Bump((0.043, -0.052, 0.052), (0.007, 0.0, 0.005), 0.018)],
}


@dataclass(frozen=True)
class Performance:
    """Expression, pose and gaze of the head at one time.

    Attributes:
        jaw_deg: opening of the jaw; negative closes lips that rest a little open.
        strengths: of the bumps, by name; 1 is the full displacement.
        turn: head from its rest orientation, about the origin between the ears.
        shift_m: of that origin in the stage frame.
        gaze: eyeballs from straight ahead, in the head's frame; both alike, as for something far away.
    """

    jaw_deg: float
    strengths: dict[str, float]
    turn: scipy.spatial.transform.Rotation
    shift_m: Float64[np.ndarray, " 3"]
    gaze: scipy.spatial.transform.Rotation


def performance_at(time_s: float, segment: str) -> Performance:
    """Performance of segment `a` or `b` at a time.

    Segment `a` goes through the range of every expression while it talks and the head turns, as captures for avatars
    do; segment `b` smiles, frowns and puffs its cheeks together, in ways that `a` does not, while the head nods.
    """
    phase = 2 * np.pi * time_s / PERIOD_S
    rise = 0.5 - 0.5 * np.cos(phase)  # 0 at the start and after a period
    if segment == "a":
        jaw_deg = -2.0 + 9.0 * (0.5 - 0.5 * np.cos(2 * phase + 0.4))
        strengths = {
            "smile": 0.5 - 0.5 * np.cos(1.5 * phase), "brows": np.sin(phase + 0.5),
            "frown": 0.4 - 0.4 * np.cos(2.5 * phase), "puff": 0.5 - 0.5 * np.cos(2 * phase + 2.6),
        }  # fmt: skip
        yaw, pitch, roll = 25 * np.sin(phase), 6 * np.sin(2 * phase), 4 * np.cos(phase)
        look = (16 * np.sin(phase + 2.2), 7 * np.cos(phase))
    else:
        jaw_deg = -2.0 + 4.0 * rise
        strengths = {
            "smile": 0.5 - 0.5 * np.cos(phase + 0.8), "brows": 0.0, "frown": 0.8 * rise,
            "puff": 0.5 + 0.5 * np.sin(phase),
        }  # fmt: skip
        yaw, pitch, roll = 14 * np.cos(phase), 12 * np.sin(phase), 6 * np.sin(phase)
        look = (15 * np.cos(phase), 8 * np.sin(phase))
    rotation = scipy.spatial.transform.Rotation
    return Performance(
        jaw_deg=float(jaw_deg),
        strengths={name: float(strength) for name, strength in strengths.items()},
        turn=rotation.from_euler("YXZ", [yaw, pitch, roll], degrees=True),
        shift_m=np.array([0.012 * np.sin(phase), 0.02 + 0.006 * np.sin(2 * phase), 0.010 * np.cos(phase)]),
        gaze=rotation.from_euler("YX", look, degrees=True),
    )


def displaced(points: Float64[np.ndarray, "n 3"], performance: Performance) -> Float64[np.ndarray, "n 3"]:
    """Skin points of the rest shape under an expression, in the head's frame.

    Eyeballs and skull do not move.
    """
    moved = points + _jaw_share(points)[:, None] * _jaw_motion(points, performance.jaw_deg)
    for name, strength in performance.strengths.items():
        for bump in BUMPS[name]:
            for side in (1.0, -1.0):
                mirror = np.array([side, 1.0, 1.0])
                squared = ((points - mirror * bump.center) ** 2).sum(axis=1)
                fall = np.exp(-0.5 * squared / bump.width_m**2)
                moved = moved + strength * fall[:, None] * (mirror * bump.displacement)
    return moved


def _jaw_motion(points: np.ndarray, degrees: float) -> np.ndarray:
    turn = scipy.spatial.transform.Rotation.from_euler("x", degrees, degrees=True)
    return turn.apply(points - JAW_HINGE_M) - (points - JAW_HINGE_M)


def _jaw_share(points: np.ndarray) -> np.ndarray:
    """Share of the jaw's motion that each point takes part in, [n].

    It is 1 below the mouth, 0 above and behind.
    """
    from_mouth = np.hypot(points[:, 0] / 0.024, (points[:, 2] - MOUTH_CENTER_M[2]) / 0.024)
    blend = LIP_BLEND_M + (CHEEK_BLEND_M - LIP_BLEND_M) * _smooth_step(from_mouth, 0.6, 2.0)
    below = _smooth_step((MOUTH_CENTER_M[1] - points[:, 1]) / blend, -1.0, 1.0)
    in_front = _smooth_step(points[:, 2], -0.015, 0.035)
    return below * in_front * _smooth_step(points[:, 1], -0.135, -0.10)


def _smooth_step(x: np.ndarray, low: float, high: float) -> np.ndarray:
    t = np.clip((x - low) / (high - low), 0.0, 1.0)
    return t * t * (3 - 2 * t)
