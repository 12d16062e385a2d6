"""The irradiance map of one tracked frame, by whichever way is cheaper. Rays to its lights, or bits of its pose."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float64

from pipeline.base.files import read_table
from pipeline.config.trace_irradiance import TraceIrradiance
from pipeline.geometry.texel_surface import texel_surface
from pipeline.geometry.texels import Atlas
from pipeline.lighting.environment import Environment
from pipeline.lighting.frame_lights import CHANNELS, read_frame_lights
from pipeline.lighting.interleaved_sampling import Neighbours, share_rays
from pipeline.lighting.irradiance import IrradianceMap, Samples, trace_irradiance
from pipeline.lighting.light_scene import LUMINANCE, Lights, light_scene
from pipeline.lighting.standard_error import TexelBlocks
from pipeline.lighting.visibility import Occluders
from pipeline.lighting.visibility_bits import (
    VisibilityBits,
    bits_are_cheaper,
    irradiance_from_bits,
    keep_bits,
    load_bits,
    trace_bits,
    visibility_key,
)


@dataclass(frozen=True)
class StageLights:
    """All lights of a stage, and how bright each is in each frame.

    Attributes:
        places: positions in the stage frame, metres; of an environment, directions.
        luminances: per frame, one per light; 0: off. Frames that are absent are dark.
        distant: the lights are the pixels of an environment.
    """

    places: Float64[np.ndarray, "m 3"]
    luminances: Mapping[int, Float64[np.ndarray, " m"]]
    distant: bool = False

    def at(self, frame: int) -> Lights:
        """The lights of a frame, those that are off included."""
        return Lights(self.places, self.luminances.get(frame, np.zeros(len(self.places))), self.distant)

    def lit_count(self, frame: int) -> int:
        """Number of lights that are on."""
        return int((self.at(frame).luminances > 0).sum())


def read_stage_lights(lights: Path, patterns: Path) -> StageLights:
    """The stage's LEDs under its patterns; raises as `read_frame_lights` does."""
    read_frame_lights(lights, patterns)  # names what is wrong; from here on every lit light has a position
    table = read_table(lights)
    table = table[np.isfinite(table[["x", "y", "z"]]).all(axis=1)].reset_index(drop=True)
    row, luminances = {name: i for i, name in enumerate(table.light)}, {}
    for frame, lit in read_table(patterns).groupby("frame"):
        values = np.zeros(len(table))
        np.add.at(values, lit.light.map(row).to_numpy(np.int64), lit[CHANNELS].to_numpy(np.float64) @ LUMINANCE)
        luminances[int(frame)] = values
    return StageLights(table[["x", "y", "z"]].to_numpy(np.float64), luminances)


def environment_lights(environment: Environment, frames: np.ndarray) -> StageLights:
    """One environment for all frames."""
    lights = environment.lights()
    return StageLights(lights.places, dict.fromkeys(frames.tolist(), lights.luminances), True)


@dataclass
class FrameTracer:
    """Traces one frame after another; what all frames share is made once.

    Attributes:
        cache: folder where visibility bits are kept, if they are.
    """

    atlas: Atlas
    stage: StageLights
    settings: TraceIrradiance
    cache: Path | None = None

    @cached_property
    def blocks(self) -> TexelBlocks:
        """Blocks of the map that the texels lie in."""
        return TexelBlocks(self.atlas.texel)

    @cached_property
    def neighbours(self) -> Neighbours:
        """Texels that lend each other their rays."""
        return Neighbours(self.atlas)

    def trace(self, frame: int, vertices: Float[np.ndarray, "v 3"], random: np.random.Generator) -> IrradianceMap:
        """Irradiance per texel of a frame of the stage, whose mesh has these vertices."""
        posed, lights, settings = vertices.astype(np.float64), self.stage.at(frame), self.settings
        # A degenerate face has no horizon: a normal of zero leaves its texels dark, without rays.
        points, normals, face_normals = texel_surface(self.atlas, posed)
        occluders, count = Occluders(posed, self.atlas.faces), settings.samples_or_none
        known, rays = self.visibility(occluders, points, face_normals, posed, lights)
        if known is not None:
            return replace(irradiance_from_bits(known, occluders, points, face_normals, lights, normals), rays=rays)
        samples = None if count is None else Samples(count, settings.sampling, settings.spread, self.blocks, random)
        scene = light_scene(occluders, points, face_normals, lights, normals)
        if samples and settings.share_rays and scene:
            if samples.count < len(scene.lights):
                return share_rays(scene, samples, self.neighbours)
            samples = None  # Rays to all lights are no more, and leave nothing to chance.
        return trace_irradiance(occluders, points, face_normals, lights, normals=normals, samples=samples)

    def visibility(
        self, occluders: Occluders, points: np.ndarray, face_normals: np.ndarray, posed: np.ndarray, lights: Lights
    ) -> tuple[VisibilityBits | None, int]:
        """Bits, kept from earlier or traced if that pays, and the rays that this took now."""
        settings, key = self.settings, ""
        if self.cache is not None and settings.visibility != "traced":
            key = visibility_key(points, posed, self.atlas.faces, lights.places)
            known = load_bits(self.cache, key)
            if known is not None:
                return known, 0
        lit = [int((lights.luminances > 0).sum())] * settings.relightings
        cheaper = settings.visibility == "auto" and bits_are_cheaper(len(lights.places), lit, settings.samples_or_none)
        if not cheaper and settings.visibility != "cached":
            return None, 0
        known = trace_bits(occluders, points, face_normals, lights.places, lights.distant)
        if self.cache is not None:
            keep_bits(self.cache, key, known)
        return known, known.rays
