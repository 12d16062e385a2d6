"""The irradiance map of one tracked frame, by whichever way is cheaper: rays to its lights, or bits of its pose."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from pipeline.base.files import read_table
from pipeline.config.trace_irradiance import TraceIrradiance
from pipeline.geometry.mesh import area_vectors, unit_or
from pipeline.geometry.texels import Atlas, texel_frames
from pipeline.lighting.environment import Environment
from pipeline.lighting.frame_lights import CHANNELS, read_frame_lights
from pipeline.lighting.irradiance import LUMINANCE, IrradianceMap, Lights, Samples, trace_irradiance
from pipeline.lighting.visibility import Occluders
from pipeline.lighting.visibility_bits import bits_are_cheaper, irradiance_from_bits, trace_bits
from pipeline.lighting.visibility_cache import keep_bits, load_bits, visibility_key


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
        """How many lights are on."""
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


def trace_frame(
    atlas: Atlas,
    vertices: np.ndarray,
    stage: StageLights,
    frame: int,
    settings: TraceIrradiance,
    random: np.random.Generator,
    cache: Path | None = None,
) -> IrradianceMap:
    """Irradiance per texel of one frame; `cache`: where visibility bits are kept, if they are."""
    posed, lights = vertices.astype(np.float64), stage.at(frame)
    points, frames = texel_frames(atlas, posed)
    # A degenerate face has no horizon: a normal of zero leaves its texels dark, without rays.
    face_normals = unit_or(area_vectors(posed, atlas.faces), 0.0)[atlas.face]
    occluders, normals, count = Occluders(posed, atlas.faces), frames[..., 2], settings.samples_or_none
    samples = None if count is None else Samples(count, settings.sampling, settings.spread, atlas.texel, random)
    patterns = [int((lights.luminances > 0).sum())] * settings.relightings
    wanted = settings.visibility == "cached" or (
        settings.visibility == "auto" and bits_are_cheaper(len(lights.places), patterns, count)
    )
    rays, known = 0, None
    if cache is not None and settings.visibility != "traced":
        key = visibility_key(points, posed, atlas.faces, lights.places)
        known = load_bits(cache, key)
    if known is None and wanted:
        known = trace_bits(occluders, points, face_normals, lights.places, lights.distant)
        rays = known.rays
        if cache is not None:
            keep_bits(cache, key, known)
    if known is None:
        return trace_irradiance(occluders, points, face_normals, lights, normals=normals, samples=samples)
    return replace(irradiance_from_bits(known, occluders, points, face_normals, lights, normals), rays=rays)
