"""Lights of a stage in images under environments, found from images of its single lights.

Light adds up: an image of a still subject under an environment is the sum of its images under single lights, each times
how bright that light was, in each channel. Sets that have both ship no such numbers, and they follow from any few
cameras: those that test take no part. Where lights are hardly seen, images leave their brightness open; it stays near
what explains the image best if all are equally bright, so that noise is not taken for light.
"""

from __future__ import annotations

import logging
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd
from jaxtyping import Float64
from scipy.optimize import nnls

from pipeline.base.spread import evenly
from pipeline.capture.archives import read_bytes
from pipeline.capture.images import decode_image
from pipeline.capture.mask_format import whole_blocks
from pipeline.datasets.imported_capture import Provenance
from pipeline.datasets.kept_frames import shown

log = logging.getLogger(__name__)

FITTED_CAMERAS = 8
"""Training cameras whose images are looked at, evenly chosen: all round a subject, some see each light's effect."""

SIDE = 64
"""Blocks along the longer side of an image: a standing person fills about 400, so that 8 cameras give ten equations for
each of 331 lights."""

SEEN = 0.01
"""Light of a block under all lights, over white, from which it shows the subject: the sets' backgrounds are black."""

CLIPPED = 0.95
"""Light of a block's brightest pixel from which it may be cut off at white."""

SPREAD = 3.0
"""Deviation of the lights' brightness from its mean, over that mean, which is expected before images are looked at: an
environment has lamps. Lights that images tell of are hardly held back by it."""

LEAST_NOISE = 0.002
"""Error of a block, over white: half a count of 255 where the sRGB curve is of unit slope."""

MOST_MISFIT = 0.2
"""Error of an explained image over its light, both root mean squares, up to which it is taken: 14 dB. Images in which
the subject stands elsewhere miss more."""

CHANNELS = ["intensity_r", "intensity_g", "intensity_b"]


@dataclass(frozen=True)
class StageImages:
    """Images of a still subject in a stage.

    Attributes:
        root: folder that paths are relative to.
        paths: of the images, by camera and number.
        lights: name of the light of each number of a single light.
        full: number of the image with all lights on.
        transfer: how stored values relate to light.
    """

    root: Path
    paths: Mapping[str, Mapping[int, str]]
    lights: Mapping[int, str]
    full: int
    transfer: Literal["linear", "srgb"] = "srgb"


def environment_patterns(
    stage: StageImages, cameras: Collection[str], wanted: Sequence[int], intensities: Mapping[str, float],
    provenance: Provenance,
) -> pd.DataFrame:  # fmt: skip
    """frame, light and intensities in three channels of the images that single lights explain.

    Args:
        stage: the images.
        cameras: that train.
        wanted: numbers of images under environments.
        intensities: of the lights in their own images.
        provenance: gets notes.
    """
    chosen = evenly(sorted(name for name in cameras if stage.full in stage.paths[name]), FITTED_CAMERAS)
    single = [number for number in stage.lights if all(number in stage.paths[name] for name in chosen)]
    there = [number for number in wanted if single and any(number in stage.paths[name] for name in chosen)]
    parts, missed = [], {}
    blocks = {name: _read_blocks(stage, name, [stage.full, *single, *there]) for name in chosen} if there else {}
    for frame in there:
        views = [found for found in blocks.values() if frame in found]
        image = np.concatenate([found[frame] for found in views])
        lit = np.stack([np.concatenate([found[number] for found in views]) for number in single])
        weights, misfit = fit_weights(lit, image)
        log.info("image %d: single lights explain it but for %.3f of its light", frame, misfit)
        if misfit > MOST_MISFIT:
            missed[frame] = misfit
            continue
        names = [stage.lights[number] for number in single]
        table = pd.DataFrame(weights * np.array([[intensities[name]] for name in names]), columns=CHANNELS)
        parts.append(table.assign(frame=frame, light=names)[["frame", "light", *CHANNELS]])
    if missed:
        said = ", ".join(f"{frame} ({misfit:.2f})" for frame, misfit in missed.items())
        provenance.left_out["images that single lights do not explain"] = f"{said} of their light missing"
    if not parts:
        return no_environments()
    table = pd.concat(parts, ignore_index=True)
    frames = table.frame.unique().tolist()
    provenance.computed["light patterns of environments"] = (
        f"import_capture: images {shown(frames)}; lights whose single images add up to them, by non-negative least "
        f"squares over {len(chosen)} training cameras; held out for testing, as test_frames"
    )
    return table[(table[CHANNELS] > 0).any(axis=1)]


def no_environments() -> pd.DataFrame:
    """An empty table as `environment_patterns` makes it."""
    return pd.DataFrame(columns=["frame", "light", *CHANNELS])


def with_environments(single: Sequence[tuple[int, str, float]], environments: pd.DataFrame) -> pd.DataFrame:
    """The table of patterns, of white lights (frame, light, intensity) and of environments."""
    white = pd.DataFrame(single, columns=["frame", "light", "intensity"])
    if environments.empty:
        return white
    colored = white.assign(**dict.fromkeys(CHANNELS, white.intensity)).drop(columns="intensity")
    return pd.concat([colored, environments], ignore_index=True).sort_values("frame", kind="stable", ignore_index=True)


def fit_weights(
    lit: Float64[np.ndarray, "lights blocks 3"], image: Float64[np.ndarray, "blocks 3"]
) -> tuple[Float64[np.ndarray, "lights 3"], float]:
    """Weights of the lights that add up to the image, none negative, and what they miss.

    What is missing is the error over the image's light, both root mean squares.
    """
    weights = np.zeros((len(lit), 3))
    for channel in range(3):
        A, b = lit[..., channel].T, image[:, channel]
        noise = max(float(np.sqrt(np.mean((A @ nnls(A, b)[0] - b) ** 2))), LEAST_NOISE)
        everywhere = A.sum(1)
        mean = max(float(everywhere @ b / (everywhere @ everywhere)), 1e-9)
        prior = np.eye(len(lit)) / (SPREAD * mean)
        weights[:, channel] = nnls(np.vstack([A / noise, prior]), np.concatenate([b / noise, prior.sum(1) * mean]))[0]
    away = np.einsum("lbc,lc->bc", lit, weights) - image
    return weights, float(np.sqrt((away**2).sum() / (image**2).sum()))


def _read_blocks(stage: StageImages, camera: str, numbers: Sequence[int]) -> dict[int, Float64[np.ndarray, "blocks 3"]]:
    """Light of the blocks that show the subject, by the image's number; numbers without an image are left out."""
    found, kept = {}, None
    for number in numbers:
        if number not in stage.paths[camera]:
            continue
        path = stage.root / stage.paths[camera][number]
        image = decode_image(read_bytes(path), path, stage.transfer)
        blocks = whole_blocks(image, -(-max(image.shape) // SIDE))
        light, highest = blocks.mean((1, 3), dtype=np.float64), blocks.max((1, 3)).max(-1)
        if kept is None:
            kept = (light.mean(-1) > SEEN) & (highest < CLIPPED)
        found[number] = light[kept]
    return found
