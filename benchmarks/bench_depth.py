"""How far each depth for deferred shading is from the true surface: one JSON line per source.

    python -m benchmarks.bench_depth --results results/subjectA --capture captures/subjectA

Asks for a finished run of a synthesised subject, whose posed vertices are known. Counts the pixels of held-out images
that the avatar covers by more than half. A wrong depth does its harm by the direction to the lights: that is said, too.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
import torch
from torch import Tensor

from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.geometry.pixel_depth import depth_of_pixels, points_of_pixels
from pipeline.avatar.training.checkpoint import LoadedAvatar, camera_view, load_avatar
from pipeline.base.files import read_arrays
from pipeline.capture.records import FrameRecord, ImageRecord
from pipeline.capture.shards import read_frame_shards, read_image_shards
from pipeline.config.trained_model import DepthSource
from pipeline.geometry.cameras import Camera, read_cameras
from pipeline.geometry.depth_maps import draw_depth
from pipeline.lighting.lobes import unit
from pipeline.metrics.output_errors import align_rigs

IMAGES = 12


def true_vertices(results: Path, truth: Path) -> dict[int, np.ndarray]:
    """Frame -> posed vertices in the calibrated frame, metres."""
    tracked = read_arrays(truth / "tracking.safetensors")
    lay = align_rigs(read_cameras(results / "calibration/cameras.json"), read_cameras(truth / "cameras.json"))
    vertices = (tracked["vertices"].astype(np.float64) - lay.t) @ lay.R
    return dict(zip(tracked["frames"].tolist(), vertices, strict=True))


@torch.no_grad()
def depths_of(
    loaded: LoadedAvatar, frame: FrameRecord, image: ImageRecord
) -> Iterator[tuple[DepthSource, Tensor, Tensor]]:
    """Every source with its depth and the picture's alpha, as the avatar's own view has them."""
    inputs, camera = FrameInputs(loaded.atlas, frame), camera_view(image)
    for source in get_args(DepthSource):
        primitives = copy(loaded.avatar.built.primitives)
        primitives.options = replace(primitives.options, median_depth=source == "median")
        avatar = loaded.avatar.variant(primitives=primitives)
        prepared = avatar.prepare(inputs)
        picture = avatar.draw(prepared, avatar.layers(prepared, camera.center).stacked(), camera)
        yield source, depth_of_pixels(source, picture, inputs.mesh, camera), picture.alpha


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--results", type=Path, required=True, help="folder results/SUBJECT")
    parser.add_argument("--capture", type=Path, required=True, help="folder of the capture, with its truth")
    paths = parser.parse_args()
    loaded = load_avatar(paths.results / "avatars/full", paths.results / "atlas.safetensors")
    images, frames = (
        read_image_shards([paths.results / "shards/test"]),
        read_frame_shards([paths.results / "shards/frames"]),
    )
    vertices = true_vertices(paths.results, paths.capture / "truth")
    errors: dict[str, list[tuple[Tensor, Tensor]]] = {source: [] for source in get_args(DepthSource)}
    for index in np.linspace(0, len(images) - 1, min(IMAGES, len(images))).astype(int).tolist():
        image = images[index]
        R, t, K = (np.asarray(array, np.float64) for array in (image.R, image.t, image.K))
        camera = Camera(R, t, K, np.zeros(5), image.width, image.height)
        true = torch.as_tensor(draw_depth(camera, vertices[image.frame], loaded.atlas.faces.astype(np.int64)))
        lights = torch.tensor(frames[image.frame].light_positions)
        for source, depth, alpha in depths_of(loaded, frames[image.frame], image):
            row, column = torch.nonzero((alpha > 0.5) & torch.isfinite(true), as_tuple=True)
            found, wanted = (points_of_pixels(row, column, d[row, column], camera_view(image)) for d in (depth, true))
            chord = (unit(lights - found[:, None]) - unit(lights - wanted[:, None])).norm(dim=-1)
            turned = torch.rad2deg(2 * torch.asin(chord / 2)).mean(1)
            errors[source].append((1e3 * (depth - true)[row, column].abs(), turned))
    for source, found in errors.items():
        depth_mm, turned = (torch.cat(parts) for parts in zip(*found, strict=True))
        line = {
            "depth": source, "images": len(found), "pixels": len(depth_mm),
            "error_mm_median": round(float(depth_mm.median()), 2),
            "error_mm_95": round(float(depth_mm.quantile(0.95)), 2),
            "light_turned_degrees_median": round(float(turned.median()), 3),
            "light_turned_degrees_95": round(float(turned.quantile(0.95)), 3),
        }  # fmt: skip
        print(json.dumps(line), flush=True)


if __name__ == "__main__":
    main()
