"""Where the bundle adjustment of a rig starts: each camera alone, then cameras joined through views they share."""

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
from pipeline.geometry.rig import Observations

LEAST_CORNERS = 6
"""Corners that a view needs to count: four determine a plane's pose, two more make it robust."""

PLAUSIBLE_FOCAL = (0.3, 30.0)
"""Focal length over the image's longer side, outside which (118 and 2 degrees wide) Zhang's start has failed."""

GUESSED_FOCAL = 1.2
"""Focal length over the longer side, of a 45 degree lens, where Zhang's start has failed."""


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
    """Intrinsics and poses to start from; `sizes` are (width, height). All cameras must be connected."""
    rows = view_rows(observations)
    camera_from_board: dict[tuple[int, int], np.ndarray] = {}
    cameras = []
    for c, size in enumerate(sizes):
        mine = {v: (corners_m[observations.corner[r]], observations.pixel[r]) for (k, v), r in rows.items() if k == c}
        camera, poses = start_camera(list(mine.values()), size)
        cameras.append(camera)
        camera_from_board.update({(c, v): pose for v, pose in zip(mine, poses, strict=True)})
    from_root = _join(camera_from_board, _shared_corners(observations, len(sizes)))
    views = int(observations.view.max()) + 1
    root_from_board: dict[int, np.ndarray] = {}
    for (c, v), _ in sorted(rows.items(), key=lambda item: -len(item[1])):  # the camera that sees most of it
        root_from_board.setdefault(v, np.linalg.inv(from_root[c]) @ camera_from_board[c, v])
    first = root_from_board[0]
    boards = np.stack([np.linalg.inv(first) @ root_from_board[v] for v in range(views)])
    placed = []
    for c, camera in enumerate(cameras):
        pose = from_root[c] @ first
        placed.append(Camera(pose[:3, :3], pose[:3, 3], camera.K, camera.dist, camera.width, camera.height))
    return Start(placed, boards)


def start_camera(
    views: Sequence[tuple[np.ndarray, np.ndarray]], size: tuple[int, int]
) -> tuple[Camera, list[Float64[np.ndarray, "4 4"]]]:
    """One camera alone, by Zhang's method, and the pose of the board in each of its views.

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
    camera = Camera(np.eye(3), np.zeros(3), K.astype(np.float64), dist, *size)
    poses = []
    for points, pixel in views:
        _, turn, shift = cv2.solvePnP(points, camera.undistort(pixel), np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(turn)[0], shift.ravel()
        poses.append(pose)
    return camera, poses


def _join(camera_from_board: dict[tuple[int, int], np.ndarray], shared: np.ndarray) -> dict[int, np.ndarray]:
    """Poses of all cameras from camera 0, along the spanning tree of the most shared corners."""
    tree = scipy.sparse.csgraph.minimum_spanning_tree(scipy.sparse.csr_array(np.where(shared > 0, -shared, 0)))
    order, parent = scipy.sparse.csgraph.breadth_first_order(tree, 0, directed=False)
    from_root = {0: np.eye(4)}
    for c in order[1:]:
        p = int(parent[c])
        both = [v for (k, v) in camera_from_board if k == c and (p, v) in camera_from_board]
        candidates = [camera_from_board[c, v] @ np.linalg.inv(camera_from_board[p, v]) for v in both]
        from_root[int(c)] = _medoid(candidates) @ from_root[p]
    return from_root


def _medoid(poses: Sequence[np.ndarray]) -> np.ndarray:
    """The pose nearest to all others: a flipped planar pose, a known ambiguity of small boards, never wins a vote."""
    stack = np.stack(poses)
    size = np.median(np.linalg.norm(stack[:, :3, 3], axis=1)) or 1.0
    difference = stack[:, None] - stack[None]
    turned = np.linalg.norm(difference[..., :3, :3], axis=(-1, -2))
    moved = np.linalg.norm(difference[..., :3, 3], axis=-1) / size
    return stack[np.argmin((turned + moved).sum(1))]
