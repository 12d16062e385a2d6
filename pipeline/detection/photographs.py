"""Photographs of a capture's fully lit frames, as 8-bit pictures for a detector."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float32

from pipeline.base.errors import Complaints, InputError
from pipeline.capture.images import ImageSource, write_png
from pipeline.capture.index import tables
from pipeline.capture.index.contents import relative_exposures
from pipeline.capture.index.feature_views import fully_lit
from pipeline.capture.index.frame_images import find_frame_images, mask_format
from pipeline.capture.index.keypoint_tables import read_points_csv
from pipeline.capture.index.template_checks import read_keypoint_places
from pipeline.capture.schema.capture_yaml import Capture
from pipeline.capture.schema.manifest import read_manifest

WHITE_PERCENTILE = 99.5
"""Brightness that is shown as white, so that few highlights decide nothing: a stage's background is black."""

DARKEST = 1e-9
"""Brightness of an image below which it is left black."""


@dataclass(frozen=True)
class Photographs:
    """Images of a capture for a detector.

    Attributes:
        manifest: capture.yaml.
        images: camera, frame, path of the images to look at.
        sizes: width and height by camera.
        frames: of the capture, in all.
        keypoints: the template's, by the point that each is, as far as that is known.
        source: reads the images.
    """

    manifest: Capture
    images: pd.DataFrame
    sizes: dict[str, tuple[int, int]]
    frames: int
    keypoints: Mapping[str, str]
    source: ImageSource

    @property
    def said(self) -> str:
        """The share of the frames that is looked at, for a log."""
        return f"{self.images.frame.nunique()} of {self.frames} frames, {len(self.images)} images"


def read_photographs(capture: Path, every_frame: bool) -> Photographs:
    """Read the capture's tables, and choose the images of fully lit frames.

    Args:
        every_frame: True to choose those of all frames.

    Raises:
        InputError: naming what is wrong with the tables, or that no frame is fully lit.
    """
    complaints = Complaints(capture)
    manifest = read_manifest(capture, complaints)
    complaints.raise_if_any()
    cameras = tables.read_cameras_csv(capture, manifest.cameras, manifest.images.downsample_from_sensor, complaints)
    frames = tables.read_frames_csv(capture, manifest.frames, complaints)
    lights = tables.read_lights_csv(capture, manifest.lights, complaints)
    patterns = tables.read_patterns_csv(capture, manifest.patterns, frames, lights, complaints)
    images = find_frame_images(capture, manifest, cameras, frames, complaints)
    places = read_keypoint_places(capture, manifest.template.keypoints, complaints)
    names = [] if places is None else list(places.keypoint)
    keypoints = read_points_csv(capture, manifest.template.points, names, complaints)
    complaints.raise_if_any()
    if not every_frame:
        images = images[images.frame.isin(fully_lit(patterns, len(lights)))].reset_index(drop=True)
        if images.empty:
            raise InputError(
                f"{manifest.patterns}: expected fully lit frames, which list every light, found none; "
                "set `frames: all` to look at frames under any light"
            )
    facts = manifest.images
    source = ImageSource(
        capture, facts.transfer, facts.black_level, mask_format(manifest), exposures=relative_exposures(frames)
    )  # fmt: skip
    sizes = {row.camera: (int(row.width), int(row.height)) for row in cameras.itertuples()}
    return Photographs(manifest, images, sizes, len(frames), keypoints, source)


def exposed(image: Float32[np.ndarray, "h w 3"]) -> Float32[np.ndarray, "h w 3"]:
    """A linear image scaled so that `WHITE_PERCENTILE` of it is 1, clipped to 0 .. 1."""
    white = float(np.percentile(image, WHITE_PERCENTILE))
    return np.clip(image / np.float32(max(white, DARKEST)), 0, 1)


def write_pictures(photographs: Photographs, folder: Path) -> Path:
    """Write each image as an sRGB picture of 8 bits.

    Returns:
        the csv beside them: image, path, camera, frame.
    """
    rows = []
    for number, row in enumerate(photographs.images.itertuples()):
        path = folder / f"{number:06d}.png"
        write_png(path, exposed(photographs.source.read(row.path, row.frame)))
        rows.append((f"{number:06d}", str(path), row.camera, row.frame))
    table = folder / "images.csv"
    pd.DataFrame(rows, columns=["image", "path", "camera", "frame"]).to_csv(table, index=False)
    return table
