"""Animations of glTF: properties of nodes over the moments of the capture.

Source: Khronos glTF 2.0 specification, section 3.11; between two moments translations and weights are linear, and
rotations go along the great circle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import pygltflib
from jaxtyping import Float

from pipeline.export.glb import GlbFile


@dataclass(frozen=True)
class Track:
    """Values of one property of a node.

    Attributes:
        node: its index.
        path: the property.
        values: one row for each moment: metres, a quaternion x, y, z, w, or the weights of all morph targets.
    """

    node: int
    path: Literal["translation", "rotation", "weights"]
    values: Float[np.ndarray, "moments components"]


def moments_of(frames: Sequence[int], fps: float) -> Float[np.ndarray, " frames"]:
    """Seconds since the first of the frames, whose numbers count `fps` to a second."""
    numbers = np.array(frames)
    return (numbers - numbers[0]) / fps


def add_animation(file: GlbFile, seconds: Float[np.ndarray, " moments"], tracks: Sequence[Track]) -> None:
    """Append one animation that moves all these nodes together."""
    times = file.add(seconds.astype("<f4"), bounded=True)
    samplers, channels = [], []
    for track in tracks:
        # Weights are scalars, as many as targets for each moment.
        values = track.values.reshape(-1) if track.path == "weights" else track.values
        output, linear = file.add(values.astype("<f4")), pygltflib.ANIM_LINEAR
        samplers.append(pygltflib.AnimationSampler(input=times, output=output, interpolation=linear))
        target = pygltflib.AnimationChannelTarget(node=track.node, path=track.path)
        channels.append(pygltflib.AnimationChannel(sampler=len(samplers) - 1, target=target))
    file.document.animations.append(pygltflib.Animation(name="capture", samplers=samplers, channels=channels))
