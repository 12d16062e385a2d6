"""Joining cameras through the views they share.

Which poses go together is decided by all of them at once.

A small board seen from afar fits two poses almost equally, one the other's mirror image in depth (Collins and Bartoli
2014). A pair of cameras that shares one view can then stand in four ways, and only a loop through other cameras tells
which is right: so several hypotheses are kept until the last camera is placed (a beam search).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float64

from pipeline.geometry.cameras import LEAST_COSINE, Camera

START_ERROR_PX = 3.0
"""Reprojection error of a pose that one camera sees in another: about ten times the noise of corners, because the pose
of one view is all that it rests on. It only scales a robust loss by which such poses are compared."""

DOUBT = 150.0
"""Robust cost by which a hypothesis may be worse than the best and live: one view of a board, twenty corners off by a
hundred pixels. What two views speak against is given up."""

OPEN = 40.0
"""Robust cost by which a hypothesis may be worse than the best when all cameras are placed: what lenses known from a
few views each leave over, two views off by three pixels. A loop that does not close costs `DOUBT`."""

HYPOTHESES = 32
"""Hypotheses kept at most: the two right and left poses of five views that nothing else decides yet."""

PARENTS = 3
"""Placed cameras, those that share most with it, from which a camera is placed: where one fails another will do."""

SAME_DEG = 10.0
"""Poses turned less against each other are one and the same, but for noise: mirrored ones are tens of degrees apart."""


@dataclass(frozen=True)
class BoardImage:
    """Corners of a board in one image: on the board in metres, and in pixels."""

    points: Float64[np.ndarray, "corners 3"]
    pixels: Float64[np.ndarray, "corners 2"]


@dataclass(frozen=True)
class Sighting:
    """One view by one camera, and the poses that fit it.

    Attributes:
        points: corners on the board, metres.
        view_from_camera: rotation that turns the view to the front of a fisheye, which also sees what lies beside it;
            the identity for a perspective lens.
        normalized: the corners on the plane z = 1 of the turned view.
        focal: pixels.
    """

    points: Float64[np.ndarray, "corners 3"]
    view_from_camera: Float64[np.ndarray, "3 3"]
    normalized: Float64[np.ndarray, "corners 2"]
    focal: float
    camera_from_board: Float64[np.ndarray, "poses 4 4"]


Sightings = Mapping[int, Mapping[int, Sighting]]
"""By view, and by the cameras that see it."""


@dataclass(frozen=True)
class _Hypothesis:
    """Poses of the cameras placed so far, and what each view then costs."""

    from_root: dict[int, np.ndarray]
    cost: dict[int, float]

    @property
    def total(self) -> float:
        return float(sum(self.cost.values()))


def sight(camera: Camera, image: BoardImage) -> Sighting:
    """A view of a board, and the one or two poses of it that fit."""
    turned, normalized = _turned_view(camera, image.pixels)
    poses = []
    _, turns, shifts, _ = cv2.solvePnPGeneric(image.points, normalized, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    for turn, shift in zip(turns, shifts, strict=True):
        if not (np.isfinite(turn).all() and np.isfinite(shift).all()):
            continue
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turned.T @ cv2.Rodrigues(turn)[0], turned.T @ shift.ravel()
        poses.append(pose)
    if not poses:  # corners that no pose fits at all: any will do, and cost what it must
        poses.append(np.eye(4))
        poses[0][:3, :3], poses[0][:3, 3] = turned.T, turned[2]
    return Sighting(image.points, turned, normalized, float(camera.K[0, 0]), np.stack(poses))


def _turned_view(camera: Camera, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`Sighting.view_from_camera` and `Sighting.normalized`.

    A corner beside the field of view that the lens now has is a gross error, or the lens is: it goes to the middle.
    """
    if camera.lens.perspective:
        return np.eye(3), camera.undistort(pixels)
    rays = camera.lens.undistort(pixels, camera.K, camera.dist)
    known = np.isfinite(rays).all(1)
    middle = rays[known].mean(0) if known.any() else np.array([0.0, 0.0, 1.0])
    forward = middle / np.linalg.norm(middle)
    right = np.cross(np.eye(3)[np.abs(forward).argmin()], forward)
    right /= np.linalg.norm(right)
    turned = np.stack([right, np.cross(forward, right), forward])
    in_view = np.where(known[:, None], rays, middle) @ turned.T
    in_front = in_view[:, 2] > LEAST_COSINE
    return turned, np.where(in_front[:, None], in_view[:, :2], 0) / np.where(in_front, in_view[:, 2], 1)[:, None]


def join_cameras(sightings: Sightings, shared: np.ndarray) -> list[dict[int, np.ndarray]]:
    """Poses of all cameras from the first placed one.

    The best hypothesis first, and those that may yet be right.

    Args:
        shared: corners that two cameras see in the same view [cameras, cameras]; together they connect all.
    """
    root = int(shared.sum(1).argmax())
    alive = [_Hypothesis({root: np.eye(4)}, {})]
    while len(alive[0].from_root) < len(shared):
        placed = list(alive[0].from_root)
        to_placed = np.where(np.isin(np.arange(len(shared)), placed), -1, shared[:, placed].sum(1))
        camera = int(to_placed.argmax())
        parents = sorted(placed, key=lambda p: -shared[camera, p])[:PARENTS]
        edges = {p: _relative_poses(_both(sightings, camera, p)) for p in parents if shared[camera, p] > 0}
        grown = [
            _grow(each, camera, relative @ each.from_root[p], sightings)
            for each in alive
            for p, candidates in edges.items()
            for relative in candidates
        ]
        alive = _fittest(grown)
    return [each.from_root for each in alive if each.total <= alive[0].total + OPEN]


def place_board(sightings: Sightings, from_root: Mapping[int, np.ndarray], view: int) -> tuple[np.ndarray, float]:
    """Pose of a board from the root, and its cost.

    The pose that a placed camera suggests and all like best.
    """
    seen = [(from_root[c], sighting) for c, sighting in sightings[view].items() if c in from_root]
    candidates = np.concatenate([np.linalg.inv(pose) @ sighting.camera_from_board for pose, sighting in seen])
    cost = sum(_misfit(sighting, pose @ candidates) for pose, sighting in seen)
    best = int(np.argmin(cost))
    return candidates[best], float(cost[best])


def _misfit(sighting: Sighting, camera_from_board: np.ndarray) -> np.ndarray:
    """Robust cost [...] of poses [..., 4, 4] in one view."""
    in_camera = sighting.points @ np.swapaxes(camera_from_board[..., :3, :3], -1, -2)
    in_view = (in_camera + camera_from_board[..., None, :3, 3]) @ sighting.view_from_camera.T
    depth = np.where(in_view[..., 2:] > 0, in_view[..., 2:], np.nan)  # behind the camera: as wrong as can be
    error = np.linalg.norm(in_view[..., :2] / depth - sighting.normalized, axis=-1) * sighting.focal
    return np.log1p((np.nan_to_num(error, nan=1e6) / START_ERROR_PX) ** 2).sum(-1)


def _both(sightings: Sightings, camera: int, other: int) -> list[tuple[Sighting, Sighting]]:
    return [(seen[camera], seen[other]) for seen in sightings.values() if camera in seen and other in seen]


def _relative_poses(both: Sequence[tuple[Sighting, Sighting]]) -> np.ndarray:
    """Poses of one camera from another's: those that a view suggests and all shared views like, best first."""
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
    kept: list[int] = []
    for k in np.argsort(cost):
        if cost[k] < cost.min() + DOUBT and (_apart_deg(candidates[kept], candidates[k]) > SAME_DEG).all():
            kept.append(int(k))
    return candidates[kept]


def _grow(hypothesis: _Hypothesis, camera: int, pose: np.ndarray, sightings: Sightings) -> _Hypothesis:
    from_root = {**hypothesis.from_root, camera: pose}
    cost = {v: place_board(sightings, from_root, v)[1] for v, seen in sightings.items() if camera in seen}
    return _Hypothesis(from_root, {**hypothesis.cost, **cost})


def _fittest(grown: Sequence[_Hypothesis]) -> list[_Hypothesis]:
    """The best, without those that differ in nothing but noise, as far as they may yet be right."""
    kept: list[_Hypothesis] = []
    poses = np.zeros((0, len(grown[0].from_root), 4, 4))
    for each in sorted(grown, key=lambda hypothesis: hypothesis.total):
        if len(kept) == HYPOTHESES or (kept and each.total > kept[0].total + DOUBT):
            break
        pose = np.stack(list(each.from_root.values()))
        if (_apart_deg(poses, pose).max(1) > SAME_DEG).all():
            kept.append(each)
            poses = np.concatenate([poses, pose[None]])
    return kept


def _apart_deg(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angle [...] between poses [..., 4, 4]."""
    cosine = (np.sum(a[..., :3, :3] * b[..., :3, :3], (-1, -2)) - 1) / 2
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))
