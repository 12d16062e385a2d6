"""Features of the subject, found and matched by COLMAP.

They are SIFT's, within the masks, and cameras of one moment are matched with each other.

Cameras stand still and the subject moves, so that features of one moment match those of the same moment alone. All
moments' features of a camera then count as those of one image: to a camera that stands still, a subject that moved is
more points. Mapping needs no frames and no rig for that, and has as many images as there are cameras.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pycolmap
from jaxtyping import Float32, UInt8

from pipeline.base.color import srgb_from_linear
from pipeline.capture.images import ImageSource, write_png

WHITE_PERCENTILE = 99.5
"""Brightness of the subject that becomes white: few highlights decide nothing."""

RIM = 100
"""A hundredth of an image's longer side within a mask's outline is left out: there, what lies behind shows, and an
outline is no point of the surface."""

SEED = 1
"""Of what COLMAP draws at random."""

Key = tuple[str, int]
"""Camera and moment."""

FLAT = {
    pycolmap.TwoViewGeometryConfiguration.PLANAR,
    pycolmap.TwoViewGeometryConfiguration.PANORAMIC,
    pycolmap.TwoViewGeometryConfiguration.PLANAR_OR_PANORAMIC,
}
"""Of matches that one homography explains: those of a plane, or of cameras at one place."""


@dataclass(frozen=True)
class PairMatches:
    """Features that two cameras share.

    Attributes:
        found: pairs of features that are alike.
        verified: those that fit one relative pose, or one homography.
        flat: whether a homography explains them: they tell no depth.
    """

    first: str
    second: str
    found: int
    verified: int
    flat: bool


def write_features(
    source: ImageSource, views: Sequence[Mapping[str, Any]], folder: Path, threads: int
) -> dict[Key, Float32[np.ndarray, "features 2"]]:
    """Find features in the views, and match those of each moment, into `folder`/moments.db.

    Args:
        views: entries of calibration_cameras.json: camera, view, path, and mask if there is one.

    Returns:
        pixels of the features by camera and moment; the image's corner is (0, 0).
    """
    pycolmap.logging.minloglevel = pycolmap.logging.WARNING
    names = {(view["camera"], view["view"]): f"{number:06d}.png" for number, view in enumerate(views)}
    for view in views:
        _write_view(source, view, folder, names[view["camera"], view["view"]])
    database, pairs = folder / "moments.db", folder / "moments.txt"
    reader = pycolmap.ImageReaderOptions(mask_path=str(folder / "masks"))
    pycolmap.extract_features(
        database, folder / "images", camera_mode=pycolmap.CameraMode.PER_IMAGE, reader_options=reader,
        extraction_options=pycolmap.FeatureExtractionOptions(num_threads=threads, use_gpu=False),
        device=pycolmap.Device.cpu,
    )  # fmt: skip
    lines = [f"{names[a]} {names[b]}\n" for a, b in combinations(sorted(names), 2) if a[1] == b[1]]
    pairs.write_text("".join(lines))
    pycolmap.match_image_pairs(
        database,
        pycolmap.FeatureMatchingOptions(num_threads=threads, use_gpu=False, skip_geometric_verification=True),
        pycolmap.ImportedPairingOptions(match_list_path=str(pairs)),
        device=pycolmap.Device.cpu,
    )
    with pycolmap.Database.open(database) as tables:
        ids = {image.name: image.image_id for image in tables.read_all_images()}
        return {key: tables.read_keypoints(ids[name])[:, :2] for key, name in names.items()}


def join_moments(
    features: Mapping[Key, Float32[np.ndarray, "features 2"]], lenses: Mapping[str, pycolmap.Camera], folder: Path
) -> dict[str, list[Key]]:
    """Write `folder`/rig.db: an image per camera, with all moments' features and matches.

    COLMAP verifies them.

    Args:
        features: of `write_features`, whose matches are taken from `folder`.
        lenses: of each camera, numbered from 1 in this order, as are the images.

    Returns:
        by camera, its keys in the order of their features in the image.
    """
    cameras = list(lenses)
    keys = {name: sorted(key for key in features if key[0] == name) for name in cameras}
    counts = {name: np.cumsum([0, *(len(features[key]) for key in keys[name])]) for name in cameras}
    first = {key: int(counts[name][place]) for name in cameras for place, key in enumerate(keys[name])}
    # As written: entries number the images of moments from 1, in the order of the views.
    with pycolmap.Database.open(folder / "moments.db") as found:
        ids = {image.name: image.image_id for image in found.read_all_images()}
        numbers = {key: ids[f"{place:06d}.png"] for place, key in enumerate(features)}
        with pycolmap.Database.open(folder / "rig.db") as joined:
            for number, name in enumerate(cameras, 1):
                _write_image(joined, number, name, lenses[name])
                points = [features[key] for key in keys[name]]
                joined.write_keypoints(number, np.concatenate(points) if points else np.zeros((0, 2), np.float32))
            for (i, a), (j, b) in combinations(enumerate(cameras, 1), 2):
                shared = []
                for p, q in ((p, q) for p in keys[a] for q in keys[b] if p[1] == q[1]):
                    own = np.asarray(found.read_matches(numbers[p], numbers[q]), np.int64).reshape(-1, 2)
                    shared.append(own + np.array([first[p], first[q]]))
                if shared and sum(map(len, shared)):
                    joined.write_matches(i, j, np.concatenate(shared).astype(np.uint32))
    pairs = folder / "rig.txt"
    pairs.write_text("".join(f"{a} {b}\n" for a, b in combinations(cameras, 2)))
    options = pycolmap.TwoViewGeometryOptions()
    options.ransac.random_seed = SEED
    pycolmap.verify_matches(folder / "rig.db", pairs, options)
    return keys


def count_matches(cameras: Sequence[str], folder: Path) -> list[PairMatches]:
    """Matches of every two cameras, as `join_moments` wrote them into `folder`."""
    counts = []
    with pycolmap.Database.open(folder / "rig.db") as joined:
        for (i, a), (j, b) in combinations(enumerate(cameras, 1), 2):
            if joined.exists_two_view_geometry(i, j):
                geometry = joined.read_two_view_geometry(i, j)
                kind = pycolmap.TwoViewGeometryConfiguration(geometry.config)
                alike, fitting = len(joined.read_matches(i, j)), len(geometry.inlier_matches)
                counts.append(PairMatches(a, b, alike, fitting, kind in FLAT))
            else:
                counts.append(PairMatches(a, b, 0, 0, False))
    return counts


def _write_view(source: ImageSource, view: Mapping[str, Any], folder: Path, name: str) -> None:
    image = source.read(view["path"], view["view"])
    inside = np.ones(image.shape[:2], np.uint8)
    if "mask" in view:
        reach = 2 * max(1, round(max(image.shape) / RIM)) + 1
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (reach, reach))
        inside = cv2.erode((source.read_mask(view["mask"], image.shape) > 127).astype(np.uint8), disc)
    # COLMAP leaves images without a mask out, once there is a folder of masks.
    write_png(folder / "masks" / f"{name}.png", inside * np.uint8(255))
    write_png(folder / "images" / name, _brightened(image, inside))


def _brightened(image: Float32[np.ndarray, "h w 3"], inside: UInt8[np.ndarray, "h w"]) -> UInt8[np.ndarray, "h w"]:
    """Mean of the channels in sRGB, the subject's brightest part white."""
    gray = image.mean(2)
    white = float(np.percentile(gray[inside > 0], WHITE_PERCENTILE)) if inside.any() else 1.0
    encoded = srgb_from_linear(np.clip(gray / np.float32(max(white, 1e-9)), 0, 1))
    return np.round(255 * np.nan_to_num(encoded)).astype(np.uint8)


def _write_image(database: pycolmap.Database, number: int, name: str, lens: pycolmap.Camera) -> None:
    """An image of a camera of its own, on a rig and in a frame of its own."""
    database.write_camera(lens, use_camera_id=True)
    rig = pycolmap.Rig(rig_id=number)
    rig.add_ref_sensor(lens.sensor_id)
    database.write_rig(rig, use_rig_id=True)
    database.write_image(pycolmap.Image(name=name, camera_id=number, image_id=number), use_image_id=True)
    frame = pycolmap.Frame(frame_id=number, rig_id=number)
    frame.add_data_id(pycolmap.data_t(lens.sensor_id, number))
    database.write_frame(frame, use_frame_id=True)
