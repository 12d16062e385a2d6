"""Brightness and places of the lights, refined on training images with the avatar as it is.

Light adds up: a picture of a frame is the sum of pictures in the light of each of its lights alone. So the factors by
which lights should be brighter are a linear least-squares problem, which needs no gradient of the renderer; how a
picture changes as its light moves follows from the surface behind its pixels. The images are dealt into two halves;
where changes fitted to one half do not bring down the error of the other, the calibration is left as it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float64

from pipeline.avatar.frames.light_gains import LightGains
from pipeline.avatar.training.picture_equations import TIGHTER, PictureEquations, Sigma
from pipeline.avatar.training.seen_surface import SeenSurface

LEAST_COSINE = 0.1
"""Of the angle between a normal and the way to the light, from which on it is said how brightness changes as the light
moves: it goes as one over this, and normals of the mesh are off by a few degrees."""

LEAST_SHARE = 0.005
"""Share of the squared errors that other places of lights, or of cameras, have to take away from images that had no
part in finding them: 0.02 dB, by which two trainings differ that began otherwise. Less is not worth another
calibration than all other stages have."""


LEAST_APART = 1e-4
"""Of the eigenvalues of how alike lights' pictures are, 1 each if they have nothing in common. Of two lights whose
pictures differ by 1.4 % of their brightness, the smaller one is 1e-4."""


@dataclass(frozen=True)
class Sigmas:
    """Typical errors of what is refined; 0: it is not.

    Attributes:
        gain: of lights' brightness, relative.
        light_m: of lights' places along each axis, metres.
        turn: of cameras about each axis, radians.
        shift_m: of cameras' places along each axis, metres.
    """

    gain: float = 0.0
    light_m: float = 0.0
    turn: float = 0.0
    shift_m: float = 0.0


FIXED = 1e-9
"""Error of what does not change: far below all that could be seen."""


def changes_by_moving(
    part: Float[np.ndarray, "pixels 3"], surface: SeenSurface, subject: np.ndarray, light: Float64[np.ndarray, " 3"],
    R: Float64[np.ndarray, "3 3"],
) -> Float64[np.ndarray, "3 pixels 3"]:  # fmt: skip
    """Changes of a picture per metre that its only light moves along each axis of the world.

    Of E ~ n.d / |d|^3 with d from the surface to the light: dE / E = n / n.d - 3 d / |d|^2. Zero where the surface is
    not seen well, or almost turned away from the light.

    Args:
        part: linear RGB of the subject's pixels in its light.
        subject: which pixels of the image these are.
        light: where it is, in the camera's frame.
        R: camera from world.
    """
    way = light - surface.points[subject]
    distance = np.linalg.norm(way, axis=1)
    normals = surface.normals[subject]
    along = (normals * way).sum(1)
    known = surface.seen[subject] & (along > LEAST_COSINE * distance)
    along = np.where(known, along, 1.0)
    relative = np.where(known[:, None], normals / along[:, None] - 3 * way / np.square(distance)[:, None], 0.0)
    return (relative @ R).T[:, :, None] * part


def assembled(
    lights: Sequence[np.ndarray], equations: Sequence[PictureEquations], each: int = 1
) -> tuple[np.ndarray, PictureEquations]:
    """Places of all lights, and their equations from those of frames that some light.

    Args:
        lights: places of the lights of each frame.
        equations: of each frame: first factors, then, if `each` is 4, the three axes of each light.
        each: unknowns per light.
    """
    places = np.unique(np.concatenate(lights), axis=0)
    number = {place.tobytes(): i for i, place in enumerate(places)}
    together = PictureEquations.none(each * len(places))
    for positions, of_frame in zip(lights, equations, strict=True):
        lit = np.array([number[place.tobytes()] for place in positions])
        axes = len(places) + (3 * lit[:, None] + np.arange(3)).ravel()
        which = np.concatenate([lit, axes])[: each * len(lit)]
        for half in range(2):
            together.add(half, of_frame.matrix[half], of_frame.vector[half], of_frame.errors[half], which.tolist())
    return places, together


def tightest_that_foretells(equations: PictureEquations, sigmas: Sequence[Sigma]) -> tuple[float, Sigma]:
    """The squared errors that halves best foretell of each other, and the prior for it.

    Errors of the avatar look like those of a calibration when seen by a few cameras only: then a tight prior is best.
    """
    foretold = [equations.foretold(tried) for tried in sigmas]
    best = int(np.argmax(foretold))
    return foretold[best], sigmas[best]


def told_apart(equations: PictureEquations) -> int:
    """Number of lights that images tell apart.

    Not among them are those that no image shows, nor any whose light is as another's.

    Args:
        equations: of the lights' factors alone.
    """
    matrix = equations.matrix.sum(0)
    size = np.sqrt(np.diag(matrix))
    shown = size > 0
    alike = matrix[np.ix_(shown, shown)] / np.outer(size[shown], size[shown])
    return int((np.linalg.eigvalsh(alike) > LEAST_APART).sum())


def refined_gains(
    places: np.ndarray, equations: PictureEquations, gains: LightGains, sigmas: Sigmas
) -> tuple[LightGains, float, float]:
    """Gains times what both halves of the images say, and the squared errors that each foretold.

    Of the factors first, then by how much more with the places. The gains stay as they were, if nothing is foretold;
    places stay, if it is little.

    Args:
        places: of the lights.
        equations: of factors, and of places behind them if these are refined.
        gains: those that the frames were lit with.
        sigmas: typical changes to expect.
    """
    lights, gained, sigma = len(places), 0.0, FIXED
    if sigmas.gain:
        only = equations.of(slice(lights))
        gained, sigma = tightest_that_foretells(only, [sigmas.gain / divisor for divisor in TIGHTER])
        gained, sigma = (gained, sigma) if gained > 0 else (gained, FIXED)
    moved = 0.0
    if sigmas.light_m:
        both = [np.repeat([sigma, sigmas.light_m / divisor], [lights, 3 * lights]) for divisor in TIGHTER]
        moved, joint = tightest_that_foretells(equations, both)
        moved -= max(gained, 0.0)
    if moved > LEAST_SHARE * equations.errors.sum():
        found = equations.solve([0, 1], joint)
        offsets = gains.moved(places) - places + found[lights:].reshape(-1, 3)
    elif gained > 0:
        found = equations.of(slice(lights)).solve([0, 1], sigma)
        offsets = gains.moved(places) - places
    else:
        return gains, gained, moved
    factors = gains.of(places) * (1 + found[:lights])
    moves = offsets.astype(np.float32) if offsets.any() else None
    return LightGains(places, factors.astype(np.float32), moves), gained, moved
