"""Files of a small scene that the stages before plan_effects would write, all of them true."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks.effect_shapes import Shape
from pipeline.base.files import write_arrays, write_json, write_table
from pipeline.base.splits import VALIDATION_FLAGS
from pipeline.config.synthesize_capture import SynthesizeCapture
from pipeline.geometry.atlas import sampled_atlas
from pipeline.geometry.cameras import write_cameras
from pipeline.geometry.texels import Atlas, write_atlas
from pipeline.synthesis.appearance import Unwrapped
from pipeline.synthesis.capture_files import held_out
from pipeline.synthesis.stage_rig import StageRig, segment_for


def write_stage_files(
    folder: Path, name: str, shape: Shape, rig: StageRig, patterns: pd.DataFrame, moments: list, settings:
    SynthesizeCapture, atlas_size: int,
) -> dict[str, Path]:  # fmt: skip
    """The index, the calibration, the books, the tracking and the atlas, all of them true."""
    calibration, splits = folder / "calibration", held_out(rig, settings)
    write_json(
        folder / "index/capture.json",
        {
            "subject": name, "kind": "body",
            "images": {"transfer": "linear", "black_level": 0.0, "downsample_from_sensor": 1},
        },
    )  # fmt: skip
    write_table(folder / "index/gaze.parquet", pd.DataFrame(columns=["frame", "eye", "x", "y", "z"]))
    rows = pd.DataFrame([(c, f) for c in rig.cameras for f in range(settings.frames)], columns=["camera", "frame"])
    at = [f"{row.camera}/{row.frame:06d}" for row in rows.itertuples()]
    segments = [segment_for(frame, settings)[0] for frame in range(settings.frames)]
    held = {
        "test_camera": rows.camera.isin(splits["test_cameras"]), "test_frame": rows.frame.isin(splits["test_frames"]),
        "test_segment": rows.frame.map(dict(enumerate(segments))).isin(splits["test_segments"]), "test_pattern": False,
    }  # fmt: skip
    paths = {"path": [f"images/{x}.exr" for x in at], "mask_path": [f"masks/{x}.png" for x in at]}
    held |= dict.fromkeys(VALIDATION_FLAGS, False)
    write_table(folder / "index/images.parquet", rows.assign(**paths, **held))
    lit = patterns.groupby("frame").light.count()
    booked = pd.DataFrame({"frame": lit.index, "segment": segments, "fully_lit": lit.to_numpy() == settings.lights})
    write_table(folder / "index/frames.parquet", booked[["frame", "segment"]])
    test = booked.frame.isin(splits["test_frames"]) | booked.segment.isin(splits["test_segments"])
    split = np.where(test, "test_frames", "train")
    write_table(folder / "frames.parquet", booked.assign(test_pattern=False, validation=False, split=split))
    channels = {f"intensity_{c}": patterns.intensity for c in "rgb"}
    write_table(folder / "patterns.parquet", patterns.assign(**channels))
    write_cameras(calibration / "cameras.json", rig.cameras)
    inverse = {camera: np.linalg.inv(matrix).tolist() for camera, matrix in rig.raw_from_true.items()}
    write_json(calibration / "color.json", {"cameras": inverse})
    lights = pd.DataFrame(rig.lights_xyz, columns=["x", "y", "z"])
    write_table(calibration / "lights.parquet", lights.assign(light=list(rig.light_positions)))
    vertices = np.stack([moment[0][shape.unwrapped.source] for moment in moments]).astype(np.float32)
    tracked = {"frames": np.arange(len(moments)), "vertices": vertices}
    if moments[0][1] is not None:
        tracked["joint_rotations"] = np.stack([moment[1] for moment in moments]).astype(np.float32)
    write_arrays(folder / "tracking/0000.safetensors", tracked)
    regions = {part: np.unique(shape.unwrapped.faces[faces]) for part, faces in shape.parts.items()}
    atlas = replace(make_atlas(shape.unwrapped, vertices[0], atlas_size), regions=regions)
    write_atlas(folder / "atlas.safetensors", atlas)
    return {
        "capture": folder, "index": folder / "index", "atlas": folder / "atlas.safetensors",
        "tracking": folder / "tracking/0000.safetensors", "patterns": folder / "patterns.parquet",
        "frames": folder / "frames.parquet", "lights": calibration / "lights.parquet",
        "cameras": calibration / "cameras.json", "color": calibration / "color.json",
    }  # fmt: skip


def make_atlas(unwrapped: Unwrapped, rest: np.ndarray, size: int) -> Atlas:
    """The charts of the texture, on a smaller map."""
    uv = unwrapped.uv[unwrapped.faces].astype(np.float32)
    first = {vertex: index for index, vertex in reversed(list(enumerate(unwrapped.source.tolist())))}
    weld = np.array([first[vertex] for vertex in unwrapped.source.tolist()], np.int32)
    return sampled_atlas(rest, unwrapped.faces, uv, weld, size)
