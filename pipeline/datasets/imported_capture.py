"""A capture of a public set in this project's conventions, before it is written."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd
from jaxtyping import Float64

from pipeline.capture.mask_format import PLAIN_MASKS, MaskFormat
from pipeline.geometry.cameras import Camera
from pipeline.geometry.mesh_files import Mesh


@dataclass(frozen=True)
class ImageStore:
    """Images of a set, and how it stores them.

    Attributes:
        table: camera, frame, path and mask_path (null without a mask), relative to the set's folder.
        sizes: width and height of each camera's images.
        transfer: how stored values relate to light.
        black_level: stored value of no light, of all channels or of R, G and B.
        downsample_from_sensor: sensor pixels along a side of an image's pixel.
        masks: what the values of masks mean.
        reduced: stored pixels along a side of an image's pixel; sizes and `downsample_from_sensor` are those after it.
        clean_plates: path of each camera's image of the empty stage, fully lit, with {camera}; empty: there is none.
    """

    table: pd.DataFrame
    sizes: Mapping[str, tuple[int, int]]
    transfer: Literal["linear", "srgb", "gamma_2.2"]
    black_level: float | Sequence[float]
    downsample_from_sensor: int
    masks: MaskFormat = PLAIN_MASKS
    reduced: int = 1
    clean_plates: str = ""


OWN_MESH = "mesh.ply"
"""A mesh that was made here or lies elsewhere, in the folder of the capture."""


@dataclass(frozen=True)
class TrackedMeshes:
    """Meshes that a set ships, or that were made of it.

    Attributes:
        table: frame, path (relative to the set's folder), world_from_mesh (12 numbers, t in metres, or None).
        scale_to_m: metres per unit of their vertices.
        rest: the mesh at rest, metres; if the motion is given, in the frame that `world_from_mesh` starts from.
        motion: given, if `world_from_mesh` is how the template moves; fitted, if it only takes vertices to the world.
        elsewhere: files that are not in the set's folder, by their paths of the table; the capture gets copies.
        in_set: False if the set has no mesh: then `rest` is written beside the tables, as `OWN_MESH`, which the paths
            name.
    """

    table: pd.DataFrame
    scale_to_m: float
    rest: Mesh
    motion: Literal["given", "fitted"] = "given"
    elsewhere: Mapping[str, Path] = field(default_factory=dict)
    in_set: bool = True

    def of_frames(self, frames: Collection[int]) -> TrackedMeshes:
        """The meshes of these frames."""
        return replace(self, table=self.table[self.table.frame.isin(list(frames))].reset_index(drop=True))

    def file(self, root: Path, path: str) -> Path:
        """The file that a path of the table names."""
        return self.elsewhere.get(path, root / path)


@dataclass(frozen=True)
class Keypoints:
    """Keypoints that a set has in its images.

    Attributes:
        order: how they are numbered, as `keypoints_order` of capture.yaml names it.
        places: keypoint (the order's point) and vertex of the mesh.
        pieces: makes their tables (frame, camera, keypoint, x, y, confidence; pixels), read one after the other.
    """

    order: str
    places: pd.DataFrame
    pieces: Callable[[], Iterator[pd.DataFrame]]

    def reduced(self, factor: int) -> Keypoints:
        """The keypoints in images that are `factor` times smaller."""
        return replace(
            self, pieces=lambda: (piece.assign(x=piece.x / factor, y=piece.y / factor) for piece in self.pieces())
        )


@dataclass(frozen=True)
class HeldOut:
    """Names and numbers that are never trained on, as in the tables."""

    cameras: Sequence[str] = ()
    frames: Sequence[int] = ()
    segments: Sequence[str] = ()
    patterns: Sequence[int] = ()
    validation_patterns: Sequence[int] | None = None
    validation_cameras: Sequence[str] | None = None


@dataclass(frozen=True)
class Provenance:
    """Notes of what a set gave, what it lacks, what of it is not used, and what is assumed.

    Keys say what; values from where it is taken, by which stage it is made, why it is not used, or what stands for it.
    """

    given: dict[str, str] = field(default_factory=dict)
    computed: dict[str, str] = field(default_factory=dict)
    left_out: dict[str, str] = field(default_factory=dict)
    assumed: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class ImportedCapture:
    """Everything that a native capture says, in this project's conventions.

    Metres, y up, OpenCV's cameras, pixels counted from the image's corner.

    Attributes:
        kind: what of the subject is captured.
        fps: frames per second, of frame numbers.
        cameras: at sensor resolution.
        frames: frame, timestamp_s, segment.
        images: where they are and how they store light.
        lights: light, x, y, z.
        patterns: frame, light, intensity, one row per lit light.
        colors: corrected-from-raw matrix of each camera (`corrected`); none at all if colours are as recorded.
        meshes: tracked elsewhere.
        held_out: the set's own split.
        provenance: said in the capture, and on the report.
        constant_light: True if the light never changes and the set does not say where it comes from; lights and
            patterns then stand for it.
        keypoints: in its images; None: none.
    """

    kind: Literal["body", "head"]
    fps: float
    cameras: Mapping[str, Camera]
    frames: pd.DataFrame
    images: ImageStore
    lights: pd.DataFrame
    patterns: pd.DataFrame
    colors: Mapping[str, Float64[np.ndarray, "3 columns"]]
    meshes: TrackedMeshes
    held_out: HeldOut
    provenance: Provenance
    constant_light: bool = False
    keypoints: Keypoints | None = None
