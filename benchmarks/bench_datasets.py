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

import cv2
import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from benchmarks.fake_sets import FAKES, FakeSet
from pipeline.base.color import corrected, srgb_from_linear
from pipeline.base.files import read_arrays, read_json, read_table
from pipeline.capture.images import ImageSource
from pipeline.effects.scene_evidence import read_colors
from pipeline.geometry.cameras import read_cameras
from pipeline.geometry.skin import read_template
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
openillumination has no mesh at all: its error is how far true vertices lie from the visual hull of six masks. The
subject is painted flat and the images are small: the decibels say that the pipeline works, not how good a set is.

Images stay in the set, which is as large after the run as before; "written" is all of `captures/<name>`: tables,
cameras, meshes. The tests of every set count what is decoded: the index decodes each image and mask once, and of eight
frames a second time, to see whether cameras were exchanged. Stages after it decode again the images that they work on,
`pack_shards` all of them.
"""

WITHOUT_MASKS = ("faceolat",)

SHOWN_SIDE = 420
"""Height of a picture's panels, pixels."""

SHOWN_FACES = 500
"""Triangles of a mesh that are drawn, evenly chosen: all edges of a fine one would hide the image."""


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
    (project / f"config/subjects/{fake.dataset}.yaml").write_text(settings)
    target = f"results/{fake.dataset}/metrics.csv"
    subprocess.run([sys.executable, "-m", "snakemake", "--cores", "2", "--quiet", "all", "--", target],
                   cwd=project, check=True)  # fmt: skip
    if size_mb(shipped) != before_mb:
        raise SystemExit(f"{fake.dataset}: the set had {before_mb} MB before and has {size_mb(shipped)} after")
    return compared(fake, truth, shipped, project), project


def compared(fake: FakeSet, truth: TurningHead, shipped: Path, project: Path) -> Row:
    """Errors of what was imported, and the score."""
    results, capture = project / "results" / fake.dataset, project / "captures" / fake.dataset
    cameras = read_cameras(results / "calibration/cameras.json")
    tracked = read_arrays(results / "tracking/0000.safetensors")
    lights = read_table(results / "calibration/lights.parquet").sort_values("light")
    camera_px = max(
        float(np.abs(camera.project(points)[0] - truth.cameras[name].project(points) - 0.5).max())
        for name, camera in cameras.items()
        for points in [truth.vertices(fake.true_frame(int(frame))) for frame in tracked["frames"][:3]]
    )
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


def mesh_error(vertices: np.ndarray, true: np.ndarray) -> float:
    """Largest error of a coordinate; of another mesh, such as a hull, the largest distance of a true vertex from it."""
    if vertices.shape == true.shape:
        return float(np.abs(vertices - true).max())
    return float(cKDTree(vertices).query(true)[0].max())


def size_mb(folder: Path) -> float:
    """Size of the files of a folder, links not followed, in megabytes."""
    return sum(path.lstat().st_size for path in folder.rglob("*") if path.is_file() and not path.is_symlink()) / 1e6


def draw(fake: FakeSet, project: Path, path: Path, most: int = 4) -> None:
    """Write a picture: images of several cameras with the mask's outline and the projected mesh."""
    results, capture = project / "results" / fake.dataset, project / "captures" / fake.dataset
    described, images = read_json(results / "index/capture.json"), read_table(results / "index/images.parquet")
    source = ImageSource.from_index(capture, described["images"])
    cameras = read_cameras(results / "calibration/cameras.json")
    colors = read_colors(results / "calibration/color.json")
    faces = read_template(capture / described["template"]["mesh"], 1.0).faces
    faces = faces[:: -(-len(faces) // SHOWN_FACES)]
    tracked = read_arrays(results / "tracking/0000.safetensors")
    vertices = dict(zip(tracked["frames"].tolist(), tracked["vertices"].astype(np.float64), strict=True))
    # Without masks, fully lit images with a mesh of their own.
    tracking, frames = read_table(results / "tracking/0000.parquet"), read_table(results / "frames.parquet")
    seen = set(tracking.frame[tracking.status == "given"]) & set(frames.frame[frames.fully_lit])
    masked = images[images.mask_path.notna() if images.mask_path.notna().any() else images.frame.isin(seen)]
    names = sorted(masked.camera.unique())
    chosen = [names[i] for i in np.linspace(0, len(names) - 1, min(most, len(names))).round().astype(int)]
    panels = []
    for number, name in enumerate(chosen):
        rows = masked[masked.camera == name].sort_values("frame")
        row = rows.iloc[number * (len(rows) - 1) // max(len(chosen) - 1, 1)]
        image = corrected(source.read(row.path, row.frame), colors[name].astype(np.float32))
        mask = source.read_mask(row.mask_path, image.shape) if pd.notna(row.mask_path) else None
        small = cameras[name].downsampled(float(described["images"]["downsample_from_sensor"]))
        pixels, _ = small.project(vertices[row.frame])
        panels.append(panel(image, mask, pixels[faces], f"{name}, {row.frame}"))
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.hstack(panels)[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 90])


def panel(image: np.ndarray, mask: np.ndarray | None, triangles: np.ndarray, title: str) -> np.ndarray:
    """An image enlarged, with the mask's outline in pink and the mesh's edges in yellow."""
    factor = SHOWN_SIDE / image.shape[0]
    size = (round(image.shape[1] * factor), SHOWN_SIDE)
    bright = srgb_from_linear(np.clip(image / max(float(np.percentile(image, 99)), 1e-6), 0, 1))
    shown = cv2.resize((255 * bright).astype(np.uint8), size, interpolation=cv2.INTER_NEAREST)
    # From the corner of the first pixel to OpenCV's pixel centres, in sixteenths.
    lines = np.round((triangles * factor - 0.5) * 16).astype(np.int32)
    cv2.polylines(shown, list(lines), isClosed=True, color=(240, 200, 40), lineType=cv2.LINE_AA, shift=4)
    if mask is not None:
        large = cv2.resize(mask, size, interpolation=cv2.INTER_NEAREST)
        outlines, _ = cv2.findContours((large >= 128).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(shown, outlines, -1, (230, 90, 170), 2, cv2.LINE_AA)
    cv2.putText(shown, title, (8, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255, 255, 255), 1, cv2.LINE_AA)
    return shown


def page(rows: Sequence[Row], steps: int, before: str) -> str:
    """The page as Markdown; rows of sets that were not run are those of the page before."""
    columns = ["set", "fake", "set before and after, MB", "written, MB", "stages", "cameras, px", "lights, m",
               "meshes, m", "between, m", "PSNR, dB"]  # fmt: skip
    lines = [HEAD, f"\n| {' | '.join(columns)} |\n", "|---" * len(columns), "|\n"]
    told = {line.split(" | ")[0].removeprefix("| "): line for line in before.splitlines() if line.startswith("| ")}
    for row in rows:
        name = next(iter(row.truth.cameras))
        width, height = row.truth.image_size(name)
        size = f"{row.fake.cameras} cameras, {len(row.truth.frames)} frames, {width} x {height}"
        values = (row.camera_px, row.light_m, row.given_m, row.between_m)
        errors = " | ".join("none" if np.isnan(value) else f"{value:.0e}" for value in values)
        told[row.fake.dataset] = (
            f"| {row.fake.dataset} | {size} | {row.shipped_mb:.2f} | {row.written_mb:.3f} | {row.stages} | {errors} | "
            f"{row.psnr_db:.1f} ({row.images} images) |"
        )
    shown = [fake for fake in FAKES if fake.dataset in told]
    lines += [f"{told[fake.dataset]}\n" for fake in shown]
    lines.append(f"\nAvatars were trained for {steps} steps; everything else is the defaults.\n")
    for fake in shown:
        mask = "" if fake.dataset in WITHOUT_MASKS else ", and the mask (pink)"
        caption = f"{fake.dataset}: the imported mesh (yellow) through the imported cameras{mask}"
        lines.append(f"\n![{caption}](pictures/{picture_name(fake)})\n\n*{caption}.*\n")
    return "".join(lines)


def picture_name(fake: FakeSet) -> str:
    """File of a fake's picture."""
    return f"imported_{fake.dataset}.jpg"


def main() -> None:
    """Run all fakes, print the table and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=200, help="of training")
    parser.add_argument("--only", nargs="*", default=[fake.dataset for fake in FAKES], help="sets; the others stay")
    arguments = parser.parse_args()
    rows = []
    for fake in [fake for fake in FAKES if fake.dataset in arguments.only]:
        with tempfile.TemporaryDirectory() as folder:
            row, project = run_fake(fake, Path(folder), arguments.steps)
            draw(fake, project, PICTURES / picture_name(fake))
        rows.append(row)
    text = page(rows, arguments.steps, PAGE.read_text())
    print(text)
    PAGE.write_text(text)


if __name__ == "__main__":
    main()
