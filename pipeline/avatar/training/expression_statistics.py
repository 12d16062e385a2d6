"""Statistics of a head's training frames, which its encoder starts from."""

from __future__ import annotations

from collections.abc import Iterable

from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.model import Avatar
from pipeline.geometry.texels import Atlas

STATISTICS_BYTES = 2**31
"""Vertices and mean textures that a head's statistics are taken from, of frames evenly chosen: 160 frames of a million
texels, thousands of the default's."""


def statistics_frames(atlas: Atlas) -> int:
    """Number of frames from whose vertices and textures a head's statistics are taken."""
    return max(2, STATISTICS_BYTES // (12 * (len(atlas.rest_vertices) + atlas.texel_count)))


def learn_expressions(avatar: Avatar, frames: Iterable[FrameInputs]) -> None:
    """Teach the encoder of a head the statistics of its training frames."""
    vertices, textures = [], []
    for frame in frames:
        vertices.append(avatar.networks.tracked(frame))
        textures += [] if frame.record.texture is None else [frame.record.texture]
    avatar.networks.expression.learn_statistics(vertices, textures)
