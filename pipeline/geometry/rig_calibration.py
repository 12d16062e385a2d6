"""A rig from its observations: where to start, how much distortion, one adjustment, and whether anything moved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np
from jaxtyping import Float64, Int64

from pipeline.geometry.moved_cameras import find_moved, split_camera
from pipeline.geometry.rig import Rig, adjust_rig
from pipeline.geometry.rig_distortion import FULL, choose_distortion, distortion_evidence
from pipeline.geometry.rig_model import Observations
from pipeline.geometry.rig_start import connected_groups, start_rig


@dataclass(frozen=True)
class Calibrated:
    """A rig, the number of distortion coefficients of each camera, and `distortion_evidence` if that chose them."""

    rig: Rig
    distortion: list[int]
    evidence: list[dict[int, float]] | None


@dataclass(frozen=True)
class Movement:
    """A camera that moved while the board was recorded.

    Attributes:
        suspects: the camera, and others that may have moved in its stead.
        shot: the first after the movement.
        shift_px: how far its corners moved, root mean square.
        shift_m, turn_deg: how far and how much it moved itself; NaN if its views after are too few to tell.
    """

    suspects: list[int]
    shot: int
    shift_px: float
    shift_m: float
    turn_deg: float


def calibrate_rig(
    observations: Observations,
    corners_m: Float64[np.ndarray, "corners 3"],
    sizes: Sequence[tuple[int, int]],
    distortion: Literal["auto", 0, 1, 2, 5],
) -> Calibrated:
    """Calibrate cameras of `sizes` (width, height), all connected by shared views."""
    start = start_rig(observations, corners_m, sizes)
    first = FULL if distortion == "auto" else distortion
    rig = adjust_rig(observations, corners_m, start.cameras, start.rig_from_board, first)
    if distortion != "auto":
        return Calibrated(rig, [first] * len(sizes), None)
    evidence = distortion_evidence(rig)
    chosen = choose_distortion(evidence)
    if any(number != FULL for number in chosen):
        rig = adjust_rig(observations, corners_m, rig.cameras, rig.rig_from_board, chosen)
    return Calibrated(rig, chosen, evidence)


def find_movements(
    calibrated: Calibrated,
    corners_m: Float64[np.ndarray, "corners 3"],
    sizes: Sequence[tuple[int, int]],
    shot: Int64[np.ndarray, " views"],
    distortion: Literal["auto", 0, 1, 2, 5],
) -> list[Movement]:
    """Every camera that moved: found one by one, each then taken for two cameras, before and after.

    Args:
        shot: of each view, its number in the order in which they were recorded.
    """
    rig, observations = calibrated.rig, calibrated.rig.model.observations
    owner, movements = list(range(len(sizes))), []
    while len(movements) < len(sizes) and (moved := find_moved(rig, shot)) is not None:
        suspects = list(dict.fromkeys(owner[suspect] for suspect in moved.suspects))
        before, after = moved.suspects[0], len(owner)
        observations = split_camera(observations, shot, before, moved.time, after)
        owner.append(owner[before])
        if len(connected_groups(observations, len(owner))) > 1:
            movements.append(Movement(suspects, moved.time, moved.shift_px, np.nan, np.nan))
            break
        rig = calibrate_rig(observations, corners_m, [sizes[k] for k in owner], distortion).rig
        movements.append(Movement(suspects, moved.time, *_difference(rig, before, after)))
    return movements


def _difference(rig: Rig, before: int, after: int) -> tuple[float, float, float]:
    """Shift of the corners (pixels), of the centre (metres), and the angle (degrees) between two poses of one camera.

    The pose after is fitted anew with the lens from before: the two halves' own lenses differ by their errors, which
    principal point and direction trade for each other.
    """
    old, new = rig.cameras[before], rig.cameras[after]
    mine = rig.model.observations.camera == after
    boards = rig.rig_from_board[rig.model.observations.view[mine]]
    points = np.einsum("nij,nj->ni", boards[:, :3, :3], rig.model.points[mine]) + boards[:, :3, 3]
    turn, shift = cv2.Rodrigues(new.R)[0], new.t.reshape(3, 1)
    seen = old.undistort(rig.model.observations.pixel[mine])
    _, turn, shift = cv2.solvePnP(points, seen, np.eye(3), None, turn, shift, useExtrinsicGuess=True)
    moved = replace(old, R=cv2.Rodrigues(turn)[0], t=shift.ravel())
    apart = moved.project(points)[0] - old.project(points)[0]
    angle = np.linalg.norm(cv2.Rodrigues(old.R @ moved.R.T)[0])
    return (
        float(np.sqrt((apart**2).sum(1).mean())),
        float(np.linalg.norm(old.center - moved.center)),
        float(np.degrees(angle)),
    )
