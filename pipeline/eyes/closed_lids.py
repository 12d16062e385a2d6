"""Lids that a template does not close: both of a person's eyes are open, or neither is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from pipeline.eyes.gaze_estimate import GazeEstimate

SURE_ALONE = 0.64
"""Share of what is not white that an iris explains, from which on an eye needs no other: open eyes of the procedural
head have that and more. A real lid, whose own shading runs from dark to bright as well, was explained by up to 0.47,
as some open eyes are in close-ups."""


def open_together(found: Mapping[str, Sequence[GazeEstimate]]) -> dict[str, list[GazeEstimate]]:
    """Estimates without those of eyes that are probably closed.

    An eye that is explained by less than `SURE_ALONE` is unclear where another eye of the same frame shows no iris:
    people close both. Where the other is hidden, as on the far side of a head, it says nothing.

    Args:
        found: by eye, of the same frames.
    """
    closed = [any(eye.status == "unclear" for eye in eyes) for eyes in zip(*found.values(), strict=True)]
    return {
        name: [_closed(eye) if shut else eye for eye, shut in zip(estimates, closed, strict=True)]
        for name, estimates in found.items()
    }


def _closed(eye: GazeEstimate) -> GazeEstimate:
    """An eye beside one that shows no iris."""
    if eye.status != "estimated" or eye.explained >= SURE_ALONE:
        return eye
    return replace(eye, status="unclear", direction=np.full(3, np.nan), sigma_deg=np.nan)
