"""Inputs of a wanted size for `benchmarks.scaling_cases`: made once, cheaply, of known content."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks.effect_scenes import make_scene
from benchmarks.irradiance_poses import dome, make_pose
from pipeline.base.files import write_arrays, write_json, write_table
from pipeline.config.effects import EFFECTS
from pipeline.config.synthesize_capture import SynthesizeCapture
from pipeline.geometry.texels import write_atlas
from pipeline.stages import index_capture, pack_shards, synthesize_capture

SCENE, CAMERAS = "near", 4
"""Whose images are packed and trained on: a matte ball, which takes no time to render."""

TRACKED = SynthesizeCapture(
    cameras=6, test_cameras=1, lights=8, partial_lights_min=3, partial_lights_max=5, frames=41, frames_b=1,
    test_frames=0, width=64, height=80, spp=1, spp_fully_lit=1, supersampling=1, max_depth=2, vertex_spacing_m=0.06,
    texture_size=128, board_poses=12, ball_positions=2, ball_cameras=1,
)  # fmt: skip
"""A walking figure of which only keypoints and masks are looked at."""


def stage_of_size(folder: Path, side: int, lights: int, frames: int) -> dict[str, Path]:
    """What trace_irradiance reads: a dented ball of 20,480 faces and `side` squared texels, all lights lit."""
    poses = [make_pose(side, 0.1 * frame) for frame in range(frames)]
    numbers, names = np.arange(frames), [f"L{light:04d}" for light in range(lights)]
    write_atlas(folder / "atlas.safetensors", poses[0].atlas)
    vertices = np.stack([pose.vertices for pose in poses]).astype(np.float32)
    write_arrays(folder / "tracking.safetensors", {"frames": numbers, "vertices": vertices})
    write_table(folder / "lights.parquet", pd.DataFrame(dome(lights).places, columns=list("xyz")).assign(light=names))
    lit = pd.DataFrame({"frame": np.repeat(numbers, lights), "light": names * frames})
    write_table(folder / "patterns.parquet", lit.assign(intensity_r=1.0, intensity_g=1.0, intensity_b=1.0))
    write_table(folder / "frames.parquet", pd.DataFrame({"frame": numbers}))
    suffix = {"atlas": "safetensors", "tracking": "safetensors"}
    kinds = ("atlas", "tracking", "lights", "patterns", "frames")
    return {kind: folder / f"{kind}.{suffix.get(kind, 'parquet')}" for kind in kinds}


@functools.cache
def photographed(folder: Path, side: int, frames: int, atlas_size: int) -> dict[str, Path]:
    """A scene's files with all effects of its images on: `CAMERAS` images of `side` squared pixels a frame."""
    changes = {"cameras": CAMERAS, "frames": frames, "frames_b": 1, "test_frames": 0, "test_cameras": 0}
    small = {"width": side, "height": side, "spp": 1, "spp_fully_lit": 1, "supersampling": 1, "max_depth": 2}
    bent = {"distortion": 1.0, "color_spread": 0.035}
    made = folder / f"scene_{side}_{frames}_{atlas_size}"
    files = make_scene(made, SCENE, atlas_size, **changes, **small, **bent)
    on = ("near_field", "specular", "deferred", "lens_distortion", "color_correction")
    write_json(made / "effects.json", {name: {"on": name in on} for name in EFFECTS})
    return {**files, "effects": made / "effects.json"}


@functools.cache
def packed(folder: Path, side: int, atlas_size: int, frames: int = 2) -> dict[str, Path]:
    """The scene's shards of so many frames, for training."""
    files = photographed(folder, side, frames, atlas_size)
    shards = files["atlas"].parent / "shards"
    pack_shards.run(**files, out=shards, chunk_size=frames)
    return {"atlas": files["atlas"], "effects": files["effects"], "shards": shards}


@functools.cache
def walked(folder: Path) -> dict[str, Path]:
    """A figure's capture, its index, and its true cameras."""
    capture, index = folder / "walker", folder / "walker_index"
    synthesize_capture.run(subject="scaling", out=capture, workers=1, settings=TRACKED)
    index_capture.run(capture=capture, out=index)
    return {"capture": capture, "index": index, "cameras": capture / "truth/cameras.json"}
