"""Compiling the kernels of training and rendering, once, when the project is installed.

`python -m pipeline.avatar.training.compile_kernels` takes a training step of each shading of a body on one square
metre of surface. numba keeps the binaries beside the sources; without this, the first training compiles what it comes
to.
"""

from __future__ import annotations

import logging
import time

import numpy as np

from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.model import Avatar
from pipeline.avatar.spec.planned import resolve_spec
from pipeline.avatar.texels.posed_texels import texel_spacing
from pipeline.avatar.training.training import Training
from pipeline.capture.records import FrameRecord, ImageRecord
from pipeline.config.train_avatar import TrainAvatar
from pipeline.geometry.texels import Atlas

EFFECTS = {"specular", "shadow", "near_field", "articulation"}
"""Those that have kernels."""

SHADINGS = (
    TrainAvatar(shading="transfer"),
    TrainAvatar(shading="microfacet", visibility="traced", indirect="bounce"),
)
"""The two ways to shade a body: each gathers light with kernels of its own."""

PIXELS = 16
"""Side of the picture: one tile."""


def square() -> Atlas:
    """Two triangles in the plane z = 0 that face +z, with a texel each."""
    corners = np.array([[-0.5, 0.5, 0], [0.5, 0.5, 0], [0.5, -0.5, 0], [-0.5, -0.5, 0]], np.float32)
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
    faces = np.array([[0, 2, 1], [0, 3, 2]], np.int32)
    return Atlas(
        size=2, faces=faces, uv=uv[faces], weld=np.arange(4, dtype=np.int32), rest_vertices=corners,
        texel=np.array([[0, 1], [1, 0]], np.int32), face=np.array([0, 1], np.int32),
        barycentric=np.array([[0.5, 0.25, 0.25], [0.5, 0.25, 0.25]], np.float32), chart=np.zeros(2, np.int32),
        tangent_weights=np.array([[-1, 0, 1], [0, -1, 1]], np.float32),
    )  # fmt: skip


def lit_frame(atlas: Atlas) -> FrameRecord:
    """The square at rest under one light."""
    return FrameRecord(
        frame=0, segment="a", fully_lit=True, vertices=atlas.rest_vertices,
        irradiance=np.full(atlas.texel_count, 0.5, np.float32),
        cosine_visibility=np.ones(atlas.texel_count, np.float32),
        light_positions=np.array([[0, 0, 1.5]], np.float32), light_intensities=np.ones((1, 3), np.float32),
    )  # fmt: skip


def picture() -> ImageRecord:
    """A grey picture of the square, from 2 m."""
    R, center = np.diag([1.0, -1.0, -1.0]), np.array([0, 0, 2.0])
    K = np.array([[PIXELS, 0, PIXELS / 2], [0, PIXELS, PIXELS / 2], [0, 0, 1]])
    return ImageRecord(
        camera="one", frame=0, test_camera=False, test_frame=False, test_segment=False, test_pattern=False,
        fully_lit=True, x0=0, y0=0, width=PIXELS, height=PIXELS, image=np.full((PIXELS, PIXELS, 3), 0.5, np.float32),
        mask=np.ones((PIXELS, PIXELS), np.float32), K=K, R=R, t=-R @ center,
    )  # fmt: skip


def compile_kernels() -> None:
    """Take one step of each shading."""
    atlas, image = square(), picture()
    for settings in SHADINGS:
        avatar = Avatar(atlas, texel_spacing(atlas), resolve_spec(settings, EFFECTS))
        Training(avatar, settings).take_step(0, FrameInputs(atlas, lit_frame(atlas)), [image])


def main() -> None:
    """Command line: compiles what is not there yet, and says how long that took."""
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    started = time.monotonic()
    compile_kernels()
    logging.info("kernels ready after %.0f s", time.monotonic() - started)


if __name__ == "__main__":
    main()
