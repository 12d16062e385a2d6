"""Fully lit images and tracked meshes in, gaze.parquet out, as a capture would declare it.

For captures that list their eyes and not their gaze. Of fully lit frames gaze is estimated from the pixels that show an
eye, see `pipeline.eyes.gaze_estimate`; other frames lie between. Where lids hide an eye, or the pixels show no iris, it
is undefined, which the log, the verdicts and quality_gaze.parquet say: such a frame counts as one in between, too.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float32, Float64, Int64

from pipeline.base.command import run_as_command
from pipeline.base.errors import InputError
from pipeline.base.files import read_arrays, read_json, read_rows, read_table, write_table
from pipeline.base.progress import progress
from pipeline.base.spread import evenly
from pipeline.base.verdicts import log_verdicts, verdict_table
from pipeline.capture.head_data import head_motions
from pipeline.capture.images import ImageSource
from pipeline.capture.index.eye_tables import gaze_of_all_frames
from pipeline.config.estimate_gaze import EstimateGaze
from pipeline.eyes.closed_lids import open_together
from pipeline.eyes.eye_fit import RADII_M, sphere_through
from pipeline.eyes.eye_pixels import EyePixels, join_views, seen_pixels
from pipeline.eyes.eye_shape import usual_shape
from pipeline.eyes.eye_verdicts import estimate_verdict
from pipeline.eyes.gaze_estimate import GazeEstimate, estimate_gaze
from pipeline.eyes.iris_gaze import add_irises
from pipeline.geometry.cameras import Camera, read_cameras
from pipeline.geometry.depth_maps import draw_depth
from pipeline.geometry.texels import Atlas, read_atlas

log = logging.getLogger("estimate_gaze")

COLUMNS = ("frame", "eye", "x", "y", "z", "interpolated")


def run(
    *, capture: Path, index: Path, atlas: Path, tracking: tuple[Path, ...], cameras: Path, frames: Path, out: Path,
    settings: EstimateGaze = EstimateGaze(),
) -> None:  # fmt: skip
    """Estimate where the eyes of a capture look.

    Args:
        capture: folder of the capture, for its fully lit images by training cameras.
        index: folder of index_capture, for eyes.parquet and eye_points.parquet, detected irises and contours, if any.
        atlas: atlas.safetensors of unwrap_atlas, for the template at rest.
        tracking: all chunks of track_mesh.
        cameras: cameras.json in the stage frame, sensor resolution.
        frames: frames.parquet of book_patterns.
        out: gaze.parquet; quality_gaze.parquet and verdicts_gaze.csv are written beside it.
        settings: see the flags below.
    """
    eyes, texels = read_table(index / "eyes.parquet"), read_atlas(atlas)
    if eyes.empty:
        raise InputError(f"{index}/eyes.parquet: expected the vertices of each eye, found none; see template.eyes")
    parts = {str(name): rows.vertex.to_numpy(np.int64) for name, rows in eyes.groupby("eye")}
    spheres = {name: _sphere(name, texels, part) for name, part in parts.items()}
    booked = read_table(frames).sort_values("frame", ignore_index=True)
    posed = _posed(tracking)
    lit = booked.frame[booked.fully_lit.astype(bool) & booked.frame.isin(list(posed))].tolist()
    facts = read_json(index / "capture.json")["images"]
    calibrated = {n: c.downsampled(float(facts["downsample_from_sensor"])) for n, c in read_cameras(cameras).items()}
    images = training_images(read_table(index / "images.parquet"), lit, calibrated, settings.views)
    skin = texels.faces[~np.isin(texels.faces, eyes.vertex).all(1)].astype(np.int64)
    source = ImageSource.from_index(capture, facts)
    shown: dict[str, list[EyePixels]] = {name: [] for name in parts}
    for frame in progress(lit, "frames"):
        pictures = images[images.frame == frame].itertuples()
        seen = [
            _seen(source.read(row.path, frame), calibrated[row.camera], skin, posed[frame], spheres) for row in pictures
        ]
        for name, pixels in shown.items():
            pixels.append(join_views([picture[name] for picture in seen]))
    shapes = {name: usual_shape(float(sphere[3])) for name, sphere in spheres.items()}
    found = open_together({name: estimate_gaze(pixels, shapes[name]) for name, pixels in shown.items()})
    points = read_rows(index / "eye_points.parquet", "frame", lit)
    points = points[points.camera.isin(images.camera)]
    if len(points):
        log.info("irises and contours of eyes in %d images", len(points.groupby(["frame", "camera"])))
        heads = {frame: posed[frame][1] for frame in lit}
        found = add_irises(found, points, lit, calibrated, heads, spheres, shapes)
    verdicts = [estimate_verdict(name, lit, estimates) for name, estimates in found.items()]
    log_verdicts(log, verdicts)
    write_table(out.with_name("quality_gaze.parquet"), quality_table(lit, found))
    write_table(out.with_name("verdicts_gaze.csv"), verdict_table(verdicts))
    write_table(out, gaze_table(booked, lit, found))


def training_images(images: pd.DataFrame, lit: list[int], calibrated: Mapping[str, Camera], most: int) -> pd.DataFrame:
    """Images of some frames by calibrated cameras that are not held out.

    By `most` of these cameras, or, for 0, by all.
    """
    names = sorted(set(images.camera[~images.test_camera.astype(bool)]) & set(calibrated))
    chosen = evenly(names, most or len(names))
    return images[images.camera.isin(chosen) & images.frame.isin(lit)].sort_values(["frame", "camera"])


def quality_table(lit: list[int], found: Mapping[str, list[GazeEstimate]]) -> pd.DataFrame:
    """One row per fully lit frame and eye: how its gaze was estimated, and how well it is known."""
    names = ("status", "sigma_deg", "explained", "views", "pixels")
    rows = [
        (frame, name, *(getattr(estimate, column) for column in names))
        for name, estimates in found.items()
        for frame, estimate in zip(lit, estimates, strict=True)
    ]
    return pd.DataFrame(rows, columns=["frame", "eye", *names]).sort_values(["frame", "eye"], ignore_index=True)


def gaze_table(booked: pd.DataFrame, lit: list[int], found: Mapping[str, list[GazeEstimate]]) -> pd.DataFrame:
    """Table with `COLUMNS`, a row per booked frame and eye.

    Empty unless every eye was seen in some frame.
    """
    rows = [
        (frame, name, *estimate.direction)
        for name, estimates in found.items()
        for frame, estimate in zip(lit, estimates, strict=True)
        if estimate.status == "estimated"
    ]
    known = pd.DataFrame(rows, columns=["frame", "eye", "x", "y", "z"])
    if set(known.eye) != set(found):
        empty = pd.DataFrame({"frame": pd.Series(dtype="int64"), "eye": pd.Series(dtype=str)})
        return empty.assign(**{axis: pd.Series(dtype="float64") for axis in "xyz"}, interpolated=pd.Series(dtype=bool))
    return gaze_of_all_frames(known, booked)[list(COLUMNS)]


def _seen(
    image: Float32[np.ndarray, "h w 3"], camera: Camera, skin: Int64[np.ndarray, "f 3"],
    pose: tuple[np.ndarray, np.ndarray], spheres: Mapping[str, np.ndarray],
) -> dict[str, EyePixels]:  # fmt: skip
    """What one picture shows of each eye."""
    vertices, head = pose
    depth = draw_depth(camera, vertices, skin)
    return {
        name: seen_pixels(camera, image, depth, head, sphere[:3], float(sphere[3])) for name, sphere in spheres.items()
    }


def _sphere(name: str, atlas: Atlas, part: np.ndarray) -> Float64[np.ndarray, "4"]:
    """Centre and radius of an eyeball at rest, metres.

    Raises:
        InputError: if the vertices are none of the atlas, or lie on no eyeball.
    """
    if part[-1] >= len(atlas.rest_vertices):
        raise InputError(f"eyes.parquet: {name}: expected vertices of the atlas, found {part[-1]}")
    sphere = sphere_through(atlas.rest_vertices[part].astype(np.float64))
    if not RADII_M[0] <= sphere[3] <= RADII_M[1]:
        raise InputError(
            f"{name}: expected vertices on a sphere with a radius of {1e3 * RADII_M[0]:g} to {1e3 * RADII_M[1]:g} mm, "
            f"found {1e3 * sphere[3]:.2f} mm; check scale_to_m and that template.eyes lists eyeballs"
        )
    return sphere


def _posed(tracking: tuple[Path, ...]) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """Vertices in the world and [R | t], head from world, by frame, in float64."""
    found = {}
    for path in tracking:
        arrays = read_arrays(path)
        motions = head_motions(arrays)
        for frame, vertices in zip(arrays["frames"].tolist(), arrays["vertices"], strict=True):
            found[frame] = vertices.astype(np.float64), motions[frame].astype(np.float64)
    return found


def main() -> None:
    """Command line of this stage."""
    run_as_command(run)


if __name__ == "__main__":
    main()
