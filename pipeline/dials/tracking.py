"""Dials of track_mesh."""

from __future__ import annotations

import numpy as np

from pipeline.base.files import read_arrays, read_table
from pipeline.dials.dial import CostedStage, Dial, Files, Metric
from pipeline.dials.subject import Subject
from pipeline.dials.tolerances import YARDSTICKS, small_length_mm
from pipeline.geometry.cameras import read_cameras
from pipeline.metrics.output_errors import align_rigs

SMALLEST_PX, LARGEST_PX = 16, 1024
"""Longer sides of masks and images: what the stage takes, and twice its default, beyond which a sweep takes hours."""


def _distances_mm(subject: Subject, output: Files, expected: Files) -> np.ndarray:
    """Of every vertex in every tracked frame to where it should be; the expected frames may be more.

    Where the truth is known, once the cameras lie over the true ones: that the survey of the lights puts the stage's
    frame elsewhere is no fault of the tracking. A better tracking is in the same frame.
    """
    found, wanted = read_arrays(output["tracking"]), read_arrays(expected["tracking"])
    row_of = {int(frame): row for row, frame in enumerate(wanted["frames"])}
    true = wanted["vertices"][[row_of[int(frame)] for frame in found["frames"]]].astype(np.float64)
    vertices = found["vertices"].astype(np.float64)
    if "rig" in expected:
        used = read_cameras(subject.results / "calibration/cameras.json")
        vertices = align_rigs(used, read_cameras(expected["rig"])).apply(vertices)
    return 1000 * np.linalg.norm(vertices - true, axis=2)


def _vertices(subject: Subject, output: Files, expected: Files) -> float:
    return float(np.median(_distances_mm(subject, output, expected)))


def _bad_vertices(subject: Subject, output: Files, expected: Files) -> float:
    return float(np.percentile(_distances_mm(subject, output, expected), 95))


def _image_sizes(subject: Subject) -> list[int]:
    """Longer sides in pixels, from an eighth of the images' to all of it or LARGEST_PX."""
    sides = read_table(subject.results / "index/cameras.parquet")[["width", "height"]]
    largest = min(int(sides.to_numpy().max()), LARGEST_PX)
    return sorted({max(largest // part, SMALLEST_PX) for part in (8, 4, 2, 1)})


TRACKING = CostedStage(
    name="track_mesh",
    files={"trackings": "{out}"},
    inputs=(
        "index/frames.parquet",
        "index/cameras.parquet",
        "index/images.parquet",
        "index/keypoints_2d.parquet",
        "patterns.parquet",
        "calibration/lights.parquet",
        *YARDSTICKS,
    ),
    outputs={"tracking": ("0000.safetensors", "tracking.safetensors"), "rig": (None, "cameras.json")},
    metrics=(
        Metric("vertex in the rig, median, mm", _vertices, small_length_mm),
        Metric("vertex in the rig, 95 % are better, mm", _bad_vertices, small_length_mm),
    ),
    unit="vertex-frames",
    work=lambda output: int(np.prod(read_arrays(output["tracking"])["vertices"].shape[:2])),
)

TRACKING_DIALS = [
    # Without images; with 0 rounds of outlines, keypoints are all that is left.
    Dial("keypoints_outlines", TRACKING, "outline_rounds", lambda subject: (0, 1, 2, 3, 5, 8), {"image_rounds": 0}),
    Dial("outline_rounds", TRACKING, "outline_rounds", lambda subject: (0, 1, 2, 3, 5, 8)),
    Dial("mask_size", TRACKING, "outline_size_px", _image_sizes),
    # Chosen by nobody: what colours gain depends on how far off a capture's keypoints are.
    Dial("image_rounds", TRACKING, "image_rounds", lambda subject: (0, 1, 2, 3, 5)),
    Dial("image_size", TRACKING, "image_size_px", _image_sizes),
    Dial("image_points", TRACKING, "image_points", lambda subject: (200, 500, 1500, 4000)),
    Dial("iterations", TRACKING, "max_iterations", lambda subject: (1, 2, 3, 5, 10, 30)),
]
