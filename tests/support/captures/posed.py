"""Stage inputs with a known answer: a ball over a floor in three tracked frames, lit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import trimesh

from pipeline.base.files import write_arrays, write_json, write_table
from pipeline.base.splits import TEST_FLAGS, VALIDATION_FLAGS
from pipeline.geometry.atlas import sampled_atlas
from pipeline.geometry.cameras import Camera, write_cameras
from pipeline.geometry.texels import write_atlas

FRAMES = [10, 11, 12, 13]
"""10 has two lights, 11 one, 12 none; 13 is tracked but not synced."""

BALL_RADIUS, BALL_HEIGHT, FLOOR_HALF = 0.5, 2.0, 3.0


def write_posed_capture(folder: Path, *, ball: bool = True, light_distance: float = 5.0) -> dict[str, Path]:
    """Write all that trace_irradiance and plan_effects read; returns their arguments but `out`.

    The floor has the left half of the map, the ball the texels of a sliver at its right border. Without the ball the
    mesh is the floor alone. Light L0 hangs over the middle, L1 aside; L2 is never on.
    """
    sphere = trimesh.creation.icosphere(3)
    floor = FLOOR_HALF * np.array([[-1, 0, -1], [-1, 0, 1], [1, 0, 1], [1, 0, -1.0]])
    vertices, faces = floor, np.array([[0, 1, 2], [0, 2, 3]])
    uv = np.array([[0, 0], [0, 1], [0.5, 1], [0.5, 0]], np.float32)[faces]
    if ball:
        vertices = np.concatenate([vertices, np.array(sphere.vertices) * BALL_RADIUS + [0, BALL_HEIGHT, 0]])
        faces = np.concatenate([faces, np.array(sphere.faces) + 4])
        corner = np.array([[0.99, 0.1], [0.99, 0.2], [1.0, 0.1]], np.float32)
        uv = np.concatenate([uv, np.broadcast_to(corner, (len(sphere.faces), 3, 2))])
    atlas = sampled_atlas(vertices, faces, uv, np.arange(len(vertices)), 64)
    paths = {name: folder / f"{name}.parquet" for name in ("lights", "patterns", "frames")}
    paths |= {"atlas": folder / "atlas.safetensors", "tracking": folder / "0000.safetensors"}
    write_atlas(paths["atlas"], atlas)
    moved = vertices + np.array([0.0, 1.0, 2.0, 3.0])[:, None, None] * 1e-3
    write_arrays(paths["tracking"], {"frames": np.array(FRAMES), "vertices": moved.astype(np.float32)})
    positions = np.array([[0, light_distance, 0], [light_distance, light_distance, 0], [0, -light_distance, 0]])
    write_table(
        paths["lights"], pd.DataFrame({"light": ["L0", "L1", "L2"], **dict(zip("xyz", positions.T, strict=True))})
    )
    patterns = pd.DataFrame({"frame": [10, 10, 11], "light": ["L0", "L1", "L0"]})
    write_table(
        paths["patterns"], patterns.assign(intensity_r=[1.0, 2, 1], intensity_g=[1.0, 2, 1], intensity_b=[1.0, 2, 1])
    )
    write_table(
        paths["frames"],
        pd.DataFrame(
            {"frame": FRAMES[:3], "fully_lit": False, "test_pattern": False, "validation": False, "split": "train"}
        ),
    )
    return paths


def write_cameras_and_color(folder: Path, k1: float, gain: float) -> dict[str, Path]:
    """Write an index without images, cameras at sensor resolution, and colour matrices.

    The sensor has twice the image's resolution, and the cameras one distortion coefficient.
    """
    paths = {"index": folder / "index", "cameras": folder / "cameras.json", "color": folder / "color.json"}
    facts = {"downsample_from_sensor": 2, "transfer": "linear", "black_level": 0.0}
    write_json(folder / "index/capture.json", {"subject": "ball", "kind": "body", "images": facts})
    columns = ["camera", "frame", "path", *TEST_FLAGS, *VALIDATION_FLAGS]
    write_table(paths["index"] / "images.parquet", pd.DataFrame(columns=columns))
    write_table(paths["index"] / "gaze.parquet", pd.DataFrame(columns=["frame", "eye", "x", "y", "z"]))
    intrinsics = np.array([[100.0, 0, 100], [0, 100, 50], [0, 0, 1]])
    straight = Camera(np.eye(3), np.array([0.3, 0, 5]), intrinsics, np.zeros(5), 200, 100)
    bent = Camera(np.diag([-1.0, -1, 1]), np.array([0, 1.0, 5]), intrinsics, np.array([k1, 0, 0, 0, 0]), 200, 100)
    write_cameras(paths["cameras"], {"bent": bent, "straight": straight})
    write_json(paths["color"], {"cameras": {"bent": np.eye(3).tolist(), "straight": np.diag([1, gain, 1]).tolist()}})
    return paths
