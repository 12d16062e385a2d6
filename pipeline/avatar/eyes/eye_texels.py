"""Which texels of an atlas are those of eyes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Int64

from pipeline.base.errors import InputError
from pipeline.geometry.texels import Atlas


def eye_texels(
    atlas: Atlas, parts: Mapping[str, tuple[int, ...]]
) -> tuple[Int64[np.ndarray, " n"], Int64[np.ndarray, " n"]]:
    """The texels of all eyes, those whose face has all corners in one, and the number of each one's eye in the order of
    `parts`, which has the vertices of each eye by name.

    Raises:
        InputError: if there are no such vertices, or an eye has no texel.
    """
    owner = np.full(len(atlas.rest_vertices), -1)
    for number, (name, vertices) in enumerate(parts.items()):
        if not vertices or not 0 <= min(vertices) <= max(vertices) < len(owner):
            raise InputError(f"{name}: expected vertices 0 to {len(owner) - 1}, found others; run fit_eyes again")
        owner[list(vertices)] = number
    corners = owner[atlas.corners]
    chosen = np.flatnonzero((corners[:, 0] >= 0) & (corners == corners[:, :1]).all(1))
    eye = corners[chosen, 0]
    empty = [name for number, name in enumerate(parts) if not (eye == number).any()]
    if empty:
        raise InputError(
            f"{empty}: expected texels of the atlas on each eye, found none; make unwrap_atlas.size larger"
        )
    return chosen, eye
