"""Gaps in what training images tell, in words for the log.

The avatar is finite all the same, and guesses.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
import pandas as pd
from jaxtyping import Float32

from pipeline.avatar.model import Avatar
from pipeline.avatar.texels.length_unit import PERSONS_M
from pipeline.avatar.training.optimizer import Adam, learned_parameters
from pipeline.base.errors import listed
from pipeline.capture.records import ImageRecord
from pipeline.capture.shards import FrameShards

BLACK = 1e-3
"""Linear RGB below which a pixel is black: 3 of 255 counts in sRGB."""

ORDINARY_UNDRAWN = 0.03
"""Share of texels that no picture shows of whole captures: under arms and soles, 0.7 and 0.8 % of subjectA and C."""

KINDS = ALL_BLACK, EMPTY = "black where the subject is", "without a subject"


def unusual_size(avatar: Avatar) -> list[str]:
    """Say that the subject is no person's size, and what follows from that."""
    if avatar.unit_m == 1:
        return []
    return [
        f"the subject is {avatar.unit_m:.3g} m long, expected {PERSONS_M[0]:g} to {PERSONS_M[1]:g}: lengths of the "
        "avatar's settings and bounds count in its own, as if it were 1 m long"
    ]


def lacking_in_tables(table: pd.DataFrame, records: FrameShards) -> list[str]:
    """Say what some images do not tell, as far as their tables show it.

    Args:
        table: of `ImageShards`, of the images that are trained on.
        records: of their frames, and maybe others.
    """
    numbers = set(table.frame.tolist())
    return lacking_views(table) + lacking_lights({n: lit for n, lit in records.lights().items() if n in numbers})


def lacking_views(table: pd.DataFrame) -> list[str]:
    """Say what the cameras of some images do not tell.

    Args:
        table: of `ImageShards`, of the images that are trained on.
    """
    R, t = (np.array(table[name].tolist()).reshape(-1, 3, n) for name, n in (("R", 3), ("t", 1)))
    centers = np.unique(-(R.transpose(0, 2, 1) @ t)[..., 0], axis=0)
    if len(centers) > 1:
        return []
    named = listed(sorted(set(table.camera)))
    return [f"all images are seen from one place ({named}): how far the surface is from there is as it was tracked"]


def lacking_lights(lights: Mapping[int, Float32[np.ndarray, "lit 6"]]) -> list[str]:
    """Say what the lights of some frames do not tell.

    Args:
        lights: places and intensities of the lights of each frame, see `FrameShards.lights`.
    """
    said, lit = [], {number: rows for number, rows in lights.items() if len(rows)}
    if dark := sorted(lights.keys() - lit.keys()):
        said.append(f"no light is on in {len(dark)} of {len(lights)} frames: {listed(dark)}")
    if not lit:
        return said
    if shared := sum(len(np.unique(rows[:, :3], axis=0)) < len(rows) for rows in lit.values()):
        said.append(f"several lights stand in one place in {shared} of {len(lights)} frames: they count as one")
    guess = "how the subject looks under others is a guess"
    if len(np.unique(np.concatenate(list(lit.values()))[:, :3], axis=0)) == 1:
        said.append(f"one light lights all frames: {guess}")
    elif len({rows.tobytes() for rows in lit.values()}) == 1:
        said.append(f"the same {len(next(iter(lit.values())))} lights light all frames alike: {guess}")
    return said


def undrawn_texels(avatar: Avatar, optimizer: Adam) -> list[str]:
    """Count texels that had no part in any picture, if they are more than ordinary.

    None of these ever asked for another opacity: Adam's mean squared gradient is exactly zero.
    """
    opacity = learned_parameters(avatar).get("opacity")
    if opacity is None or not (moments := optimizer.state.get(opacity)):
        return []
    undrawn = int((moments["exp_avg_sq"].reshape(len(opacity), -1) == 0).all(1).sum())
    if undrawn <= ORDINARY_UNDRAWN * len(opacity):
        return []
    return [f"{undrawn} of {len(opacity)} texels are in no picture: they are as at the start, or as their neighbours"]


class LookedAt:
    """Images that training looked at, and those among them that have nothing to tell."""

    def __init__(self) -> None:
        self._images: dict[str, str] = {}

    def look(self, images: Iterable[ImageRecord]) -> None:
        """Take down images that were not looked at before."""
        for image in images:
            name = f"{image.camera}/{image.frame}"
            if name not in self._images:
                self._images[name] = _nothing(image)

    def lacking(self) -> list[str]:
        """Name the images that tell nothing."""
        said = []
        for kind in KINDS:
            if names := sorted(name for name, found in self._images.items() if found == kind):
                said.append(f"{len(names)} of {len(self._images)} images are {kind}: {listed(names)}")
        return said


def _nothing(image: ImageRecord) -> str:
    subject = image.mask > 0
    if not subject.any():
        return EMPTY
    return "" if (image.image[subject] > BLACK).any() else ALL_BLACK
