"""Rows of a preset, trained for a few steps and scored on validation images: what each is worth, with its error.

    python -m benchmarks.bench_rows --results results/subjectB --steps 150 \
        --presets config/presets/papers_head.yaml config/presets/departures_head.yaml

Asks for finished shards of the subject. The presets' `train_avatar` are merged in order, the last one's `variants` are
the rows; a row with irradiance maps of its own takes them from results/SUBJECT/variants/ROW/frames. Each row is one
training from the same seed on the same images. Test images are never looked at. Differences are from the first row,
image by image; errors are standard errors over blocks of frames (`pipeline.metrics.significance`): another seed may
change a row by as much. Lights are as calibrated unless a preset or a row says otherwise: refining them takes longer
than so short a training.

With --scores, rows that it holds are not trained again. So of rows that evaluate_avatar has scored, from --avatars, its
metrics_per_image.parquet gives the same table.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import torch
import yaml

from docs.generate.markdown import table
from pipeline.avatar.training.checkpoint import load_avatar
from pipeline.base.files import read_table, write_table
from pipeline.capture.shards import read_frame_shards, read_image_shards
from pipeline.config.train_avatar import TrainAvatar
from pipeline.metrics.evaluation import evaluate
from pipeline.metrics.image_metrics import asked_metrics, metrics_in
from pipeline.metrics.significance import mean_over_images
from pipeline.stages import train_avatar

AS_CALIBRATED = {"refine_lights": False}


def read_rows(presets: Sequence[Path]) -> tuple[dict, dict[str, dict]]:
    """Settings of train_avatar that all rows share, and what each row changes."""
    shared, rows = {}, {}
    for path in presets:
        content = yaml.safe_load(path.read_text())
        shared |= content.get("train_avatar", {})
        rows = content.get("variants", rows)
    return shared, rows


def trained(results: Path, name: str, settings: TrainAvatar, avatars: Path) -> Path:
    """Train a row; its avatar's folder."""
    own = results / "variants" / name / "frames"
    train_avatar.run(
        subject=results.name, atlas=results / "atlas.safetensors", shards=results / "shards",
        effects=results / "effects.json", out=avatars / name, frames=own if own.is_dir() else None,
        fitted_eyes=results / "eyes.json" if (results / "eyes.json").is_file() else None,
        given_geometry=avatars / settings.geometry_from if settings.geometry_from else None,
        processes=1, settings=settings,
    )  # fmt: skip
    return avatars / name


def scored(results: Path, name: str, avatar: Path, metrics: Sequence[str]) -> pd.DataFrame:
    """Scores of all validation images."""
    own, loaded = results / "variants" / name / "frames", load_avatar(avatar, results / "atlas.safetensors")
    images = read_image_shards([results / "shards/validation"])
    frames = read_frame_shards([own if own.is_dir() else results / "shards/frames"])
    return evaluate(loaded.render, images, frames, None, asked_metrics(metrics), loaded.trace).assign(variant=name)


def differences(scores: pd.DataFrame) -> pd.DataFrame:
    """A line per row: its means, and for each metric the difference from the first row with its standard error."""
    lines, names = [], [metric for metric in metrics_in(scores) if scores[metric.name].notna().any()]
    by_row: Mapping[str, pd.DataFrame] = dict(list(scores.groupby("variant", sort=False)))
    first = next(iter(by_row.values())).set_index(["camera", "frame"])
    for row, own in by_row.items():
        line, base = {"row": row}, first.loc[list(zip(own.camera, own.frame, strict=True))]
        for metric in names:
            values, others = (part[metric.name].to_numpy(np.float64) for part in (own, base))
            found = mean_over_images(values - others, own.frame.to_numpy())
            line |= {metric.name: values.mean(), f"{metric.name}_difference": found.mean}
            line[f"{metric.name}_error"] = found.error
        lines.append(line)
    return pd.DataFrame(lines)


def as_markdown(found: pd.DataFrame) -> str:
    """The lines as a table of a page: PSNR, and the differences of all metrics."""
    metrics = [name.removesuffix("_difference") for name in found if name.endswith("_difference")]
    digits = {metric: 2 if metric == "psnr_db" else 4 for metric in metrics}
    lines = [
        [f"`{row.row}`", f"{row.psnr_db:.2f}"]
        + [
            f"{row[f'{metric}_difference']:+.{digits[metric]}f} ± {row[f'{metric}_error']:.{digits[metric]}f}"
            for metric in metrics
        ]
        for _, row in found.iterrows()
    ]
    return table(("row", "PSNR, dB", *(f"difference of {metric}" for metric in metrics)), lines)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--results", type=Path, required=True, help="folder results/SUBJECT")
    parser.add_argument(
        "--presets", type=Path, nargs="+", required=True, help="presets, the last one's rows are trained"
    )
    parser.add_argument(
        "--rows",
        nargs="*",
        default=[],
        help="the rows, the first of which the others are held against; all if none is named",
    )
    parser.add_argument("--steps", type=int, default=150, help="of each training")
    parser.add_argument("--metrics", nargs="*", default=[], help="further metrics, as of evaluate_avatar")
    parser.add_argument("--avatars", type=Path, help="folder that keeps the avatars, for evaluate_avatar")
    parser.add_argument("--scores", type=Path, help="parquet of all images' scores, written as rows are done")
    options = parser.parse_args()
    torch.set_num_threads(1)
    shared, rows = read_rows(options.presets)
    done = read_table(options.scores) if options.scores and options.scores.exists() else pd.DataFrame({"variant": []})
    asked = options.rows or list(rows)
    with tempfile.TemporaryDirectory() as folder:
        for name in asked:
            if (done.variant == name).any():
                continue
            changes = {key: value for key, value in rows[name].items() if key != "trace_irradiance"}
            settings = TrainAvatar(**{**AS_CALIBRATED, **shared, **changes, "steps": options.steps, "preview_every": 0})
            avatar = trained(options.results, name, settings, options.avatars or Path(folder))
            done = pd.concat([done, scored(options.results, name, avatar, options.metrics)], ignore_index=True)
            if options.scores:
                write_table(options.scores, done)
            print(differences(done).tail(1).round(4).to_string(index=False), flush=True)
    print(as_markdown(differences(pd.concat([done[done.variant == name] for name in asked]))))


if __name__ == "__main__":
    main()
