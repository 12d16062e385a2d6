"""Where the bundle adjustment of a rig starts: each camera alone, then cameras joined through views they share.

A small board seen from afar fits two poses almost equally, one the other's mirror image in depth (Collins and Bartoli
2014). Both are kept until the other cameras decide: a pair of cameras may share no more than one or two views.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import scipy.sparse
import scipy.sparse.csgraph
from jaxtyping import Float64

from pipeline.base.conventions import PIXEL_CENTER
from pipeline.geometry.cameras import Camera
from pipeline.geometry.rig_model import Observations

LEAST_CORNERS = 6
"""Corners that a view needs to count: four determine a plane's pose, two more make it robust."""

PLAUSIBLE_FOCAL = (0.3, 30.0)
"""Focal length over the image's longer side, outside which (118 and 2 degrees wide) Zhang's start has failed."""

GUESSED_FOCAL = 1.2
"""Focal length over the longer side, of a 45 degree lens, where Zhang's start has failed."""

START_ERROR_PX = 3.0
"""Reprojection error of a pose that one camera sees in another: about ten times the noise of corners, because the pose
of one view is all that it rests on. It only scales a robust loss by which such poses are compared."""


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


@dataclass(frozen=True)
class _Sighting:
    """One view by one camera: corners [n, 3], where they are on the plane z = 1 [n, 2], and the poses that fit."""

    points: np.ndarray
    normalized: np.ndarray
    focal: float
    camera_from_board: np.ndarray


def start_rig(
    observations: Observations, corners_m: Float64[np.ndarray, "corners 3"], sizes: Sequence[tuple[int, int]]
) -> Start:
    """Intrinsics and poses to start from; `sizes` are (width, height). All cameras must be connected."""
    rows, cameras = view_rows(observations), []
    sightings: dict[tuple[int, int], _Sighting] = {}
    for c, size in enumerate(sizes):
        mine = {v: (corners_m[observations.corner[r]], observations.pixel[r]) for (k, v), r in rows.items() if k == c}
        camera = start_camera(list(mine.values()), size)
        cameras.append(camera)
        for v, (points, pixels) in mine.items():
            sightings[c, v] = _sight(camera, points, pixels)
    from_root = _join(sightings, _shared_corners(observations, len(sizes)))
    views = int(observations.view.max()) + 1
    root_from_board = np.stack([_place_board(sightings, from_root, v) for v in range(views)])
    first = root_from_board[0]
    placed = []
    for c, camera in enumerate(cameras):
        pose = from_root[c] @ first
        placed.append(Camera(pose[:3, :3], pose[:3, 3], camera.K, camera.dist, camera.width, camera.height))
    return Start(placed, np.linalg.inv(first) @ root_from_board)


def start_camera(views: Sequence[tuple[np.ndarray, np.ndarray]], size: tuple[int, int]) -> Camera:
    """Intrinsics of one camera alone, by Zhang's method; its pose is the identity.

    Args:
        views: (corners [n, 3] metres, pixels [n, 2]) of each view.
    """
    longer = max(size)
    guess = np.array([[GUESSED_FOCAL * longer, 0, size[0] / 2], [0, GUESSED_FOCAL * longer, size[1] / 2], [0, 0, 1]])
    K, dist = guess, np.zeros(5)
    flags = cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3 | cv2.CALIB_FIX_ASPECT_RATIO
    flags |= cv2.CALIB_FIX_PRINCIPAL_POINT | cv2.CALIB_USE_INTRINSIC_GUESS
    board = [points.astype(np.float32)[:, None] for points, _ in views]
    pixels = [(pixel - PIXEL_CENTER).astype(np.float32)[:, None] for _, pixel in views]
    if len(views) >= 2:
        opencv_K = guess - np.array([[0, 0, PIXEL_CENTER], [0, 0, PIXEL_CENTER], [0, 0, 0]])
        error, found, found_dist, *_ = cv2.calibrateCamera(board, pixels, size, opencv_K, None, flags=flags)
        if np.isfinite(error) and PLAUSIBLE_FOCAL[0] < found[0, 0] / longer < PLAUSIBLE_FOCAL[1]:
            K, dist = found.copy(), np.asarray(found_dist, np.float64).ravel()[:5]
            K[:2, 2] += PIXEL_CENTER
    return Camera(np.eye(3), np.zeros(3), K.astype(np.float64), dist, *size)


def _sight(camera: Camera, points: np.ndarray, pixels: np.ndarray) -> _Sighting:
    normalized, poses = camera.undistort(pixels), []
    _, turns, shifts, _ = cv2.solvePnPGeneric(points, normalized, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    for turn, shift in zip(turns, shifts, strict=True):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(turn)[0], shift.ravel()
        poses.append(pose)
    return _Sighting(points, normalized, float(camera.K[0, 0]), np.stack(poses))


def _misfit(sighting: _Sighting, camera_from_board: np.ndarray) -> np.ndarray:
    """Robust cost [...] of poses [..., 4, 4] in one view."""
    in_camera = sighting.points @ np.swapaxes(camera_from_board[..., :3, :3], -1, -2)
    in_camera = in_camera + camera_from_board[..., None, :3, 3]
    depth = np.where(in_camera[..., 2:] > 0, in_camera[..., 2:], np.nan)  # behind the camera: as wrong as can be
    error = np.linalg.norm(in_camera[..., :2] / depth - sighting.normalized, axis=-1) * sighting.focal
    return np.log1p((np.nan_to_num(error, nan=1e6) / START_ERROR_PX) ** 2).sum(-1)


def _join(sightings: dict[tuple[int, int], _Sighting], shared: np.ndarray) -> dict[int, np.ndarray]:
    """Poses of all cameras from camera 0, along the spanning tree of the most shared corners."""
    tree = scipy.sparse.csgraph.minimum_spanning_tree(scipy.sparse.csr_array(np.where(shared > 0, -shared, 0)))
    order, parent = scipy.sparse.csgraph.breadth_first_order(tree, 0, directed=False)
    from_root = {0: np.eye(4)}
    for c in order[1:]:
        p = int(parent[c])
        both = [(s, sightings[p, v]) for (k, v), s in sightings.items() if k == c and (p, v) in sightings]
        from_root[int(c)] = _relative_pose(both) @ from_root[p]
    return from_root


def _relative_pose(both: Sequence[tuple[_Sighting, _Sighting]]) -> np.ndarray:
    """The pose of one camera from another's: the one that a view suggests and all shared views like best."""
    pairs = [
        own @ np.linalg.inv(other)
        for mine, others in both
        for own in mine.camera_from_board
        for other in others.camera_from_board
    ]
    candidates = np.stack(pairs)
    cost = np.zeros(len(candidates))
    for mine, others in both:
        cost += _misfit(mine, candidates[:, None] @ others.camera_from_board[None]).min(1)
    return candidates[np.argmin(cost)]


def _place_board(
    sightings: dict[tuple[int, int], _Sighting], from_root: dict[int, np.ndarray], view: int
) -> np.ndarray:
    """The board's pose from camera 0: the one that a camera suggests and all that see it like best."""
    seen = [(from_root[k], sighting) for (k, v), sighting in sightings.items() if v == view]
    candidates = np.concatenate([np.linalg.inv(pose) @ sighting.camera_from_board for pose, sighting in seen])
    cost = sum(_misfit(sighting, pose @ candidates) for pose, sighting in seen)
    return candidates[np.argmin(cost)]
