"""Fakes of public sets through the workflow, beside the truth they were made from: a page of docs and its pictures.

    python -m benchmarks.bench_datasets [--only nersemble ...]

Each fake has the layout of the set and a synthetic subject (`tests/support/datasets`). One line of configuration takes
it to metrics.csv; what was imported is then compared with the truth.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks.dataset_evidence import (
    camera_error,
    direction_table,
    environment_table,
    export_table,
    hull_table,
    mesh_error,
)
from benchmarks.dataset_pictures import draw
from benchmarks.fake_sets import FAKES, FakeSet
from pipeline.base.files import read_arrays, read_table
from pipeline.geometry.cameras import read_cameras
from tests.support.datasets.turning_head import TurningHead

PAGE = Path("docs/imported_sets.md")
PICTURES = Path("docs/pictures")

COPIED = ("workflow", "profiles", "config", "envs", "Snakefile")

HEAD = """\
# Public sets, imported

<!-- Written by `python -m benchmarks.bench_datasets`: change it there. -->

No public set lies beside this repository. What is measured here are fakes: captures of a synthetic head in the exact
layout of each set, traps included, written from the set's own loader and datasheet and not from what reads them here.
Each goes from one line of configuration to `metrics.csv`. Errors are the largest over all cameras, lights and frames;
"between" are frames without a mesh, where the truth moves evenly. Sets under constant light have no lights to compare.
openillumination has no mesh at all: its error is how far true vertices lie from the visual hull of six masks, and
smaller [with more](#visual-hulls). Of sets with images under environments, scores of test images count these, too.
The subject is painted flat and the images are small: the decibels say that the pipeline works, not how good a set is.

Images stay in the set, which is as large after the run as before; "written" is all of `captures/<name>`: tables,
cameras, meshes. The tests of every set count what is decoded: the index decodes each image and mask once. Stages after
it decode again the images that they work on, `pack_shards` all of them.
"""

TAIL = """
## HumanOLAT's two directions

The set's own programs disagree whether its matrices lead from the world to the camera or back. A fake of each, and how
far the model overlaps the masks in either reading:

{directions}

## Lights of environments

HumanOLAT and OLATverse ship images under environments, and not how bright each light was in them. That is found from
images of single lights by the cameras that train; some hundredths of light stay unexplained, as AVIF is lossy. The
truth, lit by what was found, is compared with its image by a camera that took no part. Errors are root mean squares of
linear light over that of the image:

{environments}

## Exports, read back

Goliath's fake, imported, then exported to each layout, and read back by the readers of COLMAP's and nerfstudio's
cameras, or imported as Goliath again. Images are compared in the counts that the layout stores, of which AVIF is lossy;
COLMAP and nerfstudio have no place for lights and meshes.

{exports}

## Visual hulls

OpenIllumination's fake with more and more cameras on its ring: the more masks a hull is carved from, the nearer do true
vertices lie to it, until the pixels are the limit, of which a cell has two at least.

{hulls}
"""
"""What follows the pictures."""

WITHOUT_MASKS = ("faceolat",)


@dataclass(frozen=True)
class Row:
    """What one fake gave."""

    fake: FakeSet
    truth: TurningHead
    shipped_mb: float
    written_mb: float
    stages: int
    camera_px: float
    light_m: float
    given_m: float
    between_m: float
    psnr_db: float
    images: int


def run_fake(fake: FakeSet, folder: Path, steps: int) -> tuple[Row, Path]:
    """Write a fake, run the workflow on it, and compare; also the project's folder."""
    truth = fake.truth(image=fake.image)
    shipped = fake.write(folder / "sets", truth)
    before_mb = size_mb(shipped)
    project = folder / "project"
    project.mkdir()
    for name in COPIED:
        subprocess.run(["cp", "-r", name, str(project)], check=True)
    (project / "pipeline").symlink_to(Path("pipeline").resolve())
    settings = f"source: {fake.dataset}\npath: {shipped}\ntrain_avatar: {{steps: {steps}}}\n"
    settings += f"import_capture: {fake.settings(folder, truth)}\n"
    (project / f"config/subjects/{fake.name}.yaml").write_text(settings)
    target = f"results/{fake.name}/metrics.csv"
    subprocess.run([sys.executable, "-m", "snakemake", "--cores", "2", "--quiet", "all", "--", target],
                   cwd=project, check=True)  # fmt: skip
    if size_mb(shipped) != before_mb:
        raise SystemExit(f"{fake.name}: the set had {before_mb} MB before and has {size_mb(shipped)} after")
    return compared(fake, truth, shipped, project), project


def compared(fake: FakeSet, truth: TurningHead, shipped: Path, project: Path) -> Row:
    """Errors of what was imported, and the score."""
    results, capture = project / "results" / fake.name, project / "captures" / fake.name
    cameras = read_cameras(results / "calibration/cameras.json")
    tracked = read_arrays(results / "tracking/0000.safetensors")
    lights = read_table(results / "calibration/lights.parquet").sort_values("light")
    camera_px = max(camera_error(cameras, truth, fake.true_frame(int(frame))) for frame in tracked["frames"][:3])
    places = lights[["x", "y", "z"]].to_numpy()
    light_m = np.nan if fake.constant_light else float(np.abs(places - truth.lights_m).max())
    table = read_table(results / "tracking/0000.parquet")
    away = [
        mesh_error(vertices, truth.vertices(fake.true_frame(int(frame))))
        for frame, vertices in zip(tracked["frames"], tracked["vertices"], strict=True)
    ]
    given = (table.status == "given").to_numpy()
    scores = pd.read_csv(results / "metrics.csv").set_index(["split", "lit"])
    stages = len({path.name.split(".")[0] for path in (results / "logs").iterdir()})
    return Row(
        fake, truth, size_mb(shipped), size_mb(capture), stages, camera_px, light_m, float(np.max(away, where=given,
        initial=0)), float(np.max(away, where=~given, initial=0)),
        float(scores.psnr_db["test", "all"]), int(scores.images["test", "all"]),
    )  # fmt: skip


def size_mb(folder: Path) -> float:
    """Size of the files of a folder, links not followed, in megabytes."""
    return sum(path.lstat().st_size for path in folder.rglob("*") if path.is_file() and not path.is_symlink()) / 1e6


def page(rows: Sequence[Row], steps: int, before: str, tail: str) -> str:
    """The page as Markdown; rows of sets that were not run are those of the page before."""
    columns = ["set", "fake", "set before and after, MB", "written, MB", "stages", "cameras, px", "lights, m",
               "meshes, m", "between, m", "PSNR, dB"]  # fmt: skip
    lines = [HEAD, f"\n| {' | '.join(columns)} |\n", "|---" * len(columns), "|\n"]
    old = before.partition("\n## ")[0].splitlines()
    told = {line.split(" | ")[0].removeprefix("| "): line for line in old if line.startswith("| ")}
    for row in rows:
        name = next(iter(row.truth.cameras))
        width, height = row.truth.image_size(name)
        size = f"{row.fake.cameras} cameras, {len(row.truth.frames)} frames, {width} x {height}"
        values = (row.camera_px, row.light_m, row.given_m, row.between_m)
        errors = " | ".join("none" if np.isnan(value) else f"{value:.0e}" for value in values)
        told[row.fake.name] = (
            f"| {row.fake.name} | {size} | {row.shipped_mb:.2f} | {row.written_mb:.3f} | {row.stages} | {errors} | "
            f"{row.psnr_db:.1f} ({row.images} images) |"
        )
    shown = [fake for fake in FAKES if fake.name in told]
    lines += [f"{told[fake.name]}\n" for fake in shown]
    lines.append(f"\nAvatars were trained for {steps} steps; everything else is the defaults.\n")
    for fake in shown:
        masked = fake.name not in WITHOUT_MASKS
        mask = "the mask (pink)" if masked else "the true outline (pink), as the set has no masks"
        caption = f"{fake.name}: the imported mesh (yellow) through the imported cameras, and {mask}"
        lines.append(f"\n![{caption}](pictures/{picture_name(fake)})\n\n*{caption}.*\n")
    return "".join(lines) + tail


def told_tail(folder: Path) -> str:
    """Sections about what is decided, exported and carved."""
    sections = {
        "directions": direction_table(folder / "directions", (96, 144)),
        "environments": environment_table(folder / "environments", (96, 144)),
        "exports": export_table(folder / "exports", (96, 144)),
        "hulls": hull_table(folder / "hulls", (192, 288)),
    }
    return TAIL.format(**{name: "\n".join(lines) for name, lines in sections.items()})


def picture_name(fake: FakeSet) -> str:
    """File of a fake's picture."""
    return f"imported_{fake.name}.jpg"


def main() -> None:
    """Run all fakes, print the table and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=200, help="of training")
    parser.add_argument("--only", nargs="*", default=[fake.name for fake in FAKES], help="sets; the others stay")
    arguments = parser.parse_args()
    rows = []
    for fake in [fake for fake in FAKES if fake.name in arguments.only]:
        with tempfile.TemporaryDirectory() as folder:
            row, project = run_fake(fake, Path(folder), arguments.steps)
            draw(fake, row.truth, project, PICTURES / picture_name(fake))
        rows.append(row)
    with tempfile.TemporaryDirectory() as folder:
        text = page(rows, arguments.steps, PAGE.read_text(), told_tail(Path(folder)))
    print(text)
    PAGE.write_text(text)


if __name__ == "__main__":
    main()
