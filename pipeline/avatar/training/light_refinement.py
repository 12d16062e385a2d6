"""Brightness of the lights, refined on training images with the avatar as it is.

Light adds up: a picture of a frame is the sum of pictures in the light of each of its lights alone. So the factors by
which lights should be brighter are a linear least-squares problem, which needs no gradient of the renderer. The images
are dealt into two halves; where factors fitted to one half do not bring down the error of the other, the calibration
is left as it is.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
import torch
from jaxtyping import Float, Float64

from pipeline.avatar.frames.frame_stream import FrameStream
from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.frames.light_gains import LightGains
from pipeline.avatar.model import Avatar
from pipeline.avatar.training.checkpoint import camera_view
from pipeline.avatar.training.distributed import Processes
from pipeline.base.spread import evenly
from pipeline.capture.records import ImageRecord

log = logging.getLogger("train_avatar")

MOST_LIGHTS, MOST_PARTS, IMAGES_PER_FRAME = 64, 512, 6
"""What is looked at: partially lit frames of at most so many lights, so many lights of frames together, and some images
of each frame. Every light of a frame is a picture of each of its images: time is theirs."""

DARK = 0.02
"""Linear RGB added to a pixel before errors are taken relative to its root: near black, noise does not fall further."""

SATURATED = 0.98
"""Linear RGB from which a captured pixel may have been cut off."""

REDUNDANCY = 25.0
"""Pixels that count as one: neighbours share a texel, a shadow's edge, a highlight."""

TIGHTER = (1, 2, 4, 8, 16, 32)
"""How much tighter than stated the priors are that are tried."""

CAUCHY = 3.0
"""Residuals of so many standard deviations count half."""

NORMAL_MAD = 1.4826
"""Standard deviation of normal numbers over the median of their absolute values."""


@dataclass(frozen=True)
class LightEquations:
    """Normal equations of the changes of lights' factors, of each half of the images.

    Attributes:
        matrix: A, of both halves.
        vector: b: the error of a half is lower by 2 x.b - x.A x for changes x.
    """

    matrix: Float64[np.ndarray, "2 lights lights"]
    vector: Float64[np.ndarray, "2 lights"]

    def solve(self, halves: Sequence[int], sigma: float) -> Float64[np.ndarray, " lights"]:
        """Changes that fit the given halves, of which `sigma` is expected."""
        matrix, vector = self.matrix[list(halves)].sum(0), self.vector[list(halves)].sum(0)
        return np.linalg.solve(matrix + np.eye(len(vector)) / sigma**2, vector)

    def gain(self, changes: Float64[np.ndarray, " lights"], half: int) -> float:
        """Squared errors of a half that changes of the factors take away."""
        return float(2 * changes @ self.vector[half] - changes @ self.matrix[half] @ changes)


def frame_equations(
    parts: Float[np.ndarray, "lights pixels 3"], captured: Float[np.ndarray, "pixels 3"]
) -> tuple[Float64[np.ndarray, "lights lights"], Float64[np.ndarray, " lights"]]:
    """Normal equations of one image.

    Args:
        parts: linear RGB of the subject's pixels in the light of each light.
        captured: what the camera saw there.
    """
    rows = parts.reshape(len(parts), -1).astype(np.float64)
    seen, expected = captured.reshape(-1).astype(np.float64), rows.sum(0)
    rows, seen, expected = (array[..., seen < SATURATED] for array in (rows, seen, expected))
    scale = 1 / np.sqrt(DARK + expected.clip(0))  # The sRGB curve and photon noise both go about as the root.
    rows, residual = rows * scale, (seen - expected) * scale
    deviation = NORMAL_MAD * np.median(np.abs(residual)) if residual.size else 0.0
    if not deviation > 0:
        return np.zeros((len(parts), len(parts))), np.zeros(len(parts))
    weight = 1 / (1 + (residual / (CAUCHY * deviation)) ** 2) / (REDUNDANCY * deviation**2)
    return (rows * weight) @ rows.T, (rows * weight) @ residual


@torch.no_grad()
def equations_of(
    avatar: Avatar, frame: FrameInputs, images: Sequence[ImageRecord]
) -> tuple[Float64[np.ndarray, "2 lights lights"], Float64[np.ndarray, "2 lights"]]:
    """Sums over the images of one frame, every other in the second half."""
    lights, cameras = len(frame.record.light_positions), [camera_view(i, avatar.albedo.device) for i in images]
    traced, pictures = avatar.trace(frame), []
    for light in range(lights):
        prepared = avatar.prepare(traced.with_light(light))
        pictures.append([avatar.view(prepared, camera).rgb.cpu().numpy() for camera in cameras])
    matrix, vector = np.zeros((2, lights, lights)), np.zeros((2, lights))
    for number, image in enumerate(images):
        inside = image.mask > 1 - 1 / 255
        parts = np.stack([of_light[number][inside] for of_light in pictures])
        for total, term in zip((matrix, vector), frame_equations(parts, image.image[inside]), strict=True):
            total[number % 2] += term
    return matrix, vector


def frames_to_look_at(table: pd.DataFrame, images_of: Mapping[int, Sequence[int]]) -> list[int]:
    """Partially lit frames with at least two images, evenly chosen.

    Args:
        table: of `FrameShards`.
        images_of: rows of each frame's images.
    """
    enough = table.frame.map(lambda number: len(images_of.get(number, ())) > 1).astype(bool)
    useful = table[~table.fully_lit & table.lights.between(1, MOST_LIGHTS) & enough].sort_values("frame")
    numbers = useful.frame.tolist()
    return evenly(numbers, max(1, len(numbers) * MOST_PARTS // max(1, int(useful.lights.sum()))))


def images_to_look_at(images: Sequence[int]) -> list[int]:
    """Some images of a frame, evenly chosen."""
    return evenly(list(images), IMAGES_PER_FRAME)


def assembled(
    lights: Sequence[np.ndarray], equations: Sequence[tuple[np.ndarray, np.ndarray]]
) -> tuple[np.ndarray, LightEquations]:
    """Places of all lights, and their equations from those of frames that some light."""
    places = np.unique(np.concatenate(lights), axis=0)
    number = {place.tobytes(): i for i, place in enumerate(places)}
    matrix, vector = np.zeros((2, len(places), len(places))), np.zeros((2, len(places)))
    for positions, (a, b) in zip(lights, equations, strict=True):
        lit = [number[place.tobytes()] for place in positions]
        for half in range(2):
            matrix[half][np.ix_(lit, lit)] += a[half]
            vector[half][lit] += b[half]
    return places, LightEquations(matrix, vector)


def refined_gains(
    places: np.ndarray, equations: LightEquations, gains: LightGains, sigma: float
) -> tuple[LightGains, float]:
    """Gains times what both halves of the images say, and by how much each foretold the other.

    That is the squared errors that factors fitted to one half take away from the other. Errors of the avatar look like
    lights' when seen by a few cameras only. So of priors from `sigma` downwards, that one counts with which each half
    foretells the other best. The gains stay as they were, if none foretells anything.
    """
    sigmas = [sigma / divisor for divisor in TIGHTER]
    foretold = [sum(equations.gain(equations.solve([1 - half], tried), half) for half in range(2)) for tried in sigmas]
    best = int(np.argmax(foretold))
    if not foretold[best] > 0:
        return gains, foretold[best]
    changes = 1 + equations.solve([0, 1], sigmas[best])
    return LightGains(places, (gains.of(places) * changes).astype(np.float32)), foretold[best]


def refine_lights(
    avatar: Avatar, frames: FrameStream, images_of: Mapping[int, Callable[[], Sequence[ImageRecord]]],
    gains: LightGains, sigma: float, processes: Processes, mine: Callable[[int], bool],
) -> LightGains:  # fmt: skip
    """Gains of the lights of some frames, the same in all processes.

    Args:
        avatar: as it is trained so far.
        frames: among which are those to look at.
        images_of: frames to look at, and what reads their training images, one frame's at a time.
        gains: those that the frames are lit with.
        sigma: typical change to expect.
        processes: that share the frames.
        mine: whether a frame is this process' to render.
    """
    numbers = sorted(images_of)
    positions = [frames.records[number].light_positions for number in numbers]
    lights = [len(each) for each in positions]
    sizes = [2 * n * (n + 1) for n in lights]
    flat = torch.zeros(sum(sizes), dtype=torch.float64)
    for number, part in zip(numbers, flat.split(sizes), strict=True):
        if mine(number):
            of_frame = equations_of(avatar, frames[number], images_of[number]())
            part.copy_(torch.from_numpy(np.concatenate([array.ravel() for array in of_frame])))
    flat = flat.to(avatar.albedo.device)
    processes.sum_in_place(flat)  # Each part is another process' zeros but once, so that the sum is exact.
    equations = [
        (part[: 2 * n * n].reshape(2, n, n), part[2 * n * n :].reshape(2, n))
        for n, part in zip(lights, np.split(flat.cpu().numpy(), np.cumsum(sizes)[:-1]), strict=True)
    ]
    places, together = assembled(positions, equations)
    refined, gained = refined_gains(places, together, gains, sigma)
    if refined is gains:
        log.info("lights stay as they are: other brightness would not fit images that had no part in finding it")
    else:
        spread = 100 * float(refined.factors.std())
        log.info("%d lights' brightness refined by %.1f %%, squared errors fall by %.0f", len(places), spread, gained)
    return refined
