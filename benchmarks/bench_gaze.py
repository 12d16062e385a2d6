"""Gaze from images against the truth of a synthesised head, and how much of an iris skin seems to show.

Of a head that has been through the workflow up to book_patterns and track_mesh, whatever gaze it declares:
`python -m benchmarks.bench_gaze --capture captures/subjectB --results results/subjectB --irises 0.5 --detect`
With `--irises`, also with irises as a detector finds them that is so many pixels off; with `--detect`, with those that
MediaPipe finds (`make detect`). The capture's own keypoints do not count: a synthetic detector's pupil is the middle of
the cornea, as the template's vertex is, and not that of the iris, which lies 2 mm behind.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks.true_eyes import read_true_eyes
from pipeline.base.files import read_arrays, read_json, read_table, write_table
from pipeline.capture.head_data import head_motions
from pipeline.capture.images import ImageSource
from pipeline.eyes.eye_pixels import join_views, seen_pixels
from pipeline.eyes.eye_shape import usual_shape
from pipeline.eyes.gaze_estimate import estimate_gaze
from pipeline.geometry.cameras import read_cameras
from pipeline.geometry.depth_maps import draw_depth
from pipeline.geometry.texels import read_atlas
from pipeline.stages import detect_landmarks
from pipeline.stages.estimate_gaze import run, training_images

PATCHES_M = {
    "brow": (0.032, 0.032, 0.0725), "cheek": (0.044, -0.030, 0.0625), "mouth": (0.0, -0.055, 0.0745),
    "temple": (0.062, 0.010, 0.0325), "nose": (0.0, -0.020, 0.0975),
}  # fmt: skip
"""Centres of spheres in the procedural head at rest, as large as eyes, over which there is skin and no eye."""

RADIUS_M = 0.0125

TURNED_DEG = 60.0
"""Angle between an eye's axis and the way to a camera up to which a detector finds its iris."""


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--capture", type=Path, required=True, help="folder of the capture, with its truth")
    parser.add_argument("--results", type=Path, required=True, help="its results")
    parser.add_argument("--irises", type=float, help="standard deviation of detected irises, image pixels")
    parser.add_argument("--detect", action="store_true", help="also with irises that MediaPipe finds")
    options = parser.parse_args()
    index = options.results / "index"
    points = {"pixels alone": no_irises()}
    if options.irises is not None:
        points[f"with irises {options.irises:g} px off"] = irises(options.capture, index, options.irises)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if options.detect:
            points["with irises by MediaPipe"] = detected(options.capture, folder / "detected")
            print(iris_errors(options.capture, index, points["with irises by MediaPipe"]))
        shutil.copytree(index, folder / "index")
        for label, table in points.items():
            write_table(folder / "index/eye_points.parquet", table)
            found = summary(errors(options.capture, options.results, folder / "index", folder))
            print(f"{label}:", found.to_string(index=False), sep="\n")
    print(skin(options.capture, options.results).to_string(index=False))


def no_irises() -> pd.DataFrame:
    """A table of eye points without rows."""
    kinds = {"frame": "int64", "camera": "str", "point": "str", "x": "float64", "y": "float64", "confidence": "float64"}
    return pd.DataFrame({column: pd.Series(dtype=kind) for column, kind in kinds.items()})


def detected(capture: Path, folder: Path) -> pd.DataFrame:
    """Points of eyes that MediaPipe finds in the fully lit frames."""
    detect_landmarks.run(capture=capture, out=folder)
    return read_table(folder / "eye_points.parquet")


@dataclass(frozen=True)
class IrisErrors:
    """Detected irises against the true ones.

    Attributes:
        visible, found: irises that can be seen in fully lit frames, and how many of these were found.
        median_px, most_px: their errors, median and 90th percentile.
        unseen: irises that were found where none is to be seen.
    """

    visible: int
    found: int
    median_px: float
    most_px: float
    unseen: int


def iris_errors(capture: Path, index: Path, found: pd.DataFrame) -> IrisErrors:
    """How far detected irises are from the true ones."""
    true = irises(capture, index, 0.0)
    true = true[true.frame.isin(found.frame)]
    both = true.merge(found, on=["frame", "camera", "point"], suffixes=("", "_found"))
    middle, most = np.percentile(np.hypot(both.x - both.x_found, both.y - both.y_found), [50, 90])
    pupils = int(found.point.str.endswith("_pupil").sum())
    return IrisErrors(len(true), len(both), float(middle), float(most), pupils - len(both))


def errors(capture: Path, results: Path, index: Path, folder: Path) -> pd.DataFrame:
    """Table of gaze with its angles to the truth, degrees; `folder` is written to."""
    out = folder / "gaze.parquet"
    run(
        capture=capture, index=index, atlas=results / "atlas.safetensors", cameras=_cameras(results),
        tracking=_chunks(results), frames=results / "frames.parquet", out=out,
    )  # fmt: skip
    true, table = read_true_eyes(capture), read_table(out)
    looks = np.stack([true.looks(int(frame)) for frame in table.frame])
    given = table[["x", "y", "z"]].to_numpy()
    table["angle"] = np.degrees(np.arctan2(np.linalg.norm(np.cross(given, looks), axis=1), (given * looks).sum(1)))
    return table


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """Angles to the truth, degrees, by eye, of estimated frames and of those in between."""
    by = table.groupby(["eye", "interpolated"]).angle
    found = by.agg(frames="count", rms_deg=lambda a: np.sqrt((a**2).mean()), median_deg="median", largest_deg="max")
    return found.round(2).reset_index()


def irises(capture: Path, index: Path, error_px: float) -> pd.DataFrame:
    """Detected middles of irises: of eyes that look at a camera within `TURNED_DEG` and whose iris no skin hides."""
    true, random, rows = read_true_eyes(capture), np.random.default_rng(0), []
    factor = float(read_json(index / "capture.json")["images"]["downsample_from_sensor"])
    images = read_table(index / "images.parquet")
    for frame, name in zip(images.frame, images.camera, strict=True):
        camera = true.cameras[name].downsampled(factor)
        for eye, shape in true.shapes.items():
            center, axis = true.placed(eye, int(frame), true.looks(int(frame)))
            iris = center + shape.radius_m * np.cos(shape.limbus_angle) * axis
            toward = (camera.center - iris) / np.linalg.norm(camera.center - iris)
            hidden = not true.passing(iris, axis, int(frame), (camera.center,), 0.1 * shape.radius_m)[0]
            if hidden or toward @ axis < np.cos(np.radians(TURNED_DEG)):
                continue
            pixel = camera.project(iris[None])[0][0] + random.normal(0, error_px, 2)
            rows.append((int(frame), name, f"{eye}_pupil", *pixel, 0.9))
    return pd.DataFrame(rows, columns=["frame", "camera", "point", "x", "y", "confidence"])


def iris_width(capture: Path, index: Path) -> float:
    """Largest width of an iris in the images, pixels."""
    true, widths = read_true_eyes(capture), []
    factor = float(read_json(index / "capture.json")["images"]["downsample_from_sensor"])
    for eye, shape in true.shapes.items():
        place = true.placed(eye, min(true.motions), np.array([0.0, 0.0, 1.0]))[0]
        across = 2 * shape.radius_m * np.sin(shape.limbus_angle)
        widths += [across * c.K[0, 0] / factor / np.linalg.norm(c.center - place) for c in true.cameras.values()]
    return float(max(widths))


def skin(capture: Path, results: Path) -> pd.DataFrame:
    """Share that an iris explains of patches of skin, over the fully lit frames."""
    index, texels = results / "index", read_atlas(results / "atlas.safetensors")
    facts, booked = read_json(index / "capture.json")["images"], read_table(results / "frames.parquet")
    cameras = {
        n: c.downsampled(float(facts["downsample_from_sensor"])) for n, c in read_cameras(_cameras(results)).items()
    }
    images = training_images(
        read_table(index / "images.parquet"), booked.frame[booked.fully_lit.astype(bool)].tolist(), cameras, 0
    )
    source, faces, rows = ImageSource.from_index(capture, facts), texels.faces.astype(np.int64), []
    posed = {}
    for path in _chunks(results):
        arrays = read_arrays(path)
        motions = head_motions(arrays)
        posed |= {f: (v, motions[f]) for f, v in zip(arrays["frames"].tolist(), arrays["vertices"], strict=True)}
    shown: dict[str, list] = {name: [] for name in PATCHES_M}
    for frame, pictures in images.groupby("frame"):
        vertices, head = (array.astype(np.float64) for array in posed[frame])
        seen: dict[str, list] = {name: [] for name in PATCHES_M}
        for row in pictures.itertuples():
            camera, image = cameras[row.camera], source.read(row.path, int(frame))
            behind = draw_depth(camera, vertices, faces) + np.float32(RADIUS_M)
            for name, place in PATCHES_M.items():
                seen[name].append(seen_pixels(camera, image, behind, head, np.array(place), RADIUS_M))
        for name in PATCHES_M:
            shown[name].append(join_views(seen[name]))
    for name, frames in shown.items():
        found = estimate_gaze(frames, usual_shape(RADIUS_M))
        explained = [estimate.explained for estimate in found]
        taken = sum(estimate.status == "estimated" for estimate in found)
        rows.append((name, len(found), taken, round(min(explained), 2), round(max(explained), 2)))
    return pd.DataFrame(rows, columns=["skin", "frames", "taken_for_eyes", "explained_least", "explained_most"])


def _cameras(results: Path) -> Path:
    return results / "calibration/cameras.json"


def _chunks(results: Path) -> tuple[Path, ...]:
    return tuple(sorted((results / "tracking").glob("[0-9]*.safetensors")))


if __name__ == "__main__":
    main()
