"""Start of a rig's bundle adjustment.

Each camera alone, then cameras joined through views they share.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import cv2
import numpy as np
import scipy.sparse
import scipy.sparse.csgraph
from jaxtyping import Float64

from pipeline.base.conventions import PIXEL_CENTER
from pipeline.calibration.cameras.rig import adjust_rig
from pipeline.calibration.cameras.rig_inputs import Observations
from pipeline.calibration.cameras.rig_join import BoardImage, Sighting, join_cameras, place_board, sight
from pipeline.geometry.cameras import Camera
from pipeline.geometry.lens import Lens
from pipeline.geometry.lenses import BROWN_CONRADY

LEAST_CORNERS = 6
"""Corners that a view needs to count: four determine a plane's pose, two more make it robust."""

PLAUSIBLE_FOCAL = (0.3, 30.0)
"""Focal length over the image's longer side, outside which (118 and 2 degrees wide) Zhang's start has failed."""

GUESSED_FOCAL = 1.2
"""Focal length over the longer side, of a 45 degree lens, where Zhang's start has failed."""


TRIED_FOCALS = np.geomspace(0.1, 3.0, 35)
"""Focal lengths over the longer side, 10 % apart, that a lens without a pinhole's homographies starts from: from a
circle of 220 degrees in the middle of a wide image to a lens so long that it is no fisheye."""

SCAN_ERROR_PX = 10.0
"""Scale of the robust loss by which they are compared: what 10 % of the focal length leave of a board's 200 pixels."""


@dataclass(frozen=True)
class Start:
    """Cameras and boards of one connected group, in the frame of its first view."""

    cameras: list[Camera]
    rig_from_board: Float64[np.ndarray, "views 4 4"]


def usable_views(observations: Observations, corners_m: Float64[np.ndarray, "corners 3"]) -> np.ndarray:
    """Mask of the rows whose (camera, view) has enough corners that do not lie on one line."""
    keep = np.zeros(len(observations.camera), bool)
    for rows in view_rows(observations).values():
        points = corners_m[observations.corner[rows], :2]
        spread = np.linalg.svd(points - points.mean(0), compute_uv=False)
        keep[rows] = len(rows) >= LEAST_CORNERS and spread[-1] > 0.1 * spread[0] / len(rows)
    return keep


def view_rows(observations: Observations) -> dict[tuple[int, int], np.ndarray]:
    """Rows of each (camera, view), in the order of cameras and views."""
    order = np.lexsort((observations.corner, observations.view, observations.camera))
    keys = np.stack([observations.camera, observations.view], 1)[order]
    if len(order) == 0:
        return {}
    starts = np.flatnonzero(np.any(np.diff(keys, axis=0, prepend=-1), axis=1))
    return {(int(c), int(v)): rows for (c, v), rows in zip(keys[starts], np.split(order, starts[1:]), strict=True)}


def connected_groups(observations: Observations, cameras: int) -> list[list[int]]:
    """Groups of cameras that share views, directly or through others; the largest first."""
    count = _shared_corners(observations, cameras)
    _, label = scipy.sparse.csgraph.connected_components(scipy.sparse.csr_array(count), directed=False)
    groups = [np.flatnonzero(label == g).tolist() for g in np.unique(label)]
    return sorted(groups, key=len, reverse=True)


def _shared_corners(observations: Observations, cameras: int) -> np.ndarray:
    """Corners that two cameras see in the same view, [cameras, cameras]."""
    views = int(observations.view.max()) + 1
    seen = np.zeros((cameras, views))
    np.add.at(seen, (observations.camera, observations.view), 1)
    shared = np.minimum(seen[:, None], seen[None]).sum(-1)
    np.fill_diagonal(shared, 0)
    return shared


def start_rig(
    observations: Observations, corners_m: Float64[np.ndarray, "corners 3"], sizes: Sequence[tuple[int, int]]
) -> Start:
    """The likeliest of `possible_starts`."""
    return possible_starts(observations, corners_m, sizes)[0]


def possible_starts(
    observations: Observations,
    corners_m: Float64[np.ndarray, "corners 3"],
    sizes: Sequence[tuple[int, int]],
    intrinsics: Sequence[Camera] | None = None,
    lens: Lens = BROWN_CONRADY,
) -> list[Start]:
    """Intrinsics and poses to start from, the likeliest first: some joins may be undecided. All must be connected.

    Args:
        sizes: (width, height) of each camera.
        intrinsics: cameras whose intrinsics are taken; None: each camera's own views give them.
        lens: the model of all lenses.
    """
    rows, cameras = view_rows(observations), []
    views = int(observations.view.max()) + 1
    sightings: dict[int, dict[int, Sighting]] = {v: {} for v in range(views)}
    for c, size in enumerate(sizes):
        mine = {
            v: BoardImage(corners_m[observations.corner[r]], observations.pixel[r])
            for (k, v), r in rows.items()
            if k == c
        }
        cameras.append(start_camera(list(mine.values()), size, lens) if intrinsics is None else intrinsics[c])
        for v, image in mine.items():
            sightings[v][c] = sight(cameras[-1], image)
    joined = join_cameras(sightings, _shared_corners(observations, len(sizes)))
    return [_in_first_view(cameras, sightings, from_root) for from_root in joined]


def _in_first_view(
    cameras: Sequence[Camera],
    sightings: Mapping[int, Mapping[int, Sighting]],
    from_root: Mapping[int, np.ndarray],
) -> Start:
    root_from_board = np.stack([place_board(sightings, from_root, v)[0] for v in sorted(sightings)])
    poses = [from_root[c] @ root_from_board[0] for c in range(len(cameras))]
    placed = [replace(camera, R=pose[:3, :3], t=pose[:3, 3]) for camera, pose in zip(cameras, poses, strict=True)]
    return Start(placed, np.linalg.inv(root_from_board[0]) @ root_from_board)


@contextmanager
def _one_opencv_thread() -> Iterator[None]:
    """Keep OpenCV on one thread.

    With more, calibrateCamera adds the views up in the order in which they are done, and results differ in the last
    digits from run to run.
    """
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


def start_camera(images: Sequence[BoardImage], size: tuple[int, int], lens: Lens = BROWN_CONRADY) -> Camera:
    """Intrinsics of one camera alone, from its images of boards; its pose is the identity."""
    if lens.perspective:
        return _start_by_homographies(images, size, lens)
    return _start_by_scan(images, size, lens)


def _start_by_homographies(images: Sequence[BoardImage], size: tuple[int, int], lens: Lens) -> Camera:
    """Zhang's method (2000), with one radial coefficient."""
    longer = max(size)
    guess = np.array([[GUESSED_FOCAL * longer, 0, size[0] / 2], [0, GUESSED_FOCAL * longer, size[1] / 2], [0, 0, 1]])
    K, dist = guess, lens.no_distortion()
    flags = cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3 | cv2.CALIB_FIX_ASPECT_RATIO
    flags |= cv2.CALIB_FIX_PRINCIPAL_POINT | cv2.CALIB_USE_INTRINSIC_GUESS
    board = [image.points.astype(np.float32)[:, None] for image in images]
    pixels = [(image.pixels - PIXEL_CENTER).astype(np.float32)[:, None] for image in images]
    if len(images) >= 2:
        opencv_K = guess - np.array([[0, 0, PIXEL_CENTER], [0, 0, PIXEL_CENTER], [0, 0, 0]])
        with _one_opencv_thread():
            error, found, found_dist, *_ = cv2.calibrateCamera(board, pixels, size, opencv_K, None, flags=flags)
        if np.isfinite(error) and PLAUSIBLE_FOCAL[0] < found[0, 0] / longer < PLAUSIBLE_FOCAL[1]:
            K, dist = found.copy(), np.asarray(found_dist, np.float64).ravel()[:5]
            K[:2, 2] += PIXEL_CENTER
    return Camera(np.eye(3), np.zeros(3), K.astype(np.float64), dist, *size, lens)


def _start_by_scan(images: Sequence[BoardImage], size: tuple[int, int], lens: Lens) -> Camera:
    """The best of `TRIED_FOCALS`, adjusted with all coefficients to the camera's own views."""
    tried = []
    for focal in TRIED_FOCALS * max(size):
        K = np.array([[focal, 0, size[0] / 2], [0, focal, size[1] / 2], [0, 0, 1]])
        camera = Camera(np.eye(3), np.zeros(3), K, lens.no_distortion(), *size, lens)
        poses, costs = zip(*(_best_pose(camera, image) for image in images), strict=True)
        tried.append((sum(costs), camera, np.stack(poses)))
    _, camera, poses = min(tried, key=lambda each: each[0])
    counts = [len(image.points) for image in images]
    whole = np.concatenate([image.points for image in images])
    numbers = np.arange(len(whole))
    observations = Observations(
        np.zeros_like(numbers), np.repeat(np.arange(len(images)), counts), numbers,
        np.concatenate([image.pixels for image in images]),
    )  # fmt: skip
    # View 0 is the frame of an adjustment.
    placed = replace(camera, R=poses[0, :3, :3], t=poses[0, :3, 3])
    rig = adjust_rig(observations, whole, [placed], np.linalg.inv(poses[0]) @ poses, len(lens.terms))
    return replace(rig.cameras[0], R=np.eye(3), t=np.zeros(3))


def _best_pose(camera: Camera, image: BoardImage) -> tuple[np.ndarray, float]:
    """The pose of a board that fits its image best, and its robust cost."""
    poses = sight(camera, image).camera_from_board
    costs = []
    for pose in poses:
        pixels = camera.project(image.points @ pose[:3, :3].T + pose[:3, 3])[0]
        squared = np.nan_to_num(((pixels - image.pixels) ** 2).sum(1), nan=np.inf)
        costs.append(float(np.log1p(squared / SCAN_ERROR_PX**2).sum()))
    best = int(np.argmin(costs))
    return poses[best], costs[best]
