"""What is made larger, stage by stage, how its cost should grow, and why.

A prediction is of the exponent of the part that grows, beside a fixed cost; 0 says that nothing grows.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from benchmarks.bench_splatting import make_scene as make_gaussians
from benchmarks.bench_splatting import step as splatting_step
from benchmarks.scaling_inputs import CAMERAS, photographed, stage_of_size, walked
from benchmarks.scaling_training import Job, head_steps, held_frames, steps_among_frames, training_steps
from pipeline.config.trace_irradiance import TraceIrradiance
from pipeline.config.track_mesh import TrackMesh
from pipeline.rendering.projection_kernels import TILE
from pipeline.rendering.splat import splat
from pipeline.stages import pack_shards, trace_irradiance, track_mesh

COUNTED = ("frames", "images", "lights", "texels", "Gaussians", "pixels")
"""What sizes are given in. Pixels are those of an image, or of all images of a training step."""


@dataclass(frozen=True)
class Case:
    """One stage, one size that is varied.

    Attributes:
        varied: of `COUNTED`; the job's other sizes stay.
        sizes: what `prepare` is asked for, ascending.
        prepare: of (folder, size): the job that is measured; making its inputs is not.
        seconds, memory: predicted exponents with the reason.
    """

    stage: str
    varied: str
    sizes: tuple[int, ...]
    prepare: Callable[[Path, int], Job]
    seconds: tuple[float, str]
    memory: tuple[float, str]


def doubled(first: int, steps: int = 6) -> tuple[int, ...]:
    """first, 2 first, 4 first, ..."""
    return tuple(first * 2**k for k in range(steps))


def sides(first: int, steps: int = 6) -> tuple[int, ...]:
    """Sides of squares of doubling area, even numbers."""
    return tuple(2 * round(first * 2 ** (k / 2) / 2) for k in range(steps))


PER_RAY = "a ray per texel and light above the horizon; reading, and the frame's tree, are what is fixed"
PER_FRAME = "every frame has its own tree and rays"
PER_TEXEL = (1.0, "a few numbers per texel, light by light; the mesh and its tree are what is fixed")
PER_POSE = (1.0, "the posed vertices of all frames are read at once; what is traced, a frame at a time, is fixed")


def traced(samples: str, varied: str, held: dict[str, int], sizes: tuple[int, ...], seconds: str, memory) -> Case:
    """A case of trace_irradiance; `varied` is one of side, lights, frames, and `held` has the others."""
    settings = TraceIrradiance(samples=samples, visibility="traced")
    runs = itertools.count()

    def prepare(folder: Path, size: int) -> Job:
        own, given = folder / f"traced_{samples}_{varied}_{size}", {**held, varied: size}
        files = stage_of_size(own, **given)

        def run() -> None:
            trace_irradiance.run(**files, out=own / f"{next(runs)}", settings=settings)

        return {"texels": given["side"] ** 2, "lights": given["lights"], "frames": given["frames"]}, run

    stage = f"trace_irradiance, {'all lights' if samples == 'full' else '1 sample'}"
    return Case(stage, "texels" if varied == "side" else varied, sizes, prepare, (1.0, seconds), memory)


TRACED = [
    traced("full", "side", {"lights": 16, "frames": 1}, sides(90, 7), PER_RAY, PER_TEXEL),
    traced("full", "lights", {"side": 64, "frames": 1}, doubled(64, 7), PER_RAY,
           (0.0, "lights are taken a block at a time, of a size that does not depend on their number")),
    traced("full", "frames", {"side": 64, "lights": 16}, doubled(1, 7), PER_FRAME, PER_POSE),
    traced("1", "side", {"lights": 16, "frames": 1}, sides(180, 7), "one ray per texel", PER_TEXEL),
    traced("1", "lights", {"side": 256, "frames": 1}, doubled(128, 7),
           "what is divided by is a sum over all lights; one ray per texel, whatever the lights, is fixed",
           (0.0, "one ray per texel, whatever the lights")),
    traced("1", "frames", {"side": 128, "lights": 16}, doubled(1, 7), PER_FRAME, PER_POSE),
]  # fmt: skip


def packed_images(folder: Path, frames: int) -> Job:
    files = photographed(folder, 96, 64, 24)
    sizes = {"images": frames * CAMERAS, "pixels": 96**2}
    return sizes, lambda: pack_shards.run(**files, out=folder / "packed", chunk_size=frames)


def packed_pixels(folder: Path, side: int) -> Job:
    files = photographed(folder, side, 2, 24)
    return {"images": 2 * CAMERAS, "pixels": side**2}, lambda: pack_shards.run(**files, out=folder / "packed")


PACKED = [
    Case("pack_shards", "images", doubled(1, 7), packed_images,
         (1.0, "each image is read, corrected, cut and written once"), (0.0, "images are written as they are read")),
    Case("pack_shards", "pixels", sides(96), packed_pixels,
         (1.0, "each pixel is decoded, corrected and resampled once"), (1.0, "one image at a time is in memory")),
]  # fmt: skip


def splatting(count: int, side: int) -> Job:
    """Splatting of so many Gaussians to a square image, forward and backward."""
    run = splatting_step(splat, *make_gaussians(count, side), backward=True, threads=1)
    return {"Gaussians": count, "pixels": side**2}, run


WIDE, SPLAT_SIDES = 8192, sides(128)
"""Gaussians of the images that grow, and the images' sides."""


def strips_exponent() -> float:
    """Slope of what blending costs against pixels, from the first to the last of `SPLAT_SIDES`.

    The scene's Gaussians are some 4,096 of 35 pixels at 128 x 128, so sqrt(35 x 4096 / WIDE) x side / 128 wide. One of
    w pixels is blended in w rows of w / 16 + 1 strips of 16 pixels, as wide as a tile.
    """
    first, last = (math.sqrt(35 * 4096 / WIDE) * side / 128 for side in (SPLAT_SIDES[0], SPLAT_SIDES[-1]))
    strips = [w * (w / TILE + 1) for w in (first, last)]
    return math.log(strips[1] / strips[0]) / math.log(SPLAT_SIDES[-1] ** 2 / SPLAT_SIDES[0] ** 2)


SPLATTED = [
    Case("splatting, both ways", "Gaussians", doubled(4096, 7), lambda folder, count: splatting(count, 128),
         (1.0, "projection, sorting and tile lists per Gaussian; that they share the image's pixels is what is fixed"),
         (1.0, "footprints and gradients per Gaussian and tile; the image is what is fixed")),
    Case("splatting, both ways", "pixels", SPLAT_SIDES, lambda folder, side: splatting(WIDE, side),
         (round(strips_exponent(), 2),
          "a Gaussian w pixels wide is blended in w rows of w / 16 + 1 strips; projection is what is fixed"),
         (1.0, "channels of the image, and tile lists; Gaussians are what is fixed")),
]  # fmt: skip

TRAINED = [
    Case("train_avatar, 2 steps", "texels", sides(64, 7), lambda folder, size: training_steps(folder, 64, size),
         (1.0, "transfer, lobe, projection and Adam per texel; blending is what is fixed"),
         (1.0, "parameters, gradients and moments per texel; images are what is fixed")),
    Case("train_avatar, 2 steps", "pixels", sides(96), lambda folder, side: training_steps(folder, side, 64),
         (1.0, "lobe and losses per pixel, and blending; what is done per texel is fixed"),
         (1.0, "channels of the image, kept for the gradient; texels are what is fixed")),
    Case("train_avatar, 2 steps of a head", "texels", sides(64, 7), head_steps,
         (1.0, "what a body takes, and additions drawn per texel; decoders' maps, of a set size, are what is fixed"),
         (1.0, "parameters, gradients, moments and additions per texel; decoders and images are what is fixed")),
    Case("train_avatar, 2 steps among frames", "frames", doubled(2), steps_among_frames,
         (0.0, "a step looks at one frame; it was posed at its first visit"),
         (0.0, "what a step makes is freed; what frames hold was there before")),
    Case("train_avatar, frames held", "frames", doubled(2), held_frames,
         (1.0, "each frame is read, posed and lit once"),
         (1.0, "of every frame stay record, anchors, traced maps, and harmonics where transfer reads them")),
]  # fmt: skip


def tracked_frames(folder: Path, frames: int) -> Job:
    files, settings = walked(folder), TrackMesh(context_frames=0, image_rounds=0)

    def run() -> None:
        track_mesh.run(**files, chunk=0, chunk_size=frames, out=folder / "tracked", settings=settings)

    return {"frames": frames}, run


TRACKED = [
    Case("track_mesh, 5 cameras", "frames", (4, 6, 9, 13, 19, 28, 40), tracked_frames,
         (1.0, "frames are coupled to their neighbours only: a banded system"),
         (1.0, "all masks and points of the chunk are held at once")),
]  # fmt: skip

CASES = [*TRACED, *PACKED, *SPLATTED, *TRAINED, *TRACKED]
"""All."""
