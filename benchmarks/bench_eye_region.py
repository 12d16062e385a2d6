"""What explicit eyes are worth where eyes are seen: PSNR over their pixels, of one avatar and another.

    python -m benchmarks.bench_eye_region --results results/subjectB --against no_eyes [--variant full]

Asks for a finished run of a synthesised head with eyes and two of its avatars, e.g. `variants: {full: {}, no_eyes:
{eyes: "off"}}`. Pixels are those of held-out images in whose middle the eyes that were photographed lie nearest, by the
capture's truth; protocol and splits are those of `evaluate_avatar`, but for the region. Prints, and writes to
RESULTS/eye_region.csv or --out, a row per split and light: mean of each variant's PSNR, and the mean difference with
its standard error over frames.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
import pandas as pd
import torch

from benchmarks.true_eyes import TrueEyes, read_true_eyes
from pipeline.avatar.training.checkpoint import load_avatar
from pipeline.base.files import write_table
from pipeline.capture.records import ImageRecord
from pipeline.capture.shards import read_frame_shards, read_image_shards
from pipeline.geometry.cameras import Camera, read_cameras
from pipeline.geometry.depth_maps import draw_depth
from pipeline.geometry.rigid_alignment import Alignment
from pipeline.metrics.evaluation import FLAGS, LIT, SPLITS, scored_pair
from pipeline.metrics.images import psnr_db
from pipeline.metrics.output_errors import align_rigs
from pipeline.metrics.significance import mean_over_images
from pipeline.synthesis.eyeball import cornea_patch, sclera_patch

LEAST_PIXELS = 20
"""Eye pixels of an image that is scored: fewer say little, and are those of an eye's very edge."""


def seen_eyes(truth: TrueEyes, lay: Alignment, image: ImageRecord) -> np.ndarray:
    """Pixels [h, w] in whose middle an eye is nearest; `lay` brings the calibrated frame to that of the truth."""
    camera = Camera(image.R, image.t, image.K, np.zeros(5), image.width, image.height)

    def depth(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
        return draw_depth(camera, (vertices - lay.t) @ lay.R, faces.astype(np.int64))

    skin, seen = depth(truth.vertices[image.frame], truth.skin), np.zeros((image.height, image.width), bool)
    turn = truth.motions[image.frame][:, :3] @ truth.gaze[image.frame]
    for eye in truth.centers:
        center, _ = truth.placed(eye, image.frame, truth.looks(image.frame))
        for patch in (cornea_patch(), sclera_patch()):
            seen |= depth(patch.vertices @ turn.T + center, patch.faces) < skin
    return seen


def score(results: Path, capture: Path, variants: list[str]) -> pd.DataFrame:
    """A row per held-out image with enough of the eyes in it: flags, pixels, and each variant's PSNR in a column."""
    images, frames = read_image_shards([results / "shards/test"]), read_frame_shards([results / "shards/frames"])
    truth = read_true_eyes(capture)
    lay = align_rigs(read_cameras(results / "calibration/cameras.json"), truth.cameras)
    renders = {name: load_avatar(results / "avatars" / name, results / "atlas.safetensors").render for name in variants}
    rows, frame = [], None
    for image in images:
        seen = seen_eyes(truth, lay, image) & (image.mask >= 0.5)
        if seen.sum() < LEAST_PIXELS:
            continue
        if frame is None or frame.frame != image.frame:  # one record for all its images: what they share is kept
            frame = frames[image.frame]
        flags = {name: getattr(image, name) for name in (*FLAGS, "fully_lit")}
        rows.append({"camera": image.camera, "frame": image.frame, **flags, "pixels": int(seen.sum())})
        for name, render in renders.items():
            captured, rendered = scored_pair(render, image, frame)
            rows[-1][name] = psnr_db(rendered, captured, seen)
    return pd.DataFrame(rows)


def summarize(scores: pd.DataFrame, variant: str, against: str) -> pd.DataFrame:
    """A row per split and light that has images."""
    rows = []
    for split, in_split in SPLITS.items():
        for lit, in_lit in LIT.items():
            group = scores[in_split(scores) & in_lit(scores)]
            if group.empty:
                continue
            gain = mean_over_images((group[variant] - group[against]).to_numpy(), group.frame.to_numpy())
            rows.append({
                "split": split, "lit": lit, "images": len(group), "eye_pixels": int(group.pixels.sum()),
                variant: group[variant].mean(), against: group[against].mean(), "gain_db": gain.mean,
                "standard_error_db": gain.error,
            })  # fmt: skip
    return pd.DataFrame(rows)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--results", type=Path, required=True, help="folder results/SUBJECT")
    parser.add_argument("--capture", type=Path, help="folder of the capture, with its truth; default: captures/SUBJECT")
    parser.add_argument("--variant", default="full")
    parser.add_argument("--against", required=True, help="variant to compare with, e.g. one without explicit eyes")
    parser.add_argument("--out", type=Path, help="table to write; default: RESULTS/eye_region.csv")
    options = parser.parse_args()
    torch.set_num_threads(1)
    results, names = options.results, (options.variant, options.against)
    scores = score(results, options.capture or Path("captures") / results.name, list(names))
    table = summarize(scores, *names)
    write_table(options.out or results / "eye_region.csv", table)
    for row in table.to_dict("records"):
        print(json.dumps({name: round(x, 2) if isinstance(x, float) else x for name, x in row.items()}), flush=True)


if __name__ == "__main__":
    main()
