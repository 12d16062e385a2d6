"""Pictures of volumes against pictures of Gaussians of one head, side by side: one JSON line per ratio.

    python -m benchmarks.bench_volumes [--repeats 5] [--size 128 160] [--atlas 128]

The head is the procedural one of `pipeline.synthesis`, at rest under three lamps, untrained: both geometries close its
surface. Each line compares the milliseconds of one camera's picture, and of a picture with all gradients, timed
alternately in one process on one thread: CPU time, which busy neighbours hardly change. With --picture FILE, both are
drawn beside each other.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import numba
import numpy as np
import torch

from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.model import Avatar
from pipeline.avatar.spec.planned import resolve_spec
from pipeline.avatar.texels.posed_texels import texel_spacing
from pipeline.avatar.training.checkpoint import camera_view
from pipeline.capture.images import write_png
from pipeline.capture.records import FrameRecord
from pipeline.config.train_avatar import TrainAvatar
from pipeline.config.trained_model import Geometry
from pipeline.geometry.atlas import sampled_atlas, unwrap_faces
from pipeline.geometry.camera_paths import look_at
from pipeline.geometry.mesh import weld_vertices
from pipeline.geometry.texels import Atlas
from pipeline.metrics.comparison import labelled_panels, preview_srgb
from pipeline.rendering.splat_types import CameraView
from pipeline.synthesis.head_shape import head_mesh

LAMPS = np.array([[0.5, 0.4, 1.2], [-1.0, 0.2, 0.7], [0.2, 1.2, 0.3]])
VERTEX_SPACING_M = 0.007
CAMERAS = (0.0, 0.7, 2.4)
"""Angles of the cameras from the front, radians."""


def head_atlas(size: int) -> Atlas:
    """Texels of the procedural head's skin."""
    vertices, faces = head_mesh(VERTEX_SPACING_M)
    uv, weld = unwrap_faces(vertices, faces, size, 2), weld_vertices(vertices, faces)
    return sampled_atlas(vertices, faces, uv, weld, size)


def lit_head(atlas: Atlas) -> FrameInputs:
    """The head at rest under the lamps."""
    ones = np.ones(atlas.texel_count, np.float32)
    return FrameInputs(
        atlas,
        FrameRecord(
            frame=0, segment="rest", fully_lit=True, vertices=atlas.rest_vertices, irradiance=ones,
            cosine_visibility=ones, light_positions=LAMPS.astype(np.float32),
            light_intensities=np.full((len(LAMPS), 3), 2.0, np.float32),
            head_from_world=np.eye(3, 4, dtype=np.float32), texture=np.full((atlas.texel_count, 3), 0.4, np.float32),
        ),
    )  # fmt: skip


def build(atlas: Atlas, geometry: Geometry) -> Avatar:
    """A head of RGCA's appearance, lobe per texel, as the rows of its tables have it."""
    settings = TrainAvatar(avatar="head", shading="harmonics", deferred="off", eyes="off", geometry=geometry)
    torch.manual_seed(0)
    return Avatar(atlas, texel_spacing(atlas), resolve_spec(settings, {"specular", "near_field"}, "head"))


def views(width: int, height: int) -> list[CameraView]:
    """Cameras around the head, which fills the picture's height."""
    middle = np.array([0.0, -0.02, 0.0])
    eyes = [middle + 1.2 * np.array([np.sin(angle), 0.0, np.cos(angle)]) for angle in CAMERAS]
    return [camera_view(look_at(eye, middle, 17.0, width, height)) for eye in eyes]


def picture_of(avatar: Avatar, inputs: FrameInputs, camera: CameraView, backward: bool) -> Callable[[], None]:
    """One call to be timed: a picture of a prepared frame, and if asked all its gradients."""
    with torch.set_grad_enabled(backward):
        frame = avatar.prepare(inputs)

    def run() -> None:
        with torch.set_grad_enabled(backward):
            picture = avatar.view(frame, camera)
            if backward:
                (picture.rgb.sum() + picture.alpha.sum()).backward(retain_graph=True)

    return run


def compare(name: str, gaussians: Callable, volumes: Callable, repeats: int, **facts: object) -> None:
    """Print volumes / gaussians, the median over interleaved repeats; the first run of each is left out."""
    seconds: dict[str, list[float]] = {"gaussians": [], "volumes": []}
    for k in range(repeats + 1):
        for label, run in (("gaussians", gaussians), ("volumes", volumes)):
            start = time.process_time()
            run()
            if k:
                seconds[label].append(time.process_time() - start)
    medians = {f"{label}_ms": round(1e3 * statistics.median(values), 1) for label, values in seconds.items()}
    pairs = zip(seconds["gaussians"], seconds["volumes"], strict=True)
    ratio = statistics.median(v / g for g, v in pairs)
    print(json.dumps({"ratio": name, "value": round(ratio, 2), **medians, "repeats": repeats, **facts}), flush=True)


@torch.no_grad()
def draw(path: Path, avatars: dict[str, Avatar], inputs: FrameInputs, cameras: list[CameraView]) -> None:
    """Write pictures of all cameras, a row for each geometry."""
    rows = []
    for name, avatar in avatars.items():
        frame = avatar.prepare(inputs)
        seen = [preview_srgb(avatar.view(frame, camera).rgb.numpy()) for camera in cameras]
        rows.append(labelled_panels({f"camera {k}": picture for k, picture in enumerate(seen)}, name))
    write_png(path, np.concatenate(rows))


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=5, help="timed runs of each side")
    parser.add_argument("--size", type=int, nargs=2, default=(128, 152), help="width and height of the picture")
    parser.add_argument("--atlas", type=int, default=128, help="texels along a side of the atlas")
    parser.add_argument("--picture", type=Path, help="PNG of both, beside each other")
    chosen = parser.parse_args()
    numba.set_num_threads(1)
    torch.set_num_threads(1)
    atlas = head_atlas(chosen.atlas)
    inputs, cameras = lit_head(atlas), views(*chosen.size)
    avatars = {name: build(atlas, name) for name in ("gaussians", "volumes")}
    facts = {
        "size": list(chosen.size), "texels": atlas.texel_count, "boxes": len(avatars["volumes"].box_anchor),
        "threads": 1,
    }  # fmt: skip
    for backward in (False, True):
        one, other = (picture_of(avatar, inputs, cameras[1], backward) for avatar in avatars.values())
        name = "volumes / gaussians, picture" + (" and gradients" if backward else "")
        compare(name, one, other, chosen.repeats, **facts)
    if chosen.picture:
        draw(chosen.picture, avatars, inputs, cameras)


if __name__ == "__main__":
    main()
