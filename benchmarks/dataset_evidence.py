"""What the page of fakes shows beside their errors: directions, environments, exports, visual hulls."""

from __future__ import annotations

import contextlib
import logging
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pycolmap
from scipy.spatial import cKDTree

from pipeline.base.color import corrected, srgb_from_linear
from pipeline.base.errors import Complaints
from pipeline.base.files import read_arrays, read_json, read_table
from pipeline.base.yaml_files import read_yaml
from pipeline.capture.cameras.known_cameras import read_known_cameras
from pipeline.capture.images import ImageSource
from pipeline.capture.schema.camera_schema import KnownCameras
from pipeline.config.import_capture import ImportCapture
from pipeline.datasets.environment_weights import CHANNELS
from pipeline.effects.scene_evidence import read_colors
from pipeline.geometry.cameras import Camera, read_cameras
from pipeline.geometry.mesh_files import decode_mesh
from pipeline.stages import export_capture, import_capture
from tests.support.datasets import goliath_layout, humanolat_layout, olatverse_layout, openillumination_layout
from tests.support.datasets.imported import import_set
from tests.support.datasets.turning_head import TurningHead

DIRECTIONS = ("camera-from-world", "world-from-camera")
"""Of HumanOLAT's matrices."""

LAYOUTS = {"colmap": ("sparse/0", "{}.png"), "nerfstudio": ("transforms.json", "{}")}
"""Layouts of cameras, images and masks: where cameras are, and the name of an image's mask."""

MASKS = (6, 12, 22, 48)
"""How many hulls are carved from: those of the fake, and of the set's two kinds of capture 22 and 48."""


def mesh_error(vertices: np.ndarray, true: np.ndarray) -> float:
    """Largest error of a coordinate; of another mesh, such as a hull, the largest distance of a true vertex from it."""
    if vertices.shape == true.shape:
        return float(np.abs(vertices - true).max())
    return float(cKDTree(vertices).query(true)[0].max())


def camera_error(cameras: Mapping[str, Camera], truth: TurningHead, frame: int) -> float:
    """Largest error of a true vertex's projection, pixels; true cameras count from the first pixel's centre."""
    points = truth.vertices(frame)
    return max(
        float(np.abs(camera.project(points)[0] - truth.cameras[name].project(points) - 0.5).max())
        for name, camera in cameras.items()
    )


def direction_table(folder: Path, image: tuple[int, int]) -> list[str]:
    """Lines of a table: HumanOLAT's fake, written in each direction, and what its masks decide."""
    truth = humanolat_layout.true_head(image=image)
    lines = ["| written as | overlap, read as the first | as the second | taken as | cameras, px |", "|---" * 5 + "|"]
    for written in DIRECTIONS:
        shipped = humanolat_layout.write_humanolat(folder / written, truth, written)
        capture = folder / written / "capture"
        import_capture.run(dataset="humanolat", source=shipped, subject="x", out=capture)
        said = read_yaml(capture / "capture.yaml")["imported"]["given"]["cameras"]
        taken, first, second = re.search(r"read as ([\w-]+), as .*?\(\S+ ([\d.]+), \S+ ([\d.]+)\)", said).groups()
        off = camera_error(read_cameras(capture / "cameras.json"), truth, humanolat_layout.FULL)
        lines.append(f"| {written} | {first} | {second} | {taken} | {off:.0e} |")
    return lines


def environment_table(folder: Path, image: tuple[int, int]) -> list[str]:
    """Lines of a table: lights found for images under environments, seen by a camera that took no part."""
    columns = ("set", "image", "light that is not explained", "of the held-out camera's image", "lights, correlation")
    lines = [f"| {' | '.join(columns)} |", "|---" * len(columns) + "|"]
    for dataset, layout, truth, write, unit, camera in (
        ("humanolat", humanolat_layout, humanolat_layout.true_head, humanolat_layout.write_humanolat, 1.0,
         humanolat_layout.TEST_CAMERA),
        ("olatverse", olatverse_layout, olatverse_layout.true_object, olatverse_layout.write_olatverse,
         olatverse_layout.INTENSITY, olatverse_layout.BENCHMARK_TEST_CAMERA),
    ):  # fmt: skip
        true, capture = truth(image=image), folder / dataset / "capture"
        shipped = write(folder / dataset / "set", true)
        with logged("pipeline.datasets.environment_weights") as said:
            import_capture.run(dataset=dataset, source=shipped, subject="x", out=capture)
        patterns = pd.read_csv(capture / "patterns.csv")
        for frame in layout.ENVIRONMENTS:
            misfit = next(line.args[1] for line in said if line.args[0] == frame)
            rows = patterns[patterns.frame == frame].set_index("light")
            shades = {int(name[1:]): unit * np.array(row, float) for name, row in rows[CHANNELS].iterrows()}
            shown = true.image(camera, frame)
            error = float(np.sqrt(((true.lit_by(camera, frame, shades) - shown) ** 2).sum() / (shown**2).sum()))
            both = np.array([[shades.get(k, np.zeros(3)), shade] for k, shade in true.frames[frame].items()]).mean(2)
            lines.append(f"| {dataset} | {frame} | {misfit:.3f} | {error:.3f} | {np.corrcoef(both.T)[0, 1]:.3f} |")
    return lines


@contextlib.contextmanager
def logged(name: str) -> Iterator[list[logging.LogRecord]]:
    """Collect what a log says meanwhile."""
    found, log = [], logging.getLogger(name)
    handler, level = logging.Handler(), log.level
    handler.emit = found.append
    log.addHandler(handler)
    log.setLevel(logging.INFO)
    try:
        yield found
    finally:
        log.removeHandler(handler)
        log.setLevel(level)


def hull_table(folder: Path, image: tuple[int, int]) -> list[str]:
    """Lines of a table: how far true vertices of OpenIllumination's fake lie from hulls of more and more masks."""
    lines = ["| masks | from the hull, m | pixel of a mask, m |", "|---" * 3 + "|"]
    for count in MASKS:
        # Beside those of the fake, others than it has without a pose or without images.
        own = openillumination_layout.CAMERAS
        names = sorted([*own, *(f"E{number}" for number in range(count - len(own)))])
        truth = openillumination_layout.true_object(image=image, names=names)
        truth = replace(truth, frames=dict(list(truth.frames.items())[:2]))  # A hull needs no more.
        shipped = openillumination_layout.write_openillumination(folder / str(count), truth)
        capture, chosen = folder / f"{count}/capture", ImportCapture(hull_cells=256)
        import_capture.run(dataset="openillumination", source=shipped, subject="x", out=capture, settings=chosen)
        hull = decode_mesh((capture / "mesh.ply").read_bytes(), capture / "mesh.ply")
        camera = truth.cameras[names[0]]
        away = np.linalg.norm(camera.R @ truth.vertices(0).mean(0) + camera.t)
        lines.append(f"| {count} | {mesh_error(hull.vertices, truth.vertices(0)):.4f} | {away / camera.K[0, 0]:.4f} |")
    return lines


@dataclass(frozen=True)
class Recorded:
    """A native capture with its results: what is exported, or what an export is read as."""

    capture: Path
    results: Path

    @property
    def images(self) -> pd.DataFrame:
        """Its images, by camera and frame."""
        return read_table(self.results / "index/images.parquet").set_index(["camera", "frame"]).sort_index()

    @property
    def cameras(self) -> dict[str, Camera]:
        """Its cameras, at the images' resolution."""
        facts = read_json(self.results / "index/capture.json")["images"]
        found = read_cameras(self.results / "calibration/cameras.json")
        return {name: camera.downsampled(float(facts["downsample_from_sensor"])) for name, camera in found.items()}

    def read(self, row: pd.Series, camera: str) -> tuple[np.ndarray, np.ndarray | None]:
        """Linear light of an image, and its mask."""
        source = ImageSource.from_index(self.capture, read_json(self.results / "index/capture.json")["images"])
        image = source.read(row.path, None)
        mask = source.read_mask(row.mask_path, image.shape) if isinstance(row.mask_path, str) else None
        colors = read_colors(self.results / "calibration/color.json")
        return corrected(image, colors[camera].astype(np.float32)), mask


def export_table(folder: Path, image: tuple[int, int]) -> list[str]:
    """Lines of a table: Goliath's fake, exported to each layout and read back by that layout's reader."""
    shipped = goliath_layout.write_goliath(folder / "set", goliath_layout.true_head(image=image))
    first = Recorded(*import_set("goliath", shipped, folder / "first"))
    results, calibration = first.results, first.results / "calibration"
    for layout in (*LAYOUTS, "goliath"):
        export_capture.run(
            subject="someone", layout=layout, capture=first.capture, index=results / "index",
            cameras=calibration / "cameras.json", color=calibration / "color.json", out=folder / layout,
            lights=calibration / "lights.parquet", patterns=results / "index/patterns.parquet",
            tracking=(results / "tracking/0000.safetensors",),
        )  # fmt: skip
    rigs = pycolmap.Reconstruction(folder / "colmap/sparse/0")
    structure = f"{rigs.num_rigs()} rig of {rigs.num_cameras()} cameras, {rigs.num_reg_frames()} frames"
    again = Recorded(*import_set("goliath", folder / "goliath/someone--Head", folder / "again"))
    return [
        "| layout | read back | cameras, px | images, of 255 | masks that differ | lights, m | meshes, poses, m |",
        "|---" * 7 + "|",
        f"| colmap | {structure} | {_files_row(first, folder, 'colmap')} | none | none |",
        f"| nerfstudio | all images | {_files_row(first, folder, 'nerfstudio')} | none | none |",
        f"| goliath | imported again, {again.images.index.get_level_values(1).nunique()} frames | "
        f"{_again_row(first, again)} |",
    ]


def _files_row(first: Recorded, folder: Path, layout: str) -> str:
    path, mask_name = LAYOUTS[layout]
    section = KnownCameras.model_validate({"method": "known", "format": "auto", "path": path})
    sizes, complaints = {name: (c.width, c.height) for name, c in first.cameras.items()}, Complaints(folder)
    found = read_known_cameras(folder / layout, section, sizes, complaints)
    complaints.raise_if_any()
    off, differ = 0.0, 0
    for (camera, frame), row in first.images.iterrows():
        linear, mask = first.read(row, camera)
        name = f"{camera}/{frame:06d}.png"
        stored = cv2.imread(str(folder / layout / "images" / name))[..., ::-1]
        off = max(off, float(np.abs(stored - 255 * srgb_from_linear(np.clip(linear, 0, 1))).max()))
        beside = folder / layout / "masks" / mask_name.format(name)
        differ += beside.is_file() != (mask is not None)
        if mask is not None:
            differ += not np.array_equal(cv2.imread(str(beside), cv2.IMREAD_UNCHANGED), mask)
    return f"{_same_cameras(first.cameras, found):.0e} | {off:.2g} | {differ}"


def _again_row(first: Recorded, again: Recorded) -> str:
    off, differ, rows = 0.0, 0, again.images
    for (camera, frame), row in first.images.iterrows():
        (linear, mask), (other, masked) = first.read(row, camera), again.read(rows.loc[camera, frame], camera)
        # In the layout's own counts, which are linear.
        off = max(off, float((255 * np.abs(other - linear) / goliath_layout.WHITE_BALANCE).max()))
        differ += not np.array_equal(*(each if each is not None else np.zeros(0) for each in (mask, masked)))
    places = [read_table(each.results / "calibration/lights.parquet")[["x", "y", "z"]] for each in (first, again)]
    moved = [read_arrays(each.results / "tracking/0000.safetensors") for each in (first, again)]
    parts = [np.abs(moved[0][part] - moved[1][part]).max() for part in ("vertices", "root_translation")]
    return (
        f"{_same_cameras(first.cameras, again.cameras):.0e} | {off:.2g} | {differ} | "
        f"{np.abs(places[0].to_numpy() - places[1].to_numpy()).max():.0e} | {max(parts):.0e}"
    )


def _same_cameras(first: Mapping[str, Camera], other: Mapping[str, Camera]) -> float:
    """Largest difference of projections of points about a metre away."""
    in_camera = np.random.default_rng(0).uniform([-0.2, -0.2, 0.8], [0.2, 0.2, 1.2], (50, 3))
    return max(
        float(np.abs(other[name].project(points)[0] - camera.project(points)[0]).max())
        for name, camera in first.items()
        for points in [camera.center + in_camera @ camera.R]
    )
