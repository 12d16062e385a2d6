"""Procedural albedo of the head.

Skin has freckles, cropped hair, brows, lips and stubble, eyes have iris and pupil. A function of the rest position like
the figure's, baked into a texture that only the renderer sees.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float32, Float64
from scipy.spatial import cKDTree

from pipeline.base.seeds import generator_for
from pipeline.synthesis.appearance import mottle
from pipeline.synthesis.eyeball import radius_along
from pipeline.synthesis.head_shape import MOUTH_CENTER_M

SKIN = np.array([0.56, 0.33, 0.23])
BLUSH = np.array([0.60, 0.24, 0.19])
STUBBLE = np.array([0.36, 0.23, 0.18])
HAIR = np.array([0.09, 0.055, 0.035])
LIPS = np.array([0.46, 0.13, 0.13])
MOUTH = np.array([0.12, 0.02, 0.02])
FRECKLE = np.array([0.30, 0.13, 0.07])
SCLERA = np.array([0.75, 0.72, 0.70])
IRIS = np.array([0.10, 0.22, 0.30])
PUPIL = np.array([0.012, 0.012, 0.012])

IRIS_M, PUPIL_M = 0.0053, 0.0022
"""Radius of iris and pupil, measured from the eye's axis.

The iris ends within the cornea, which it is painted on.
"""

MOTTLE_M, MOTTLE = 0.008, 0.14
"""Shortest wavelength and standard deviation of the skin's brightness variation."""

FRECKLES = 420
FRECKLE_RADII_M = (0.0012, 0.0038)


def skin_albedo(
    points: Float64[np.ndarray, "n 3"], surface: Float64[np.ndarray, "v 3"], subject: str
) -> Float32[np.ndarray, "n 3"]:
    """Linear albedo at rest positions; freckles lie at random vertices of the rest `surface`."""
    x, y, z = points.T
    side = np.abs(x)
    color = np.tile(SKIN, (len(points), 1))

    def blend(target: np.ndarray, share: np.ndarray) -> None:
        color[:] += share[:, None] * (target - color)

    blend(BLUSH, 0.7 * _blob(points, (0.043, -0.020, 0.066), 0.015) + 0.6 * _blob(points, (0.0, -0.022, 0.112), 0.010))
    beard = _edge(-0.036 - y, 0.006) * _edge(z - 0.005, 0.012) * _edge(y + 0.115, 0.008)
    blend(STUBBLE, 0.45 * beard)
    blend(FRECKLE, 0.8 * _freckles(points, surface, subject))
    blend(HAIR, hair_share(points))
    along_brow, across_brow = side - 0.029, y - 0.034 + 0.06 * (side - 0.030)
    brow = _edge(0.0045 - np.abs(across_brow), 0.0012) * _edge(0.017 - np.abs(along_brow), 0.003)
    blend(HAIR, brow * _edge(z - 0.04, 0.004))
    lips = 1.0 - np.hypot((x - MOUTH_CENTER_M[0]) / 0.025, (y - MOUTH_CENTER_M[1]) / 0.0155)
    in_front = _edge(z - 0.068, 0.002)
    blend(LIPS, _edge(lips, 0.06) * in_front)
    slot = 1.0 - np.hypot(x / 0.022, (y - MOUTH_CENTER_M[1]) / 0.0055)
    blend(MOUTH, _edge(slot, 0.15) * _edge(0.080 - z, 0.002) * _edge(z - 0.05, 0.004))
    return (color * mottle(points, subject, MOTTLE_M, MOTTLE)[:, None]).clip(0.01, 0.9).astype(np.float32)


def hair_share(points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, " n"]:
    """Share of the skin at rest positions that is covered by hair, brows and beard apart."""
    x, y, z = points.T
    ears = _edge(np.abs(x) - 0.068, 0.002) * _edge(0.034 - np.abs(y), 0.004)
    hair_line = y - 0.075 + 0.9 * np.maximum(0.045 - z, 0) - 0.25 * z
    return _edge(hair_line, 0.006) * (1 - ears) * _edge(y + 0.075, 0.010)


def eye_albedo(directions: Float64[np.ndarray, "n 3"]) -> Float32[np.ndarray, "n 3"]:
    """Linear albedo of an eyeball in unit directions from its centre, pupil towards +z."""
    from_axis = radius_along(directions) * np.hypot(directions[:, 0], directions[:, 1])
    around = np.arctan2(directions[:, 1], directions[:, 0])
    front = directions[:, 2] > 0
    color = np.tile(SCLERA, (len(directions), 1))
    streaks = 1.0 + 0.25 * np.sin(11 * around) + 0.15 * np.sin(23 * around + 1.0)
    iris = front & (from_axis < IRIS_M)
    color[iris] = (IRIS * streaks[:, None])[iris]
    color[front & (from_axis < PUPIL_M)] = PUPIL
    return color.astype(np.float32)


def _edge(signed: np.ndarray, width: float) -> np.ndarray:
    """Share of a region whose signed distance (positive inside) is given, soft over `width`."""
    return 1 / (1 + np.exp(np.clip(-signed / width, -40, 40)))


def _blob(points: np.ndarray, center: tuple[float, float, float], width: float) -> np.ndarray:
    mirrored = np.stack([np.abs(points[:, 0]), points[:, 1], points[:, 2]], axis=1)
    return np.exp(-0.5 * ((mirrored - center) ** 2).sum(axis=1) / width**2)


def _freckles(points: np.ndarray, surface: np.ndarray, subject: str) -> np.ndarray:
    random = generator_for(subject, "freckles")
    centers = surface[random.integers(len(surface), size=FRECKLES)]
    radii = random.uniform(*FRECKLE_RADII_M, FRECKLES)
    distance, nearest = cKDTree(centers).query(points)
    return _edge(radii[nearest] - distance, 0.0004)
