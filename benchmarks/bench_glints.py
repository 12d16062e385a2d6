"""Gaze in, gaze out: do the glints of a trained avatar turn with its gaze as the mirror law says?

    python -m benchmarks.bench_glints --results results/subjectB [--variant full] [--capture captures/subjectB]

Asks for a finished run of a synthesised head with eyes. The head as tracked in frames of all segments looks in the
directions of a grid, most of which no frame has, under one light at a time, seen by some of the calibrated cameras.
Found: centre of gravity, over an eye, of the rendered picture less the same picture without what eyes mirror. Expected:
the mirror point on the eye that was photographed, where head, camera and light truly were, solved in float64 and
brought to the picture by way of the recorded image. So errors of calibration, tracking, fit and training all count.

Writes glints.csv (a row per glint; why one is left out stands in `status`), summary.csv and glints.png into
RESULTS/glints, or --out. Distances are in pixels of the capture; --zoom renders finer pictures, which show smaller
errors. `still_px` is how far the glint would be off if the eye looked where it does in the frame, and `follows` the
slope of found against expected motion over the grid: 1 for an eye that turns, 0 for one that does not.

Exits with 1 if a glint is more than a pixel off or does not show, or if none could be compared.
"""

from __future__ import annotations

import argparse
import json
import sys
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
import torch

from benchmarks.driven_glints import Scene, measure_glints
from benchmarks.glint_figure import draw_glints
from benchmarks.glint_summary import WITHIN_PX, summarize
from benchmarks.true_eyes import read_true_eyes
from pipeline.avatar.relighting.film import Relighter
from pipeline.avatar.training.checkpoint import load_avatar
from pipeline.base.errors import InputError
from pipeline.base.files import read_table, write_table
from pipeline.capture.shards import read_frame_shards
from pipeline.config.trace_irradiance import TraceIrradiance
from pipeline.geometry.cameras import read_cameras

FRAMES, CAMERAS, LIGHTS, YAWS, PITCHES = 4, 4, 6, (-20, -10, 0, 10, 20), (-20, -10, 0, 10, 20)
"""What the bench takes: numbers of frames, cameras and lights, and directions of gaze in degrees."""


def read_scene(results: Path, capture: Path, variant: str, zoom: float) -> Scene:
    """Of a finished run.

    Raises:
        InputError: if the avatar has no explicit eyes.
    """
    loaded = load_avatar(results / "avatars" / variant, results / "atlas.safetensors")
    if not (loaded.avatar.spec.eyes and (loaded.avatar.spec.lobe or loaded.avatar.spec.specular_model == "ggx")):
        raise InputError(f"{results}/avatars/{variant}: expected eyes that mirror, found none; see --variant")
    lights = read_table(results / "calibration/lights.parquet").set_index("light")[["x", "y", "z"]]
    sizes = pd.read_csv(capture / "cameras.csv").iloc[0]
    return Scene(
        Relighter(loaded, TraceIrradiance()), read_true_eyes(capture),
        read_cameras(results / "calibration/cameras.json"),
        {name: row.to_numpy(np.float64) for name, row in lights.iterrows()}, sizes.sensor_width / sizes.width, zoom,
    )  # fmt: skip


def in_front(places: dict[str, np.ndarray], count: int) -> list[str]:
    """So many of the places, evenly spread over those in the half towards which a head at rest looks."""
    names = [name for name in sorted(places) if places[name][2] > 0]
    return [names[i] for i in np.linspace(0, len(names) - 1, min(count, len(names))).astype(int)]


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--results", type=Path, required=True, help="folder results/SUBJECT")
    parser.add_argument("--capture", type=Path, help="folder of the capture, with its truth; default: captures/SUBJECT")
    parser.add_argument("--variant", default="full")
    parser.add_argument("--zoom", type=float, default=1.0, help="rendered pixels per pixel of the capture")
    parser.add_argument("--out", type=Path, help="folder for tables and figure; default: RESULTS/glints")
    options = parser.parse_args()
    torch.set_num_threads(1)
    results, out = options.results, options.out or options.results / "glints"
    scene = read_scene(results, options.capture or Path("captures") / results.name, options.variant, options.zoom)
    frames = read_frame_shards([results / "shards/frames"])
    records = [frames[sorted(frames)[i]] for i in np.linspace(0, len(frames) - 1, FRAMES).astype(int)]
    cameras = in_front({name: camera.center for name, camera in scene.cameras.items()}, CAMERAS)
    table = measure_glints(scene, records, cameras, in_front(scene.lights, LIGHTS), list(product(YAWS, PITCHES)))
    summary = summarize(table).assign(variant=options.variant, zoom=options.zoom)
    write_table(out / "glints.csv", table)
    write_table(out / "summary.csv", summary)
    draw_glints(out / "glints.png", scene, {record.frame: record for record in records}, table)
    for row in summary.to_dict("records"):
        known = {name: x for name, x in row.items() if x == x}
        print(json.dumps({name: round(x, 3) if isinstance(x, float) else x for name, x in known.items()}), flush=True)
    sys.exit(int(not (summary.glints[0] and summary.largest_px[0] <= WITHIN_PX)))


if __name__ == "__main__":
    main()
