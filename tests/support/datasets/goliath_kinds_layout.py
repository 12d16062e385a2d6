"""Goliath captures of a hand and of a body in the exact layout of the set, with their traps.

Vertices, in millimetres, lie in the world and list no faces; neither has head poses. A hand has masks of ones in
segmentation_fgbg, and its template is unscaled, of another size than the hand; it has meshes and masks in fully lit
frames alone. A body is always fully lit, and has no folder of lights. Poses, one number a line, need a skeleton that
the set has elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.support.datasets.goliath_layout import (
    DURATION,
    LIGHTS,
    avif,
    light_pattern,
    part_labels,
    pattern_of,
    ply,
    png,
    stored,
    write_cameras,
    write_lights,
    write_lists,
    write_zip,
)
from tests.support.datasets.turning_head import TurningHead, dome_of_lights, ring_of_cameras

HANDS = "m--20230306--0839--AAA000--pilot--ProjectGoliath--Hands--left"
BODY = "s--20230306--1509--AAA000--pilot--ProjectGoliath--ClothedBody"
CAMERAS = ["400001", "400017", "401645", "400130"]
"""The third is one of the loader's example test cameras."""

HAND_SEGMENTS = {"hand_fist": range(7), "SEN_fox": range(7, 13)}
BODY_SEGMENTS = {"body_walk": range(3, 27, 3), "SEN_fox": range(30, 39, 3)}
"""Bodies count the recorded frames, of which every third is shipped."""

INTENSITY = 0.3
POSE_NUMBERS, SCALE_NUMBERS = 98, 12
UNSCALED = 1.25
"""Of the template of hands over the hand."""


def true_hand(image: tuple[int, int] = (48, 72)) -> TurningHead:
    """The truth of a hand; `image` is width and height of the shipped images."""
    numbers = [frame for span in HAND_SEGMENTS.values() for frame in span]
    frames = {n: {k: d / DURATION for k, d in light_pattern(pattern_of(n))} for n in numbers}
    lit = tuple(n for n in numbers if pattern_of(n) == 0)
    return TurningHead(ring_of_cameras(CAMERAS, _sensor(image)), 2, dome_of_lights(LIGHTS), frames, lit)


def true_body(image: tuple[int, int] = (48, 72)) -> TurningHead:
    """The truth of a body, its light always the same."""
    numbers = [frame for span in BODY_SEGMENTS.values() for frame in span]
    lit = dict.fromkeys(range(LIGHTS), INTENSITY)
    cameras = ring_of_cameras(CAMERAS, _sensor(image))
    return TurningHead(cameras, 2, dome_of_lights(LIGHTS), dict.fromkeys(numbers, lit), tuple(numbers))


def write_hands(folder: Path, truth: TurningHead, registered: bool = True) -> Path:
    """Write the capture of a hand below a folder; without registrations there is a template to be posed."""
    root, lit = folder / HANDS, [frame for frame in truth.frames if pattern_of(frame) == 0]
    _write(root, truth, HAND_SEGMENTS, stored)
    write_lights(root, truth)
    for name in CAMERAS:
        masks = {f"cam{name}/{n:06d}.png": png(np.sign(part_labels(truth, name, n) % 3)) for n in lit}
        write_zip(root / f"segmentation_fgbg/cam{name}.zip", masks)
    if registered:
        _write_vertices(root, truth, lit)
    template = root / "kinematic_tracking/template_mesh_unscaled.ply"
    template.write_bytes(ply(UNSCALED * 1000 * truth.in_head(0), truth.faces))
    return root


def write_body(folder: Path, truth: TurningHead) -> Path:
    """Write the capture of a body below a folder; returns its own folder."""
    root = folder / BODY
    _write(root, truth, BODY_SEGMENTS, lambda linear: np.clip(np.round(255 * linear), 0, 255).astype(np.uint8))
    for name in CAMERAS:
        labels = {f"cam{name}/{n:06d}.png": png(part_labels(truth, name, n)) for n in truth.frames}
        write_zip(root / f"segmentation_parts/cam{name}.zip", labels)
    _write_vertices(root, truth, list(truth.frames))
    (root / "kinematic_tracking/template_mesh.ply").write_bytes(ply(1000 * truth.in_head(3), truth.faces))
    rows = np.concatenate([np.eye(3), [[0.0], [-900.0], [0.0]]], axis=1)
    (root / "floor_transformation.txt").write_text("\n".join(" ".join(map(repr, row)) for row in rows.tolist()) + "\n")
    return root


def _sensor(image: tuple[int, int]) -> tuple[int, int]:
    return 2 * image[0], 2 * image[1]


def _write(
    root: Path, truth: TurningHead, segments: dict[str, range], counts: Callable[[np.ndarray], np.ndarray]
) -> None:
    """What both kinds have: cameras, lists, images, poses."""
    (root / "kinematic_tracking").mkdir(parents=True)
    write_cameras(root, truth)
    write_lists(root, segments)
    for name in CAMERAS:
        images = {f"cam{name}/{n:06d}.avif": avif(counts(truth.image(name, n))) for n in truth.frames}
        write_zip(root / f"image/cam{name}.zip", images)
    poses = {f"pose/{n:06d}.txt": b"0.0\n" * POSE_NUMBERS for n in truth.frames}
    write_zip(root / "kinematic_tracking/pose.zip", poses)
    (root / "kinematic_tracking/skeleton_scales.txt").write_text("1.0\n" * SCALE_NUMBERS)


def _write_vertices(root: Path, truth: TurningHead, frames: list[int]) -> None:
    meshes = {f"registration_vertices/{n:06d}.ply": ply(1000 * truth.vertices(n)) for n in frames}
    write_zip(root / "kinematic_tracking/registration_vertices.zip", meshes)
