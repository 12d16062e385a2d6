"""The image that a list of light patterns begins with, where the set does not say it.

Fully lit images are bright.
"""

from __future__ import annotations

import logging
from collections.abc import Collection, Mapping

import numpy as np

from pipeline.base.errors import InputError

log = logging.getLogger(__name__)

CLEAR_FACTOR = 2.0
"""By how much fully lit images have to exceed the others, and one numbering any other: all lights together are many
times as bright as one, and three of four single lights are less than twice as bright as the mean of all."""

DARK = 1e-6
"""Light, of the full scale, below which an 8-bit image has no count."""


def contrast(brightness: Mapping[int, float], fully_lit: Collection[int]) -> float:
    """Brightness of images said to be fully lit, over that of the others.

    The lower quartile of those, over the upper one of these: a few images that are bright or dark for another reason
    change neither. 0 without images of both kinds.
    """
    lit = [value for number, value in brightness.items() if number in fully_lit]
    others = [value for number, value in brightness.items() if number not in fully_lit]
    if not lit or not others:
        return 0.0
    return float(np.quantile(lit, 0.25)) / max(float(np.quantile(others, 0.75)), DARK)


def first_image(
    brightness: Mapping[int, float], fully_lit: Collection[int], choices: Collection[int], what: str
) -> int:
    """Number of the image that shows entry 0 of a list, one of the `choices`.

    The contrasts of all of them are logged.

    Args:
        brightness: mean light of images, by number; at least of all that a choice takes for fully lit.
        fully_lit: entries of the list with all lights on.

    Raises:
        InputError: if images do not decide.
    """
    found = {first: contrast(brightness, {entry + first for entry in fully_lit}) for first in choices}
    for first, value in found.items():
        log.info("%s: if entry 0 is image %d, fully lit images are %.2f times as bright as others", what, first, value)
    best, *others = sorted(found, key=lambda first: found[first], reverse=True)
    if found[best] < CLEAR_FACTOR or any(found[best] < CLEAR_FACTOR * found[other] for other in others):
        numbers = ", ".join(f"image {first}: {value:.2f}" for first, value in found.items())
        raise InputError(
            f"{what}: expected fully lit images {CLEAR_FACTOR:g} times as bright as others under one numbering alone, "
            f"found, by the image of entry 0, {numbers}; is the list of another capture?"
        )
    return best


def numbers_to_read(fully_lit: Collection[int], choices: Collection[int]) -> set[int]:
    """Images whose brightness decides: all that some choice takes for fully lit."""
    return {entry + first for entry in fully_lit for first in choices}
